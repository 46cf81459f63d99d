"""Feasible points: Levenberg-Marquardt steps on the violation alone, dynamics included.

They reduce |defects|^2 + |c|^2 + |max(g, 0)|^2, all scaled, by the same equations as the Newton steps. Where they come
to rest with a violation left, the violation is stationary: the certificate of an infeasible problem.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .interior_point import InteriorPoint, in_units, largest
from .iterate import State
from .riccati import Rows, Stages, along_rows, factorize, solve
from .transcribed import Derivatives, Given, Point, Values

FIRST_DAMPING = 1e-2
_LEAST_DAMPING = 1e-10
#: The largest change of a duration in a step, relative: nothing pulls it down here.
_LARGEST_CHANGE = 0.5


class Search(NamedTuple):
    """Where the search for a feasible point stands."""

    point: Point
    values: Values
    damping: Any
    size: Any  # half the sum of squares
    slope: Any  # largest entry of its gradient before the step
    fall: Any  # what the step took off
    expected: Any  # what the model expected of it
    largest: Any  # largest violation


def begin(solver: InteriorPoint, state: State) -> Search:
    values = solver.scaled(state.values, state.scales)
    size, worst = _size(solver, values)
    zero = jnp.zeros_like(size)
    return Search(state.point, state.values, zero + FIRST_DAMPING, size, zero + jnp.inf, zero, zero + jnp.inf, worst)


def _residuals(solver: InteriorPoint, values: Values) -> jax.Array:
    rows = jnp.where(solver.inequality, jnp.maximum(values.rows, 0.0), values.rows)
    return jnp.where(solver.exists, rows, 0.0)


def _size(solver: InteriorPoint, values: Values) -> tuple[jax.Array, jax.Array]:
    rows = _residuals(solver, values)
    size = 0.5 * ((values.defects**2).sum() + (rows**2).sum())
    return size, jnp.maximum(jnp.abs(values.defects).max(initial=0.0), jnp.abs(rows).max(initial=0.0))


def at(search: Search, state: State) -> State:
    """The state at which derivatives for a step are taken: no multipliers."""
    none = jnp.zeros_like(state.dynamics), jnp.zeros_like(state.rows)
    return state._replace(point=search.point, values=search.values, dynamics=none[0], rows=none[1])


def reduce(solver: InteriorPoint, search: Search, state: State, slopes: Derivatives, given: Given) -> Search:
    """One step, taken if it reduces the violation, else the damping rises; with the derivatives at its point."""
    scales = state.scales
    slopes = slopes._replace(
        gradient=jnp.zeros_like(slopes.gradient),
        end_gradient=jnp.zeros_like(slopes.end_gradient),
        hessian=jnp.zeros_like(slopes.hessian),
        end_hessian=jnp.zeros_like(slopes.end_hessian),
    )
    values = solver.scaled(search.values, scales)
    rows = _residuals(solver, values)
    counts = solver.exists & (~solver.inequality | (values.rows > 0.0))
    weights = solver.split(jnp.where(counts, 1.0, 0.0))
    stages = Stages(slopes, weights, search.damping, jnp.ones_like(search.damping), solver.free_start)
    found = solve(stages, factorize(stages), slopes.gradient, slopes.end_gradient, values.defects, solver.split(rows))
    left: Rows = jax.tree.map(lambda w, a, r: w * (a + r), weights, along_rows(slopes, found.step), solver.split(rows))
    expected = search.size - 0.5 * sum((a**2).sum() for a in (found.dynamics, left.inner, left.end))
    step = found.step
    share = solver.in_chart(step, state._replace(point=search.point), _LARGEST_CHANGE)
    point = solver.move(search.point, in_units(step, scales, share))
    raw = solver.values(point, given)
    size, worst = _size(solver, solver.scaled(raw, scales))
    fall = search.size - size
    good = jnp.isfinite(size) & (fall > 1e-3 * share * expected)
    factor = jnp.where(good, jnp.where(fall > 0.75 * expected, 0.2, jnp.where(fall > 0.25 * expected, 1.0, 3.0)), 5.0)
    slope = largest(solver.lagrangian(slopes, values.defects, rows))
    taken = Search(point, raw, search.damping, size, slope, fall, expected, worst)
    kept = search._replace(slope=slope, fall=jnp.zeros_like(fall), expected=expected)
    after = jax.tree.map(lambda a, b: jnp.where(good, a, b), taken, kept)
    return after._replace(damping=jnp.maximum(factor * search.damping, _LEAST_DAMPING))
