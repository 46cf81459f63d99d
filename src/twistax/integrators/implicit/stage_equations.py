"""The equations of the stages of an implicit step, in coordinates around its start."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ...jax_inside import opened
from ...lowering import XLA, Dynamics
from ..charts.coordinates import Blocks, StateCoordinates
from ..method import VectorField
from .collocation import CollocationTableau
from .newton import combined

__all__ = ["StageEquations", "zero_coordinates"]

#: As arrays beyond this many scalars: they would take seconds to compile.
_LARGEST = 2000


def zero_coordinates(local: StateCoordinates, dynamics: Dynamics, y: Blocks) -> tuple[jax.Array, Callable[..., Blocks]]:
    """The coordinates of a stored state itself, packed, and how to read packed ones."""
    dtype = jax.tree.leaves(y)[0].dtype
    still = {name: jnp.zeros(group.dimension, dtype) for name, group in dynamics.group.factors.items()}
    return ravel_pytree(local.first_slope(y, local.rate(still)))


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
        field: VectorField,
        t: jax.Array,
        y: Blocks,
        h: jax.Array,
    ) -> None:
        self.tableau, self.local, self.field = tableau, local, field
        self.t, self.y, self.h = t, y, h
        self.zero, self.read = zero_coordinates(local, field.dynamics, y)

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
        # One after the other: XLA would compute a whole slope for every entry of a table of them.
        return jax.lax.map(lambda entry: self._slope(self.t + entry[0] * self.h, base, entry[1]), (nodes, Z))

    def start(self) -> tuple[jax.Array, jax.Array]:
        """The slope at the start of the step (N,), and its derivative with respect to the coordinates (N, N)."""

        def along(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda z: self._slope(self.t, self.y, z), (self.zero,), (direction,))

        eye = jnp.eye(self.zero.size, dtype=self.zero.dtype)
        # Most of it is zero, or the same in many columns: scalars leave that out.
        slope, jacobian = _in_scalars(lambda: list(jax.vmap(along, out_axes=(None, 1))(eye)))
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
        rate = self.local.rate(self.field(time, self.local.value(moved)))
        return ravel_pytree(self.local.slope(coordinates, moved, rate))[0]


def _in_scalars(function: Callable[[], list[jax.Array]]) -> list[jax.Array]:
    """function(), zeros and repeated parts left out where it is small enough: no array has more than 128 entries.

    It may close over traced values.
    """
    of, values = opened(jax.make_jaxpr(function)())
    return XLA(least=0, largest=_LARGEST).emit(jax.make_jaxpr(of)(*values)).function(*values)
