"""Runge-Kutta-Munthe-Kaas methods: Runge-Kutta methods in coordinates around the start of each step, and the loop over
stages.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray

from ...checks import instance
from ...errors import ModelError
from ...scalar.small_call import inside_small_call, stored_once
from ...system.dynamics import Arrays, Dynamics
from ..charts.chart import Chart, Exponential, chart_of
from ..charts.coordinates import Blocks
from ..method import Carry, ChartMethod, StepAttempt, VectorField
from ..step_control import Tolerances
from ..tableaus import ButcherTableau, StageRows
from .interpolant import interpolant

Extra = TypeVar("Extra")


@dataclasses.dataclass(frozen=True)
class RKMK(ChartMethod):
    """The explicit Runge-Kutta-Munthe-Kaas method of a tableau in a chart.

    On states without a group it is the Runge-Kutta method. Methods with equal tableaus and charts are equal.

    Attributes:
        tableau: the coefficients.
        chart: the coordinates around the start of a step, a `tx.charts.Chart`; by default exponential coordinates with
            as many commutators as the order requires.

    Raises:
        ModelError: the tableau or the chart has another type.

    Source: Munthe-Kaas, High order Runge-Kutta methods on manifolds (1999); Iserles, Munthe-Kaas, Norsett, Zanna,
    Lie-group methods (2000), both for right-trivialised equations, where the Jacobian is the left one.

    Example: `tx.integrate(dynamics, x0, t1=1.0, dt=0.01, method=tx.RKMK(tx.tableaus.RK4))`
    """

    tableau: ButcherTableau
    chart: Chart | None = None

    def __post_init__(self) -> None:
        instance("RKMK", self.tableau, ButcherTableau, "a tableau like tx.tableaus.RK4", ModelError)
        default = Exponential(commutators=max(1, self.tableau.order - 2))
        object.__setattr__(self, "chart", chart_of("RKMK", self.chart, default))

    @property
    def evaluations(self) -> int:
        return len(self.tableau.counted.c)

    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The stored state after one step of length h. Pure and traceable.

        Round-off takes rotations out of their group, linearly in the number of steps if the twist is constant; the
        correction in each step keeps the error at round-off.
        """
        local = self.coordinates(field.dynamics)

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, None]:
            moved = stored_once(local.move(y, z))
            return local.slope(z, moved, stored_once(self.rate(field, time, moved))), None

        first = local.first_slope(y, self.rate(field, t, y))
        slopes, _ = stage_slopes(self.tableau.counted, slope, first, None, t, h)
        return local.settle(local.move(y, slopes.combine(self.tableau.b, h)))

    def sampled(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> StepAttempt:
        """The step of `advance`, with the rate at its end, which the polynomial between its ends also uses."""
        slopes, (moved, _), count = self._to_the_end(field, t, y, self.rate(field, t, y), h)
        end = self.coordinates(field.dynamics).settle(moved)
        return StepAttempt(end, carry, (), count, slopes=jax.vmap(slopes.read)(slopes.rows))

    def attempt(
        self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array, tolerances: Tolerances
    ) -> StepAttempt:
        """A step whose last stage is its end, so the next step reuses the rate there."""
        tableau = self.tableau
        slopes, (moved, rate), count = self._to_the_end(field, t, y, carry, h)
        embedded = [w for w in (tableau.b_embedded, tableau.b_second_embedded) if w is not None]
        errors = tuple(slopes.combine(tableau.b - weights, h) for weights in embedded)
        end = self.coordinates(field.dynamics).settle(moved)
        return StepAttempt(end, rate, errors, count - 1, slopes=jax.vmap(slopes.read)(slopes.rows))

    def _to_the_end(
        self, field: VectorField, t: jax.Array, y: Blocks, rate: Blocks, h: jax.Array
    ) -> tuple[Slopes, tuple[Blocks, Blocks], int]:
        """The slopes of all stages up to the end of the step, the state and the rate there, and their number."""
        local = self.coordinates(field.dynamics)
        (start, read_state), (packed, read_rate) = ravel_pytree(y), ravel_pytree(rate)

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, tuple[jax.Array, jax.Array]]:
            moved = stored_once(local.move(y, z))
            rate = stored_once(self.rate(field, time, moved))
            # Packed: else the loop carries every scalar separately.
            return local.slope(z, moved, rate), (ravel_pytree(moved)[0], ravel_pytree(rate)[0])

        stages = self.tableau.to_the_end
        slopes, (moved, last) = stage_slopes(stages, slope, local.first_slope(y, rate), (start, packed), t, h)
        return slopes, (read_state(moved), read_rate(last)), len(stages.c)

    def need_polynomial(self) -> None:
        return

    def between(self, dynamics: Dynamics, y: Blocks, h: jax.Array, slopes: Any, share: jax.Array) -> Blocks:
        local, table = self.coordinates(dynamics), jnp.asarray(interpolant(self.tableau).weights, h.dtype)
        weights = functools.reduce(lambda sums, column: sums * share + column, reversed(table.T))
        weights = h * share * weights
        # A sum: a product of matrices would be a library call for each of many rows.
        z = jax.tree.map(lambda k: (weights.reshape(-1, *(1,) * (k.ndim - 1)) * k).sum(0), slopes)
        return local.settle(local.move(y, z))

    def increment(self, field: VectorField, t: jax.Array, x: Arrays, h: jax.Array) -> Arrays:
        """The tangent eta of one step, so that the step ends at x (+) eta = x Exp(eta).

        With Omega(t, x) the body velocities of all states, stage i is at x Exp(eta_i), with

            eta_i = h sum_j a_ij k_j,   k_i = J_r(eta_i)^-1 Omega(t + c_i h, x Exp(eta_i)),   eta = h sum_i b_i k_i,

        because eta' = J_r(eta)^-1 Omega for g = g_0 Exp(eta) and g' = g Omega^, with J_r the right Jacobian, whose
        series is truncated after the chart's commutators. It is the step of `advance` on the values themselves, for
        derivatives.

        Returns:
            name -> tangent (dimension of the state,), of states without a group read row by row.
        Raises:
            ModelError: a chart whose coordinates are not tangents.
        """
        local, factors = self.coordinates(field.dynamics), field.dynamics.group.factors

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, None]:
            eta = local.tangent(z)
            point = {name: group.retract(x[name], eta[name]) for name, group in factors.items()}
            return local.slope(z, z, local.rate(field(time, point))), None

        # At the start of a step exponential coordinates change as the body velocity does.
        slopes, _ = stage_slopes(self.tableau.counted, slope, local.rate(field(t, x)), None, t, h)
        return local.tangent(slopes.combine(self.tableau.b, h))


# ---- the stages of an explicit method: one loop for every tableau, on any pytree of slopes -------------------------


class Slopes(NamedTuple):
    """The slopes of all stages as rows, and the function that unpacks a row."""

    rows: jax.Array
    read: Callable[[jax.Array], Any]

    def combine(self, weights: Any, h: jax.Array) -> Any:
        """The sum h sum_i weights[i] k_i over the existing stages; stages beyond the weights have weight zero.

        For several rows of weights, a list of combinations.
        """
        table = np.zeros((*np.shape(weights)[:-1], len(self.rows)))
        known = np.asarray(weights)[..., : len(self.rows)]
        table[..., : known.shape[-1]] = known
        small = inside_small_call()
        combined = _sum(table, self.rows) if small else _weighted(jnp.asarray(table, self.rows.dtype), self.rows)
        return _read(self.read, h * combined)


def stage_slopes(
    stages: StageRows,
    slope: Callable[[jax.Array, Any], tuple[Any, Extra]],
    first: Any,
    extra: Extra,
    t: jax.Array,
    h: jax.Array,
) -> tuple[Slopes, Extra]:
    """k_1, k_2, ... with k_i = slope(t + c_i h, h sum_j a_ij k_j) and k_1 = first, by a loop over the stages.

    The loop is traced once for any tableau: a step of thirteen stages compiles as fast as one of four, and as one small
    function it runs as fast as unrolled code. Pure and traceable, and differentiable in both modes. If `a` has a list
    of rows for every stage, `slope` takes the list of combinations. It also returns additional data of the stage, of
    which those of the last stage are returned; `extra` are the data of the first one.
    """
    start, read = ravel_pytree(first)
    a, c = (np.asarray(table) for table in stages)
    count = len(c)
    rows = jnp.zeros((count, start.size), start.dtype).at[0].set(start)
    # Inside a small function a branch for every stage, without the zeros of the tableau; elsewhere, where branches are
    # slow, a row of weights.
    branches = [lambda rows, row=row: _sum(row, rows) for row in a[1:]] if inside_small_call() else []
    weights = None if branches else jnp.asarray(a, start.dtype)

    def stage(carried: tuple[jax.Array, Extra], entry: tuple[jax.Array, jax.Array]) -> tuple[Any, None]:
        rows, _ = carried
        number, node = entry
        if weights is None:
            reached = jax.lax.switch(number - 1, branches, rows)
        else:
            reached = _weighted(weights[number], rows)
        rate, extra = slope(t + node * h, _read(read, h * reached))
        k = ravel_pytree(rate)[0]
        return (jax.lax.dynamic_update_index_in_dim(rows, k, number, 0, allow_negative_indices=False), extra), None

    if count > 1:
        (rows, extra), _ = jax.lax.scan(stage, (rows, extra), (jnp.arange(1, count), jnp.asarray(c[1:], start.dtype)))
    return Slopes(rows, read), extra


def _read(read: Callable[[jax.Array], Any], combined: jax.Array) -> Any:
    return read(combined) if combined.ndim == 1 else [read(row) for row in combined]


def _sum(weights: NDArray[Any], rows: jax.Array) -> jax.Array:
    """weights @ rows for known weights, term by term, without zeros."""
    if weights.ndim == 2:
        return jnp.stack([_sum(row, rows) for row in weights])
    terms = [float(weights[j]) * rows[j] for j in np.flatnonzero(weights)]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros_like(rows[0])


def _weighted(weights: jax.Array, rows: jax.Array) -> jax.Array:
    """weights @ rows as a sum: a matrix product may call a library, or lose digits on an accelerator."""
    return jnp.sum(weights[..., None] * (rows if weights.ndim == 1 else rows[None]), axis=-2)
