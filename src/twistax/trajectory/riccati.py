"""The Newton equations of a problem in stages, factored from the last stage to the first.

The step (d, u, b) minimises

    sum over stages  z'H z / 2 + a'z + sum over rows  weight (J z + r)^2 / 2,   z_k = [d_k, u_k, b],

subject to d_(k+1) = F z_k + c_k; the border b (g,) is shared by all stages. The value of what follows a node
is quadratic in (d, b). A Riccati recursion carries it back, so the work grows with the number of stages, and the
equations have the inertia of a minimum exactly if every Cholesky factor exists.
Source: Rao, Wright, Rawlings, Application of interior-point methods to model predictive control (1998), section 3.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .transcribed import Derivatives, Step

#: How often a solution is refined.
_REFINEMENTS = 2


class Rows(NamedTuple):
    """Something for each row: of the intervals (intervals, R), and of the end (R_end,)."""

    inner: Any
    end: Any


class Stages(NamedTuple):
    """What is factored: derivatives, weights of the rows, and what is added to the diagonal."""

    slopes: Derivatives
    weights: Rows
    damping: Any
    free_start: Any  # (n + g,) of [d_0, b]: bool


class Factors(NamedTuple):
    """The factors of the equations; `exist` says whether all of them do, and so whether there is a minimum."""

    gains: Any  # (intervals, m, n + g)
    controls: Any  # (intervals, m, m) inverse Cholesky factors: products cost less than solves of a few rows
    costs: Any  # (intervals, n + g, n + g) cost of what follows
    start: Any  # (n + g, n + g) upper Cholesky factor
    exist: Any


class Solution(NamedTuple):
    """A step with the multipliers of the dynamics, and the growth of the weighted rows, weight (J z + r)."""

    step: Step
    dynamics: Any  # (intervals, n)
    rows: Rows


def factorize(stages: Stages) -> Factors:
    """Factor from the end to the start."""
    slopes, weights = stages.slopes, stages.weights
    n, m, g = _sizes(slopes)
    dtype = slopes.hessian.dtype
    end = slopes.end_hessian + (slopes.end_rows * weights.end[:, None]).T @ slopes.end_rows
    end = end + stages.damping * jnp.eye(n + g, dtype=dtype)
    lift = jnp.asarray(np.diag(np.repeat([1.0, 0.0], [n + m, g])), dtype)
    shared = jnp.eye(g, n + m + g, n + m, dtype=dtype)

    def back(cost: jax.Array, stage: Any) -> tuple[jax.Array, Any]:
        hessian, dynamics, rows, weight = stage
        ahead = jnp.concatenate([dynamics, shared])
        whole = hessian + stages.damping * lift + (rows * weight[:, None]).T @ rows
        whole = whole + ahead.T @ (cost.T @ ahead)
        # By substitution and as squares, not by inverses: what cancels tells whether there is a minimum.
        upper, left = _eliminated(whole, n, m)
        own = upper[:, n : n + m]
        solved = _substituted(own, jnp.concatenate([_without(upper.T, n, m).T, jnp.eye(m, dtype=dtype)], axis=1))
        before = _without(_without(left, n, m).T, n, m)
        return 0.5 * (before + before.T), (-solved[:, : n + g], solved[:, n + g :].T, cost)

    first, (gains, controls, costs) = jax.lax.scan(
        back, end, (slopes.hessian, slopes.defects, slopes.rows, weights.inner), reverse=True
    )
    free = stages.free_start
    start, _ = _eliminated(jnp.where(free[:, None] & free[None, :], first, jnp.eye(n + g, dtype=dtype)), 0, n + g)
    exist = jnp.stack([jnp.isfinite(a).all() for a in (controls, start)]).all()
    return Factors(gains, controls, costs, start, exist)


def solve(
    stages: Stages, factors: Factors, pull: jax.Array, end_pull: jax.Array, defects: jax.Array, rows: Rows
) -> Solution:
    """The step for the linear terms a (intervals, n + m + g) and (n + g,), the constants c, and the constants r."""
    slopes, weights = stages.slopes, stages.weights
    n, m, _ = _sizes(slopes)
    end_pull = end_pull + slopes.end_rows.T @ (weights.end * rows.end)

    def back(tilt: jax.Array, stage: Any) -> tuple[jax.Array, Any]:
        own, jacobian, pushed, dynamics, constant, gains, controls, cost = stage
        slope = tilt + cost[:, :n] @ constant
        whole = own + jacobian.T @ pushed + dynamics.T @ slope[:n]
        whole = whole + jnp.concatenate([jnp.zeros(n + m, whole.dtype), slope[n:]])
        inner = whole[n : n + m]
        push = -(controls.T @ (controls @ inner))
        return _without(whole, n, m) + gains.T @ inner, (push, tilt)

    tilt, (pushes, tilts) = jax.lax.scan(
        back,
        end_pull,
        (
            *(pull, slopes.rows, weights.inner * rows.inner, slopes.defects, defects),
            *(factors.gains, factors.controls, factors.costs),
        ),
        reverse=True,
    )
    begin = -_solved(factors.start, jnp.where(stages.free_start, tilt, 0.0))
    border = begin[n:]

    def ahead(d: jax.Array, stage: Any) -> tuple[jax.Array, Any]:
        dynamics, constant, jacobian, weight, own, gains, push, cost, tilt = stage
        u = gains @ jnp.concatenate([d, border]) + push
        z = jnp.concatenate([d, u, border])
        reached = dynamics @ z + constant
        multipliers = cost[:n] @ jnp.concatenate([reached, border]) + tilt[:n]
        grown = weight * (jacobian @ z + own)
        return reached, (d, u, multipliers, grown)

    last, (ds, us, multipliers, grown) = jax.lax.scan(
        ahead,
        begin[:n],
        (
            *(slopes.defects, defects, slopes.rows, weights.inner, rows.inner),
            *(factors.gains, pushes, factors.costs, tilts),
        ),
    )
    step = Step(jnp.concatenate([ds, last[None]]), us, border)
    at_end = weights.end * (slopes.end_rows @ jnp.concatenate([last, border]) + rows.end)
    return Solution(step, multipliers, Rows(grown, at_end))


def refined(stages: Stages, factors: Factors, defects: jax.Array, rows: Rows) -> Solution:
    """The solution for the gradient of the stages' costs, with whole multipliers, refined against rounding."""
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
    n, m, g = _sizes(slopes)
    lift = jnp.asarray(np.repeat([1.0, 0.0], [n + m, g]), z.dtype)

    def left(weight: jax.Array, moved: jax.Array, own: jax.Array, grown: jax.Array) -> jax.Array:
        return jnp.where(weight > 0.0, moved + own - grown / jnp.where(weight > 0.0, weight, 1.0), 0.0)

    def stage(own: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        gradient, hessian, dynamics, jacobian, weight, z, y, w, defect, row = own
        pull = gradient + hessian @ z + stages.damping * lift * z + dynamics.T @ y + jacobian.T @ w
        return pull, dynamics @ z + defect, left(weight, jacobian @ z, row, w)

    inner, gap, rows = jax.vmap(stage)(
        (
            *(slopes.gradient, slopes.hessian, slopes.defects, slopes.rows, weights.inner),
            *(z, found.dynamics, found.rows.inner, defects, constant.inner),
        ),
    )
    before = jnp.concatenate([jnp.zeros_like(found.dynamics[:1]), found.dynamics[:-1]])
    inner = inner - jnp.concatenate([before, jnp.zeros((len(z), m + g), z.dtype)], axis=1)
    last = slopes.end_gradient + slopes.end_hessian @ end + stages.damping * end
    last = last + slopes.end_rows.T @ found.rows.end
    last = last - jnp.concatenate([found.dynamics[-1], jnp.zeros(g, z.dtype)])
    at_end = left(weights.end, slopes.end_rows @ end, constant.end, found.rows.end)
    return solve(stages, factors, inner, last, gap - found.step.d[1:], Rows(rows, at_end))


def of_stages(step: Step) -> tuple[Any, Any]:
    """z_k = [d_k, u_k, b] (intervals, n + m + g), and [d, b] of the end; of NumPy's arrays by NumPy."""
    own: Any = np if isinstance(step.u, np.ndarray) else jnp
    borders = own.broadcast_to(step.border, (step.u.shape[0], *step.border.shape))
    return own.concatenate([step.d[:-1], step.u, borders], axis=1), own.concatenate([step.d[-1], step.border])


def to_step(inner: jax.Array, end: jax.Array, n: int) -> Step:
    """The sum of the stages' contributions to every unknown; adjoint of `of_stages`."""
    d, u, border = jnp.split(inner, [n, inner.shape[1] - len(end) + n], axis=1)
    return Step(jnp.concatenate([d, end[None, :n]]), u, border.sum(axis=0) + end[n:])


# ---- factors of small matrices: by loops, where XLA would call a library ---------------------------------------------


def _eliminated(matrix: jax.Array, first: int, count: int) -> tuple[jax.Array, jax.Array]:
    """Cholesky's elimination of some columns: its rows (count, N), and matrix - rows.T @ rows; NaN if not positive."""

    def eliminate(left: jax.Array, j: jax.Array) -> tuple[jax.Array, jax.Array]:
        row = jax.lax.dynamic_index_in_dim(left, j, keepdims=False)
        pivot = jax.lax.dynamic_index_in_dim(row, j, keepdims=False)
        row = row / jnp.sqrt(jnp.where(pivot > 0.0, pivot, jnp.nan))
        return left - row[:, None] * row[None], row

    left, rows = jax.lax.scan(eliminate, matrix, jnp.arange(first, first + count))
    return rows, left


def _substituted(upper: jax.Array, right: jax.Array) -> jax.Array:
    """upper^-1 right (k, c), of a triangular matrix. What is below its diagonal is not used."""
    if not len(right):  # a stage without controls
        return right

    def row(found: jax.Array, own: Any) -> tuple[jax.Array, None]:
        j, coefficients, values = own
        pivot = jax.lax.dynamic_index_in_dim(coefficients, j, keepdims=False)
        here = (values - found.T @ coefficients) / pivot
        return jax.lax.dynamic_update_index_in_dim(found, here, j, 0), None

    return jax.lax.scan(row, jnp.zeros_like(right), (np.arange(len(right)), upper, right), reverse=True)[0]


def _solved(upper: jax.Array, right: jax.Array) -> jax.Array:
    """(upper.T @ upper)^-1 right (k,)."""

    def ahead(left: jax.Array, own: Any) -> tuple[jax.Array, jax.Array]:
        j, row = own
        # Not left / row: the transpose of that would divide zeros by the zeros before the diagonal.
        entry, pivot = (jax.lax.dynamic_index_in_dim(a, j, keepdims=False) for a in (left, row))
        value = entry / pivot
        return left - row * value, value

    found = jax.lax.scan(ahead, right, (np.arange(len(right)), upper))[1]
    return _substituted(upper, found[:, None])[:, 0]


def _without(a: jax.Array, first: int, count: int) -> jax.Array:
    """Without so many rows."""
    return jnp.concatenate([a[:first], a[first + count :]])


def _sizes(slopes: Derivatives) -> tuple[int, int, int]:
    """n, m and g."""
    n, g = slopes.defects.shape[1], slopes.end_gradient.shape[0] - slopes.defects.shape[1]
    return n, slopes.defects.shape[2] - n - g, g
