"""The Newton equations of a problem in stages, factored from the last stage to the first.

The step (d, u, b) minimises

    sum over stages  z'H z / 2 + a'z + sum over rows  weight (J z + r)^2 / 2,   z_k = [d_k, u_k, b],

subject to d_(k+1) = F z_k + c_k; the border b (g,) is shared by all stages. The dynamics may be softened: a slack e
costs e^2 / (2 soft). The value of what follows a node is quadratic in (d, b). A Riccati recursion carries it back, so
the work grows with the number of stages, and the equations have the inertia of a minimum exactly if every Cholesky
factor exists.
Source: Rao, Wright, Rawlings, Application of interior-point methods to model predictive control (1998), section 3.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve, solve_triangular

from .transcribed import Derivatives, Step

#: How often a solution is refined.
_REFINEMENTS = 2


class Rows(NamedTuple):
    """Something for each row: of the intervals (intervals, R), and of the end (R_end,)."""

    inner: Any
    end: Any


class Stages(NamedTuple):
    """What is factored: derivatives, weights of the rows, what is added to the diagonal, how soft the dynamics are.

    Where they are hard `soft` is None, which spares half of the work at a stage.
    """

    slopes: Derivatives
    weights: Rows
    damping: Any
    soft: Any
    free_start: Any  # (n + g,) of [d_0, b]: bool


class Factors(NamedTuple):
    """The factors of the equations; `exist` says whether all of them do, and so whether there is a minimum."""

    gains: Any  # (intervals, m, n + g)
    controls: Any  # (intervals, m, m) inverse Cholesky factors: products cost less than solves of a few rows
    costs: Any  # (intervals, n + g, n + g) softened cost of what follows
    softening: Any  # (intervals, n, n) Cholesky factors of I + soft P, None where the dynamics are hard
    start: Any  # (n + g, n + g) Cholesky factor
    exist: Any


class Solution(NamedTuple):
    """A step with the multipliers of the dynamics, and the growth of the weighted rows, weight (J z + r)."""

    step: Step
    dynamics: Any  # (intervals, n)
    rows: Rows


def factorize(stages: Stages) -> Factors:
    """Factor from the end to the start."""
    slopes, weights, soft = stages.slopes, stages.weights, stages.soft
    n, m, g = _sizes(slopes)
    outer, inner = _indices(n, m, g)
    end = slopes.end_hessian + (slopes.end_rows.T * weights.end[None]) @ slopes.end_rows
    end = end + stages.damping * jnp.eye(n + g, dtype=end.dtype)
    condensed = slopes.hessian + jnp.einsum("kra,kr,krb->kab", slopes.rows, weights.inner, slopes.rows)
    lift = jnp.repeat(jnp.array([1.0, 0.0], end.dtype), np.array([n + m, g]))
    condensed = condensed + stages.damping * jnp.diag(lift)[None]

    def back(cost: jax.Array, stage: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, Any]:
        own, dynamics = stage
        softer, softening = cost, None
        if soft is not None:
            softening = jnp.linalg.cholesky(jnp.eye(n, dtype=own.dtype) + soft * cost[:n, :n])
            halved = cho_solve((softening, True), cost[:n])
            softer = jnp.concatenate([halved, cost[n:] - soft * cost[n:, :n] @ halved])
        whole = own + _lifted(softer, dynamics)
        lower = jnp.linalg.cholesky(whole[jnp.ix_(inner, inner)])
        controls = solve_triangular(lower, jnp.eye(m, dtype=own.dtype), lower=True)
        # By solves and as a square, not by these: what cancels tells whether there is a minimum.
        half = solve_triangular(lower, whole[jnp.ix_(inner, outer)], lower=True)
        gains = -solve_triangular(lower, half, lower=True, trans="T")
        before = whole[jnp.ix_(outer, outer)] - half.T @ half
        return 0.5 * (before + before.T), (gains, controls, softer, softening)

    first, (gains, controls, costs, softening) = jax.lax.scan(back, end, (condensed, slopes.defects), reverse=True)
    free = stages.free_start
    start = jnp.linalg.cholesky(jnp.where(free[:, None] & free[None, :], first, jnp.eye(n + g, dtype=first.dtype)))
    exist = jnp.stack([jnp.isfinite(a).all() for a in jax.tree.leaves((controls, start, softening))]).all()
    return Factors(gains, controls, costs, softening, start, exist)


def solve(
    stages: Stages, factors: Factors, pull: jax.Array, end_pull: jax.Array, defects: jax.Array, rows: Rows
) -> Solution:
    """The step for the linear terms a (intervals, n + m + g) and (n + g,), the constants c, and the constants r."""
    slopes, weights, soft = stages.slopes, stages.weights, stages.soft
    n, m, g = _sizes(slopes)
    outer, inner = _indices(n, m, g)
    pull = pull + jnp.einsum("kra,kr->ka", slopes.rows, weights.inner * rows.inner)
    end_pull = end_pull + slopes.end_rows.T @ (weights.end * rows.end)

    def back(tilt: jax.Array, stage: Any) -> tuple[jax.Array, Any]:
        own, dynamics, constant, gains, controls, cost, softening = stage
        softer = tilt
        if soft is not None:
            halved = cho_solve((softening, True), tilt[:n])
            softer = jnp.concatenate([halved, tilt[n:] - soft * cost[:n, n:].T @ tilt[:n]])
        slope = softer + cost[:, :n] @ constant
        whole = own + dynamics.T @ slope[:n]
        whole = whole.at[n + m :].add(slope[n:])
        push = -controls.T @ (controls @ whole[inner])
        return whole[outer] + gains.T @ whole[inner], (push, softer)

    tilt, (pushes, softer) = jax.lax.scan(
        back,
        end_pull,
        (pull, slopes.defects, defects, factors.gains, factors.controls, factors.costs, factors.softening),
        reverse=True,
    )
    free = stages.free_start
    begin = -cho_solve((factors.start, True), jnp.where(free, tilt, 0.0))
    border = begin[n:]

    def ahead(d: jax.Array, stage: Any) -> tuple[jax.Array, Any]:
        dynamics, constant, gains, push, cost, tilt = stage
        u = gains @ jnp.concatenate([d, border]) + push
        reached = dynamics @ jnp.concatenate([d, u, border]) + constant
        multipliers = (cost @ jnp.concatenate([reached, border]) + tilt)[:n]
        return reached if soft is None else reached - soft * multipliers, (d, u, multipliers)

    last, (ds, us, multipliers) = jax.lax.scan(
        ahead, begin[:n], (slopes.defects, defects, factors.gains, pushes, factors.costs, softer)
    )
    step = Step(jnp.concatenate([ds, last[None]]), us, border)
    moved = along_rows(slopes, step)
    grown = Rows(weights.inner * (moved.inner + rows.inner), weights.end * (moved.end + rows.end))
    return Solution(step, multipliers, grown)


def refined(stages: Stages, factors: Factors, defects: jax.Array, rows: Rows) -> Solution:
    """The solution for the gradient of the stages' costs, with whole multipliers, refined against rounding.

    The dynamics are hard.
    """
    slopes = stages.slopes
    count = len(slopes.defects)
    n, m, g = _sizes(slopes)
    zero = Solution(
        Step(jnp.zeros((count + 1, n)), jnp.zeros((count, m)), jnp.zeros(g)),
        jnp.zeros_like(defects),
        jax.tree.map(jnp.zeros_like, rows),
    )

    def refine(_: Any, found: Solution) -> Solution:
        return jax.tree.map(jnp.add, found, _correction(stages, factors, found, defects, rows))

    return jax.lax.fori_loop(0, 1 + _REFINEMENTS, refine, zero)


def _correction(stages: Stages, factors: Factors, found: Solution, defects: jax.Array, constant: Rows) -> Solution:
    """The solution for what a solution leaves of the equations."""
    slopes, weights = stages.slopes, stages.weights
    z, end = of_stages(found.step)
    moved = along_rows(slopes, found.step)
    n, m, g = _sizes(slopes)
    lift = jnp.repeat(jnp.array([1.0, 0.0], z.dtype), np.array([n + m, g]))
    inner = slopes.gradient + jnp.einsum("kab,kb->ka", slopes.hessian, z) + stages.damping * lift[None] * z
    inner = inner + jnp.einsum("kn,kna->ka", found.dynamics, slopes.defects)
    inner = inner + jnp.einsum("kr,kra->ka", found.rows.inner, slopes.rows)
    inner = inner.at[1:, :n].add(-found.dynamics[:-1])
    last = slopes.end_gradient + slopes.end_hessian @ end + stages.damping * end + found.rows.end @ slopes.end_rows
    last = last.at[:n].add(-found.dynamics[-1])
    gap = jnp.einsum("kna,ka->kn", slopes.defects, z) + defects - found.step.d[1:]

    def left(weight: jax.Array, moved: jax.Array, own: jax.Array, grown: jax.Array) -> jax.Array:
        return jnp.where(weight > 0.0, moved + own - grown / jnp.where(weight > 0.0, weight, 1.0), 0.0)

    rows = Rows(
        left(weights.inner, moved.inner, constant.inner, found.rows.inner),
        left(weights.end, moved.end, constant.end, found.rows.end),
    )
    return solve(stages, factors, inner, last, gap, rows)


def along_rows(slopes: Derivatives, step: Step) -> Rows:
    """J z of all rows."""
    z, end = of_stages(step)
    return Rows(jnp.einsum("kra,ka->kr", slopes.rows, z), slopes.end_rows @ end)


def of_stages(step: Step) -> tuple[Any, Any]:
    """z_k = [d_k, u_k, b] (intervals, n + m + g), and [d, b] of the end; of NumPy's arrays by NumPy."""
    own: Any = np if isinstance(step.u, np.ndarray) else jnp
    borders = own.broadcast_to(step.border, (step.u.shape[0], *step.border.shape))
    return own.concatenate([step.d[:-1], step.u, borders], axis=1), own.concatenate([step.d[-1], step.border])


def to_step(inner: jax.Array, end: jax.Array, n: int) -> Step:
    """The sum of the stages' contributions to every unknown; adjoint of `of_stages`."""
    d, u, border = jnp.split(inner, [n, inner.shape[1] - len(end) + n], axis=1)
    return Step(jnp.concatenate([d, end[None, :n]]), u, border.sum(axis=0) + end[n:])


def _lifted(cost: jax.Array, dynamics: jax.Array) -> jax.Array:
    """The cost of what follows in terms of [d, u, b]."""
    n = dynamics.shape[0]
    own = dynamics.shape[1] - cost.shape[0] + n
    corner = dynamics.T @ cost[:n, n:]
    whole = dynamics.T @ cost[:n, :n] @ dynamics
    return whole.at[:, own:].add(corner).at[own:].add(corner.T).at[own:, own:].add(cost[n:, n:])


def _sizes(slopes: Derivatives) -> tuple[int, int, int]:
    """n, m and g."""
    n, g = slopes.defects.shape[1], slopes.end_gradient.shape[0] - slopes.defects.shape[1]
    return n, slopes.defects.shape[2] - n - g, g


def _indices(n: int, m: int, g: int) -> tuple[Any, Any]:
    """Where [d, b] and u sit in [d, u, b]."""
    return np.array([*range(n), *range(n + m, n + m + g)]), np.arange(n, n + m)
