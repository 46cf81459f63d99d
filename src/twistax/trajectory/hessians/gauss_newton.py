"""Objectives as sums of squares: their residuals, found from the structure of the expression."""

from __future__ import annotations

import functools
import operator
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import TrajectoryError
from ...expr import (
    Add,
    Concat,
    Constant,
    Control,
    Div,
    Dot,
    Expr,
    Hstack,
    Index,
    Leaf,
    MatMul,
    Mul,
    Neg,
    Norm,
    Parameter,
    Power,
    Sqrt,
    Square,
    Stack,
    State,
    Sub,
    Sum,
    Time,
    Transpose,
    Vstack,
    evaluate_all,
    leaves_of,
)
from ...solver.kernels import Argument
from ..transcription.kernels import Known, point_of
from ..transcription.shooting import Shooting

_LINEAR = (Add, Sub, Neg, Index, Sum, Concat, Stack, Hstack, Vstack, Transpose)


class Term(NamedTuple):
    """A term of an objective: factor * sum(weight * residual^2), or factor * residual' weight residual for a matrix
    weight.

    Attributes:
        residual: of any shape; a vector where the weight is a matrix.
        factor: a scalar that does not depend on unknowns.
        weight: independent of unknowns: a scalar, an array of the residual's shape, or a matrix.
    """

    residual: Expr
    factor: Expr
    weight: Expr


class SumOfSquares:
    """An expression as a sum of squares. Its other terms are linear in the unknowns, so their second derivative is
    zero.

    Args:
        place: the name of the expression in messages.
        expr: a scalar expression.
        free: names of the free parameters.

    Attributes:
        terms: the squares.

    Raises:
        TrajectoryError: the expression is not such a sum.
    """

    def __init__(self, place: str, expr: Expr, free: Collection[str]) -> None:
        self._place, self._free = place, frozenset(free)
        self.terms = list(self._terms(expr, Constant(1.0)))

    def _terms(self, expr: Expr, factor: Expr) -> Iterator[Term]:
        """The squares of factor * expr."""
        parts = expr.children()
        if self._is_linear(expr):
            return
        if isinstance(expr, Add):
            for part in expr.terms:
                yield from self._terms(part, factor)
        elif isinstance(expr, Sub):
            yield from self._terms(parts[0], factor)
            yield from self._terms(parts[1], -factor)
        elif isinstance(expr, Neg):
            yield from self._terms(parts[0], -factor)
        elif isinstance(expr, Div) and self._is_known(parts[1]):
            yield from self._terms(parts[0], factor / parts[1])
        elif isinstance(expr, Mul) and len(unknown := [p for p in parts if not self._is_known(p)]) == 1:
            for part in parts:
                factor = factor if part is unknown[0] else factor * part
            yield from self._terms(unknown[0], factor)
        elif isinstance(expr, Sum):
            weight, residual = self._entries(parts[0])
            yield Term(residual, factor, weight)
        elif isinstance(expr, (Dot, MatMul)):
            yield self._product(expr, factor)
        else:
            weight, residual = self._entries(expr)
            if isinstance(residual, Norm) and residual.ord == "fro":
                residual = residual.operand
            if isinstance(residual, Sqrt):  # the root of a sum of squares, squared
                yield from self._terms(residual.children()[0], factor * weight)
            else:
                yield Term(residual, factor, weight)

    def _entries(self, expr: Expr) -> tuple[Expr, Expr]:
        """The weights and residuals of squares, entry by entry."""
        parts = expr.children()
        if isinstance(expr, Square):
            return Constant(1.0), parts[0]
        if isinstance(expr, Power) and isinstance(parts[1], Constant) and (parts[1].value == 2.0).all():
            return Constant(1.0), parts[0]
        if isinstance(expr, (Mul, Div)):
            known = [p for p in parts if self._is_known(p)]
            unknown = [p for p in parts if not self._is_known(p)]
            if isinstance(expr, Div):
                known = [1.0 / parts[1]] if len(unknown) == 1 and unknown[0] is parts[0] else []
            if len(unknown) == 2 and unknown[0].key() == unknown[1].key() and isinstance(expr, Mul):
                return _product_of(known), unknown[0]
            if len(unknown) == 1 and known:
                weight, residual = self._entries(unknown[0])
                return weight * _product_of(known), residual
        raise self._refused(expr)

    def _product(self, expr: Expr, factor: Expr) -> Term:
        """The squares in the products a @ a, w @ a^2 and a @ W @ a."""
        (before, left), (after, right) = map(self._peeled, expr.children())
        if left.key() == right.key():
            return Term(left, factor, before * after)
        for known, entries in (expr.children(), expr.children()[::-1]):
            if self._is_known(known) and len(entries.shape) == 1:
                weight, residual = self._entries(entries)
                return Term(residual, factor, known * weight)
        for outer, inner, side in ((left, right, 1), (right, left, 0)):
            if isinstance(inner, MatMul):
                matrix, (scale, end) = inner.children()[1 - side], self._peeled(inner.children()[side])
                scale = before * after * scale
                if end.key() == outer.key() and self._is_known(matrix) and len(outer.shape) == 1 and scale.shape == ():
                    return Term(outer, factor * scale, matrix)
        raise self._refused(expr)

    def _peeled(self, expr: Expr) -> tuple[Expr, Expr]:
        """The factors of a product that do not depend on unknowns, and the product of the others."""
        parts = expr.children()
        if isinstance(expr, Neg):
            factor, rest = self._peeled(parts[0])
            return -factor, rest
        unknown = [part for part in parts if not self._is_known(part)]
        if isinstance(expr, Mul) and len(unknown) == 1 and unknown[0].shape == expr.shape:
            factor, rest = self._peeled(unknown[0])
            return factor * _product_of([part for part in parts if part is not unknown[0]]), rest
        if isinstance(expr, Div) and self._is_known(parts[1]) and parts[0].shape == expr.shape:
            factor, rest = self._peeled(parts[0])
            return factor / parts[1], rest
        return Constant(1.0), expr

    def _is_known(self, expr: Expr) -> bool:
        """Whether an expression depends on no unknown except time."""
        return not any(self._is_unknown(leaf) for leaf in leaves_of(expr))

    def _is_unknown(self, leaf: Leaf) -> bool:
        return isinstance(leaf, (State, Control)) or (isinstance(leaf, Parameter) and leaf.name in self._free)

    def _is_linear(self, expr: Expr) -> bool:
        """Whether it is linear in the unknowns and the time."""
        if not any(self._is_unknown(leaf) or isinstance(leaf, Time) for leaf in leaves_of(expr)):
            return True
        parts = expr.children()
        if isinstance(expr, _LINEAR):
            return all(map(self._is_linear, parts))
        if isinstance(expr, (Mul, MatMul, Dot)) or (isinstance(expr, Div) and self._is_constant(parts[1])):
            return sum(not self._is_constant(part) for part in parts) <= 1 and all(map(self._is_linear, parts))
        return isinstance(expr, Leaf) and not (isinstance(expr, State) and expr.is_group_element)

    def _is_constant(self, expr: Expr) -> bool:
        return self._is_known(expr) and not any(isinstance(leaf, Time) for leaf in leaves_of(expr))

    def _refused(self, part: Expr) -> TrajectoryError:
        return TrajectoryError(
            f"GaussNewton expects an objective that is a sum of squares, such as (x - r) @ W @ (x - r) + 0.1 * u**2, "
            f"but {self._place} has {part!r}.\n"
            "  fix: write it as squares with weights that no state or control is in, or leave out hessian="
        )


class SquaresHessian:
    """Second derivatives of squares from first derivatives of their residuals, for kernels; see `ExtraHessian`.

    Args:
        shooting: the phase.
    """

    def __init__(self, shooting: Shooting) -> None:
        self._shooting, self._point = shooting, point_of(shooting)

    def running(self, known: Known, params: Any, terms: Sequence[Any]) -> jax.Array:
        """The Hessian of the running cost times T in the unknowns of q = [eta, u, b]; the last weight is that of the
        cost.
        """
        q, share, base = known[Argument.Z], known[Argument.SHARE][0], self._point.split(known[Argument.BASE])
        return known[Argument.WEIGHTS][-1] * self._hessian(q, share, base, params, terms, jnp.sqrt)[
            self._unknown(0)
        ].reshape(-1)

    def final(self, known: Known, params: Any, terms: Sequence[Any]) -> jax.Array:
        """The Hessian of the final cost in the unknowns of z = [eta, b]."""
        n, m, z = self._shooting.n, self._shooting.m, known[Argument.Z]
        q = jnp.concatenate([z[:n], jnp.zeros(m, z.dtype), z[n:]])
        base = self._point.split(known[Argument.BASE])
        hessian = self._hessian(q, jnp.ones((), z.dtype), base, params, terms, jnp.ones_like)
        return known[Argument.WEIGHTS][-1] * hessian[self._unknown(m)].reshape(-1)

    def _unknown(self, left_out: int) -> Any:
        """The indices of the unknown rows and columns of q, without this number of controls."""
        n, m = self._shooting.n, self._shooting.m
        shared = n + m + np.flatnonzero(self._shooting.border.unknown)
        columns = np.concatenate([np.arange(n + m - left_out), shared])
        return np.ix_(columns, columns)

    def _hessian(
        self, q: jax.Array, share: jax.Array, base: Any, params: Any, terms: Sequence[Any], root: Any
    ) -> jax.Array:
        """(q, q) the sum of 2 factor R' weight R over the residuals, where R is the Jacobian of the residual; residuals
        are scaled by the root of T.
        """
        residuals, factors, weights = terms

        def at(exprs: Any, q: jax.Array) -> tuple[jax.Array, list[Any]]:
            length, inputs = self._shooting.inputs_at(q, share, base, params)
            return length, list(evaluate_all(exprs, lambda leaf: leaf.read(inputs)))

        def rooted(q: jax.Array) -> list[jax.Array]:
            length, values = at(residuals, q)
            return [root(length) * a for a in values]

        hessian = jnp.zeros((len(q), len(q)), q.dtype)
        for slopes, factor, weight in zip(jax.jacfwd(rooted)(q), at(factors, q)[1], at(weights, q)[1]):
            shape, flat = slopes.shape[:-1], slopes.reshape(-1, len(q))
            is_matrix = weight.ndim == 2 and len(shape) == 1
            weighted = weight @ flat if is_matrix else jnp.broadcast_to(weight, shape).reshape(-1, 1) * flat
            product = flat.T @ weighted
            hessian = hessian + factor * (product + product.T)
        return self._shooting.local.sign * hessian


def _product_of(parts: list[Expr]) -> Expr:
    return functools.reduce(operator.mul, parts) if parts else Constant(1.0)
