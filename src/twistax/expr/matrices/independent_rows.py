"""Independent rows of a matrix, by elimination with pivoting."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError, ShapeError
from ..bases import expect_square
from ..fields import Operand
from ..kinds import rules
from ..node import Expr, Shape

#: The smallest pivot that a matrix of n rows can be trusted with, and the largest that may be round-off alone, both in
#: units of n times the machine's precision and of the first pivot.
_TRUSTED, _ROUND_OFF = 16.0, 4.0


def independent_rows(S: jax.Array, tolerance: float, blocks: tuple[int, ...], unit: float) -> jax.Array:
    """(2, m), from the Gram matrix S (m, m) of the rows: 1 for selected rows, 0 for others; and the distances."""
    m, eps = S.shape[-1], float(jnp.finfo(S.dtype).eps)
    least = max(tolerance**2, _TRUSTED * m * eps)
    left, longest = S, jnp.maximum(jnp.max(_diagonal(S, m)), unit**2)
    by_block: list[jax.Array] = []
    for size in blocks:
        waiting, chosen, distances = jnp.ones(size, bool), jnp.zeros(size, bool), jnp.zeros(size, S.dtype)
        for _ in range(size):
            squares = _diagonal(left, size)
            here = jnp.arange(size) == jnp.argmax(jnp.where(waiting, squares, -1.0))
            square = jnp.sum(jnp.where(here, squares, 0.0))
            good, real = square > least * longest, square > _ROUND_OFF * m * eps * longest
            column = left[:, :size] @ here.astype(S.dtype)
            weight = jnp.where(good, 1.0 / jnp.where(good, square, 1.0), 0.0)
            left = left - (weight * column)[:, None] * column[None, :]
            left = jnp.where(np.tri(len(left), dtype=bool), left, left.T)  # what is equal is computed once
            distances = jnp.where(here, jnp.where(real, jnp.sqrt(jnp.where(real, square, 1.0)), 0.0), distances)
            chosen, waiting = chosen | (here & good), waiting & ~here
        left = left[size:, size:]
        by_block.append(jnp.stack([chosen.astype(S.dtype), distances]))
    return jnp.concatenate(by_block, axis=1)


def _diagonal(S: jax.Array, size: int) -> jax.Array:
    """The first entries: entry by entry, which is scalars wherever JAX's own is not."""
    return jnp.stack([S[i, i] for i in range(size)])


class IndependentRows(Expr):
    """A maximal set of independent rows of a matrix G, from its Gram matrix $S = G G^T$. Shape: (m, m) -> (2, m).

    Rows are selected one by one, each time the one with the largest distance from the span of the selected ones. The
    selection ends when no distance exceeds `tolerance` times the length of the longest row, or times `unit` if all rows
    are shorter than that. The first row of the value is 1 for selected rows and 0 for others, and has no derivative.
    The second is the distance of each row from the span of those selected before it. Distances at round-off are set to
    zero.

    S has half the digits of G: in single precision a tolerance below about 2e-3 has no effect.

    Attributes:
        operand: S, symmetric.
        tolerance: positive and below one.
        blocks: sizes of groups of rows that are compared with one another, group after group; by default one group of
            all rows. Groups are cheaper for many rows, and less accurate if a nearly dependent row precedes a better
            one.
        unit: the length of rows without cancellation; zero if unknown.
    Raises: ShapeError if the operand is not a square matrix, or if the sizes in `blocks` do not add up to its rows;
        ModelError for an invalid tolerance, or a unit that is negative or not finite.
    Source: N. Higham, Accuracy and Stability of Numerical Algorithms (2002), section 10.3, complete pivoting.
    """

    kinds = rules.OPEN
    of_numbers = True
    operand: Operand
    tolerance: float = 1e-5
    blocks: tuple[int, ...] = ()
    unit: float = 0.0
    cases = (
        {"operand": [[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]]},
        {"operand": [[4.0, 1.0], [1.0, 3.0]], "tolerance": 0.9},
        {"operand": [[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]], "blocks": (1, 2)},
        {"operand": [[0.04, 0.01], [0.01, 0.05]], "tolerance": 0.21, "unit": 1.0},
    )

    def validate(self) -> None:
        if not isinstance(self.tolerance, float) or not 0.0 < self.tolerance < 1.0:
            raise ModelError(f"IndependentRows expects a tolerance between 0 and 1, got {self.tolerance!r}")
        if not isinstance(self.unit, float) or not 0.0 <= self.unit < np.inf:
            raise ModelError(f"IndependentRows expects a unit of zero or more, got {self.unit!r}")

    def infer_shape(self, *shapes: Shape) -> Shape:
        (S,) = shapes
        expect_square(self, "the operand", S)
        if self.blocks and sum(self.blocks) != S[0]:
            raise ShapeError(f"IndependentRows expects blocks whose sizes add up to {S[0]}, got {self.blocks}")
        return (2, S[0])

    def evaluate(self, *values: Any) -> jax.Array:
        return independent_rows(values[0], self.tolerance, self.blocks or (values[0].shape[0],), self.unit)

    def to_latex(self, *operands: str) -> str:
        return rf"\operatorname{{rows}}\left({operands[0]}\right)"
