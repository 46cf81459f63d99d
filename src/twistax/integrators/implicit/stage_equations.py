"""The equations of the stages of an implicit step, in coordinates around its start."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ...lowering import Dynamics
from ..charts.whole import Blocks, StateCoordinates
from .collocation import CollocationTableau
from .in_scalars import in_scalars
from .inverses import Parts, applied, inverse

__all__ = ["Factors", "StageEquations", "combined", "zero_coordinates"]


def zero_coordinates(local: StateCoordinates, dynamics: Dynamics, y: Blocks) -> tuple[jax.Array, Callable[..., Blocks]]:
    """The coordinates of a stored state itself, packed, and how to read packed ones."""
    dtype = jax.tree.leaves(y)[0].dtype
    still = {name: jnp.zeros(group.dimension, dtype) for name, group in dynamics.group.factors.items()}
    return ravel_pytree(local.first_slope(y, local.rate(still)))


def combined(weights: Any, rows: Sequence[jax.Array]) -> list[jax.Array]:
    """weights @ rows as sums: a product of matrices may call a library."""
    return [functools.reduce(jnp.add, [float(w) * row for w, row in zip(line, rows, strict=True)]) for line in weights]


class StageEquations:
    """Z = h (a x I) K(Z) for the packed coordinates Z (s, N) of the stages of a step of length h from (t, y).

    With w_i = z_i the state of stage i is move(y, w_i), and its slope k_i that of the chart there. For a symmetric
    tableau coordinates are around the middle of the step instead: with D = sum_i d_i z_i and m = move(y, D/2) the state
    of stage i is move(m, w_i), w_i = z_i - D/2. Then the step of -h from the end leads back to the start.

    Source for the middle: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section V.4.
    """

    def __init__(
        self,
        tableau: CollocationTableau,
        local: StateCoordinates,
        rate: Callable[[jax.Array, Blocks], Blocks],
        dynamics: Dynamics,
        t: jax.Array,
        y: Blocks,
        h: jax.Array,
    ) -> None:
        self.tableau, self.local, self.rate = tableau, local, rate
        self.t, self.y, self.h = t, y, h
        self.zero, self.read = zero_coordinates(local, dynamics, y)

    def end(self, Z: jax.Array) -> jax.Array:
        """The coordinates of the end of the step around its start."""
        return combined([self.tableau.end], list(Z))[0]

    def slopes(self, Z: jax.Array) -> jax.Array:
        """K(Z), one stage a row."""
        base = self.y
        if self.tableau.symmetric:
            half = 0.5 * self.end(Z)
            base, Z = self.local.move(self.y, self.read(half)), Z - half[None, :]
        nodes = jnp.asarray(self.tableau.c, self.h.dtype)
        # One after the other: XLA would work out a whole slope for every entry of a table of them.
        return jax.lax.map(lambda entry: self._slope(self.t + entry[0] * self.h, base, entry[1]), (nodes, Z))

    def start(self) -> tuple[jax.Array, jax.Array]:
        """The slope at the start of the step (N,), and its derivative with respect to the coordinates (N, N)."""

        def along(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda z: self._slope(self.t, self.y, z), (self.zero,), (direction,))

        eye = jnp.eye(self.zero.size, dtype=self.zero.dtype)
        # Most of it is zero, or the same in many columns: scalars leave that out.
        slope, jacobian = in_scalars(lambda: list(jax.vmap(along, out_axes=(None, 1))(eye)))
        return slope, jacobian

    def first_slope(self) -> jax.Array:
        """The slope at the start of the step (N,)."""
        return self._slope(self.t, self.y, self.zero)

    def residual(self, Z: jax.Array) -> jax.Array:
        """a^-1 Z - h K(Z)."""
        return jnp.stack(combined(self.tableau.inverse, list(Z))) - self.h * self.slopes(Z)

    def _slope(self, time: jax.Array, base: Blocks, z: jax.Array) -> jax.Array:
        coordinates = self.read(z)
        moved = self.local.move(base, coordinates)
        return ravel_pytree(self.local.slope(coordinates, moved, self.rate(time, moved)))[0]


class Factors:
    """What solves (a^-1 x I - I x h J) X = R: one real inverse for each real eigenvalue of a^-1, a complex one for each
    pair.

    Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.8.
    """

    def __init__(self, tableau: CollocationTableau, inverses: tuple[Parts, ...]) -> None:
        self.tableau, self.inverses = tableau, inverses
        count = len(tableau.real)
        self.real, self.pairs = inverses[:count], inverses[count:]

    @staticmethod
    def found(tableau: CollocationTableau, J: jax.Array, h: jax.Array) -> tuple[Parts, ...]:
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
        """X (s, N)."""
        rows = combined(self.tableau.untransform, list(R))
        count = len(self.real)
        found = [applied(own, (row,))[0] for own, row in zip(self.real, rows[:count], strict=True)]
        for own, first, second in zip(self.pairs, rows[count::2], rows[count + 1 :: 2], strict=True):
            # The block [[p, q], [-q, p]] acts on (x, y) as p + iq on x - iy.
            x, y = applied(own, (first, -second))
            found += [x, -y]
        return jnp.stack(combined(self.tableau.transform, found))

    def reach(self, sizes: jax.Array) -> jax.Array:
        """How large what `solve` makes of entries of these sizes may be, roughly."""
        found = [jnp.sum(jnp.abs(part) * sizes[None, :], axis=1) for part in (self.real or self.pairs)[0]]
        return functools.reduce(jnp.add, found)

    def damped(self, e: jax.Array) -> jax.Array:
        """An error with what stiff parts add to it damped: e for h J small, of the order of e / |h J|^2 for it large.

        Two solves with I - g0 h J; without a real eigenvalue one with (I - h J / mu) (I - h J / conj(mu)).
        """
        if self.real:
            mu = self.tableau.real[0]
            return applied(self.real[0], (mu * applied(self.real[0], (mu * e,))[0],))[0]
        mu_pair = self.tableau.pairs[0]
        # |mu|^2 / ((mu - x) (conj(mu) - x)) = -|mu|^2 Im(1 / (mu - x)) / Im(mu)
        imaginary = applied(self.pairs[0], (e, jnp.zeros_like(e)))[1]
        return (-(abs(mu_pair) ** 2) / mu_pair.imag) * imaginary
