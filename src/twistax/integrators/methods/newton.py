"""Newton's method with a reused Jacobian, and linear solves without a library."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from ..tableaus import CollocationTableau

#: Updates within this many times round-off count as solved when they stop falling.
_STALLED = 1e3
#: Without a shorter step to try, updates below the root of round-off that rise this often are noise of cancelling
#: terms in the rates, and the equations count as solved.
_RISES = 2

#: A real array (a,), or a complex one as real and imaginary part (a, b): complex numbers do not compile everywhere.
Parts: TypeAlias = tuple[jax.Array, ...]

Map: TypeAlias = Callable[[jax.Array], jax.Array]

#: Larger matrices are solved by a library.
_LARGEST = 24

#: Secants of accelerated updates, and the growth of an update that deletes them.
_SECANTS, _GROWN = 4, 3.0


class _Secants(NamedTuple):
    """Differences of updates, orthonormal, and of Z: rows (n, s, N), zero where there is none yet."""

    updates: jax.Array
    steps: jax.Array
    used: jax.Array  # the number of rows
    update: jax.Array  # the last one
    step: jax.Array

    @classmethod
    def none(cls, update: jax.Array) -> _Secants:
        """No secants, after a first step."""
        rows = jnp.zeros((_SECANTS, *update.shape), update.dtype)
        return cls(rows, rows, jnp.zeros((), int), update, -update)

    def accelerated(self, update: jax.Array, clear: jax.Array) -> tuple[jax.Array, _Secants]:
        """The step for an update: by the secants in their span, the update beside it."""
        clear = clear | (self.used == _SECANTS)
        used = jnp.where(clear, 0, self.used)
        updates, steps = (jnp.where(clear, 0.0, rows) for rows in (self.updates, self.steps))
        new, moved = update - self.update, self.step
        size = jnp.sum(new * new)
        for q, p in zip(updates, steps, strict=True):
            share = jnp.sum(q * new)
            new, moved = new - share * q, moved - share * p
        square = jnp.sum(new * new)
        good = square > jnp.finfo(square.dtype).eps * size
        scale = jnp.where(good, 1.0 / jnp.sqrt(jnp.where(good, square, 1.0)), 0.0)
        here = (jnp.arange(_SECANTS) == used)[:, None, None]
        updates, steps = jnp.where(here, scale * new, updates), jnp.where(here, scale * moved, steps)
        step = update
        for q, p in zip(updates, steps, strict=True):
            step = step - jnp.sum(q * update) * (q - p)
        return step, _Secants(updates, steps, used + good.astype(used.dtype), update, -step)


class Newton(NamedTuple):
    """The state and the result of Newton's method."""

    Z: jax.Array  # the solution
    size: jax.Array  # of the last update
    done: jax.Array  # whether Z solves the equations
    failed: jax.Array
    iterations: jax.Array  # how many updates were made
    rose: jax.Array  # whether the last update was larger than the one before
    rises: jax.Array  # the number of times that updates began to rise
    #: r / (1 - r), r the ratio of the last two updates: the error of Z in units of the last update.
    contraction: jax.Array
    again: jax.Array  # whether it may start once more
    secants: _Secants | None  # of a second try; None where there is none


def newton(
    update: Map,
    size: Map,
    guess: jax.Array,
    contraction: jax.Array,
    most: int,
    again: bool,
    rounding: Any,
    enough: Map = lambda step: jnp.asarray(False),
) -> Newton:
    """The iteration Z <- Z - update(Z) from a guess, until the scaled correction is below 1. Pure and traceable.

    It ends early if updates grow, are not finite, or `most` updates have been made. If updates stop decreasing below
    1e3 times `rounding`, the equations count as solved. `size` is the size of an update in units of the tolerance,
    `contraction` the contraction factor of the last solution. `again`: whether no shorter step can be tried. Then
    updates that oscillate below the root of round-off are accepted, and if the guess fails, Newton's method starts once
    more from zero, with updates that are accelerated by secants: where rates have corners, the Jacobian at the start of
    the step is wrong on their other side. In this second try updates may grow, and those that oscillate are accepted
    if they are small enough by `enough`.

    Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.8, on stopping; D. G.
    Anderson, Iterative procedures for nonlinear integral equations, Journal of the ACM 12 (1965), for the secants.
    """

    def iterate(now: Newton) -> Newton:
        step = update(now.Z)
        size_now = size(step)
        later = now.size > 0.0
        ratio = jnp.where(later, size_now / jnp.where(later, now.size, 1.0), 0.0)
        growing = ratio >= 1.0
        left = jnp.where(later, ratio / jnp.where(growing, 1.0, 1.0 - ratio), jnp.maximum(now.contraction, eps) ** 0.8)
        done = (size_now == 0.0) | jnp.where(growing, size_now < _STALLED * rounding, left * size_now < 1.0)
        rises = now.rises + (growing & ~now.rose).astype(now.rises.dtype)
        second = again & ~now.again
        wavers = again & ((size_now < rounding / eps**0.5) | (second & enough(step)))
        done = done | (wavers & growing & (rises >= _RISES))
        failed = ~jnp.isfinite(size_now) | (growing & ~done & ~wavers & ~second)
        restart = (failed | (~done & (now.iterations >= most // 4))) & now.again
        secants = now.secants
        if secants is not None:
            step, secants = jax.lax.cond(
                second & later,
                _Secants.accelerated,
                lambda _, u, clear: (u, _Secants.none(u)),
                secants,
                step,
                ratio > _GROWN,
            )
        Z = now.Z - step
        if again:
            Z, size_now = jnp.where(restart, 0.0, Z), jnp.where(restart, 0.0, size_now)
        contraction = jnp.where(failed, 1.0, left)
        count, again_left = now.iterations + 1, now.again & ~restart
        return Newton(
            Z, size_now, done & ~failed, failed & ~restart, count, growing, rises, contraction, again_left, secants
        )

    eps = float(jnp.finfo(guess.dtype).eps)
    no, none, zero = jnp.asarray(False), jnp.zeros((), int), jnp.zeros((), guess.dtype)
    secants = _Secants.none(guess) if again else None
    start = Newton(guess, zero, no, no, none, no, none, contraction, jnp.asarray(again), secants)
    return jax.lax.while_loop(lambda n: ~n.done & ~n.failed & (n.iterations < most), iterate, start)


def combined(weights: Any, rows: Sequence[jax.Array]) -> list[jax.Array]:
    """The product weights @ rows as sums, because a matrix product may call a library."""
    return [functools.reduce(jnp.add, [float(w) * row for w, row in zip(line, rows, strict=True)]) for line in weights]


class Factors:
    """Solves (a^-1 x I - I x h J) X = R: an inverse for each real eigenvalue of a^-1, and for each complex pair.

    Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.8.
    """

    def __init__(self, tableau: CollocationTableau, inverses: tuple[Parts, ...]) -> None:
        self.tableau, count = tableau, len(tableau.real)
        self.real, self.pairs = inverses[:count], inverses[count:]

    @staticmethod
    def inverses_of(tableau: CollocationTableau, J: jax.Array, h: jax.Array) -> tuple[Parts, ...]:
        """The inverses for a step of length h."""
        eye, scaled = jnp.eye(J.shape[0], dtype=J.dtype), h * J
        real = [inverse((mu * eye - scaled,)) for mu in tableau.real]
        return (*real, *(inverse((mu.real * eye - scaled, mu.imag * eye)) for mu in tableau.pairs))

    @staticmethod
    def none(tableau: CollocationTableau, zero: jax.Array) -> tuple[Parts, ...]:
        """Zeros in place of inverses."""
        empty = jnp.zeros((zero.size, zero.size), zero.dtype)
        return (*((empty,) for _ in tableau.real), *((empty, empty) for _ in tableau.pairs))

    def solve(self, R: jax.Array) -> jax.Array:
        """The solution X (s, N)."""
        rows = combined(self.tableau.untransform, list(R))
        count = len(self.real)
        solution = [applied(inverse_, (row,))[0] for inverse_, row in zip(self.real, rows[:count], strict=True)]
        for inverse_, first, second in zip(self.pairs, rows[count::2], rows[count + 1 :: 2], strict=True):
            # The block [[p, q], [-q, p]] acts on (x, y) as p + iq on x - iy.
            x, y = applied(inverse_, (first, -second))
            solution += [x, -y]
        return jnp.stack(combined(self.tableau.transform, solution))

    def reach(self, sizes: jax.Array) -> jax.Array:
        """A rough bound of the result of `solve` for entries of these sizes."""
        parts = [jnp.sum(jnp.abs(part) * sizes[None, :], axis=1) for part in (self.real or self.pairs)[0]]
        return functools.reduce(jnp.add, parts)

    def damped(self, e: jax.Array) -> jax.Array:
        """An error estimate with damped stiff components: e for small h J, of the order of e / |h J|^2 for large h J.

        It takes two solves with I - g0 h J; without a real eigenvalue, one with (I - h J / mu) (I - h J / conj(mu)).
        """
        if self.real:
            mu = self.tableau.real[0]
            return applied(self.real[0], (mu * applied(self.real[0], (mu * e,))[0],))[0]
        mu_pair = self.tableau.pairs[0]
        # |mu|^2 / ((mu - x) (conj(mu) - x)) = -|mu|^2 Im(1 / (mu - x)) / Im(mu)
        imaginary = applied(self.pairs[0], (e, jnp.zeros_like(e)))[1]
        return (-(abs(mu_pair) ** 2) / mu_pair.imag) * imaginary


def inverse(matrix: Parts) -> Parts:
    """The inverse of a square matrix, by Gauss-Jordan elimination with partial pivoting; NaN for a singular matrix.

    An inverse is used in place of factors, because products with it are loops over independent numbers, while
    substitution is sequential. For Newton's method, which evaluates residuals, it is about as accurate.

    Source: Golub, Van Loan, Matrix Computations (2013), sections 3.4 and 3.5.
    """
    if matrix[0].shape[0] > _LARGEST:
        result = jnp.linalg.inv(matrix[0] if len(matrix) == 1 else jax.lax.complex(*matrix))
        return (result,) if len(matrix) == 1 else (result.real, result.imag)
    places = jnp.arange(matrix[0].shape[0])

    def eliminate(k: jax.Array, now: tuple[Parts, jax.Array]) -> tuple[Parts, jax.Array]:
        parts, order = now
        column = tuple(jax.lax.dynamic_index_in_dim(part, k, 1, keepdims=False) for part in parts)
        largest = jnp.argmax(jnp.where(places >= k, sum(jnp.abs(entry) for entry in column), -1.0)).astype(order.dtype)
        here, upper = places == k, tuple(part[k] for part in parts)
        pivot = _reciprocal(tuple(entry[largest] for entry in column))
        row = times(
            pivot, tuple(jnp.where(here, one, part[largest]) for one, part in zip((1.0, 0.0), parts, strict=False))
        )
        # Rows k and `largest` change places.
        column = tuple(jnp.where(here, 0.0, jnp.where(places == largest, entry[k], entry)) for entry in column)
        outer = times(tuple(entry[:, None] for entry in column), tuple(entry[None, :] for entry in row))
        parts = tuple(part.at[largest].set(a) for part, a in zip(parts, upper, strict=True))
        parts = tuple(
            (jnp.where(here[None, :], 0.0, part) - gone).at[k].set(a)
            for a, part, gone in zip(row, parts, outer, strict=True)
        )
        return parts, order.at[largest].set(order[k]).at[k].set(order[largest])

    parts, order = jax.lax.fori_loop(0, places.size, eliminate, (matrix, places))
    # Swaps of rows are swaps of columns of the inverse.
    back = jnp.argmax(order[:, None] == places[None, :], axis=0)
    return tuple(part[:, back] for part in parts)


def applied(matrix: Parts, vector: Parts) -> Parts:
    products = times(matrix, tuple(entry[None, :] for entry in vector))
    return tuple(jnp.sum(product, axis=1) for product in products)


def times(a: Parts, b: Parts) -> Parts:
    """The product of two numbers, entry by entry."""
    if len(a) == 1:
        return (a[0] * b[0],)
    return (a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


def _reciprocal(a: Parts) -> Parts:
    if len(a) == 1:
        return (1.0 / a[0],)
    # Scaled, so that no square overflows.
    scale = jnp.maximum(jnp.abs(a[0]), jnp.abs(a[1]))
    p, q = a[0] / scale, a[1] / scale
    square = scale * (p * p + q * q)
    return (p / square, -q / square)
