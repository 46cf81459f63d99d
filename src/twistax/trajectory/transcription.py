"""Multiple shooting in the tangent space: one traced function gives every residual of a problem and its derivatives.

The unknowns are a step (d_0, du_0, ..., d_(N-1), du_(N-1), dT) away from the current nodes x_k, held controls u_k and
final time T; the nodes move by x_k (+) d_k, so the chart is re-based at every iterate. An interval sees
[d_k, du_k, d_(k+1), du_(k+1), dT]. Its rows are

    Log(x_(k+1)^-1 end(x_k, u_k))      the defect, n equalities
    path constraints and boxes         at the ends of the substeps
    conditions on the final node       in the last interval
    limits of the final time           in the last interval
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Expr, Inputs, evaluate_all
from ..integrators import RKMK
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .discretize import Controls, rollout, value_and_jacobian
from .statement import FinalRows, Objective, PathRows


class Iterate(NamedTuple):
    """Where an optimisation stands: states (nodes, ...), flat controls (nodes - 1, m), final time."""

    xs: Arrays
    us: Any
    final_time: Any


class Evaluation(NamedTuple):
    """Everything an optimiser needs at an iterate, in the problem's own units."""

    iterate: Iterate
    rows: Any  # (intervals, rows) residuals
    slopes: Any  # (intervals, rows, local) their derivatives
    cost: Any  # the objective, to be minimised
    gradient: Any  # (intervals, local) its derivative, to be summed over the intervals
    curvature: Any  # (intervals, local, local) positive semidefinite part of its second derivative


class Transcription:
    """The discrete problem behind a continuous one.

    Args:
        time_limits: (low, high) of the final time; low = high fixes it.
        fixed: states whose start is given in full.

    Attributes:
        names, equality: (rows,) of every row; whether it is an equality.
        exists, decided: (intervals, rows) which rows are asked in which interval, and which of them no unknown changes.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        objective: Objective,
        *,
        method: RKMK,
        nodes: int,
        substeps: int,
        path: PathRows,
        final: FinalRows,
        time_limits: tuple[float, float],
        fixed: frozenset[str],
    ) -> None:
        self.dynamics, self.method, self.nodes, self.substeps = dynamics, method, nodes, substeps
        self.objective, self.path, self.time_limits = objective, path, time_limits
        self.controls = Controls(dynamics.controls)
        self.n, self.m = dynamics.dimension, self.controls.dimension
        self.block = self.n + self.m
        self.local = 2 * self.block + 1
        self._final = final
        asked = path.asked(nodes - 1, substeps).reshape(nodes - 1, -1)
        #: which of the (substeps + 1) * P path rows are asked in any interval
        self._kept = np.flatnonzero(asked.any(axis=0))
        self._points = self._kept // max(len(path.names), 1)
        rows_of_path = self._kept % max(len(path.names), 1)
        low, high = time_limits
        time_names = [] if low == high else [f"final time >= {low:g}", f"final time <= {high:g}"]
        last = np.zeros(nodes - 1, bool)
        last[-1] = True
        states = [name for name, part in dynamics.group.slices.items() for _ in range(part.stop - part.start)]
        self.names = [
            *(f"dynamics of {name}" for name in states),
            *(path.names[i] for i in rows_of_path),
            *(f"final: {name}" for name in final.names),
            *time_names,
        ]
        finals, times = len(final.names), len(time_names)
        self.equality = np.concatenate(
            [np.ones(self.n, bool), path.equality[rows_of_path], final.equality, np.zeros(times, bool)]
        )
        self.exists = np.concatenate(
            [np.ones((nodes - 1, self.n), bool), asked[:, self._kept], np.tile(last[:, None], finals + times)], axis=1
        )
        decided = path.decided(nodes - 1, substeps, fixed).reshape(nodes - 1, -1)[:, self._kept]
        self.decided = np.zeros_like(self.exists)
        self.decided[:, self.n : self.n + len(self._kept)] = decided

    def place(self, interval: int, row: int) -> str:
        """Words for where a row of an interval is asked."""
        after = row - self.n
        if after >= len(self._points):
            return f"at node {self.nodes - 1}"
        if after >= 0 and self._points[after] in (0, self.substeps):
            return f"at node {interval + (self._points[after] == self.substeps)}"
        return f"between nodes {interval} and {interval + 1}"

    # ---- traced -----------------------------------------------------------------------------------------------

    def evaluate(self, iterate: Iterate, step: jax.Array, params: Arrays) -> Evaluation:
        """The evaluation after a step (nodes * block + 1,) from an iterate."""
        group, count = self.dynamics.group, self.nodes - 1
        parts = step[:-1].reshape(self.nodes, self.block)
        xs = jax.vmap(group.retract)(iterate.xs, parts[:, : self.n])
        us = iterate.us + parts[:-1, self.n :]
        final_time = iterate.final_time + step[-1]
        moved = Iterate(xs, us, final_time)
        left, right = (jax.tree.map(lambda a, s=s: a[s], xs) for s in (slice(None, -1), slice(1, None)))
        numbers = jnp.arange(count, dtype=us.dtype)
        values = jax.vmap(self._interval, in_axes=(0, 0, 0, 0, None, None))(
            numbers, left, us, right, final_time, params
        )
        rows, slopes, cost, gradient, curvature = values
        ends, end_slopes, phi, phi_gradient, phi_curvature = self._end(
            jax.tree.map(lambda a: a[-1], xs), final_time, params
        )
        padding = [(0, 0)] * 2
        rows = jnp.concatenate([rows, jnp.pad(ends[None], [(count - 1, 0), (0, 0)])], axis=1)
        slopes = jnp.concatenate([slopes, jnp.pad(end_slopes[None], [(count - 1, 0), *padding])], axis=1)
        return Evaluation(
            moved,
            rows,
            slopes,
            jnp.sum(cost) + phi,
            gradient.at[-1].add(phi_gradient),
            curvature.at[-1].add(phi_curvature),
        )

    def _interval(
        self, number: jax.Array, left: Arrays, u: jax.Array, right: Arrays, final_time: jax.Array, params: Arrays
    ) -> tuple[jax.Array, ...]:
        """Rows, slopes, running cost, its gradient and curvature of one interval."""
        n, m, count, group = self.n, self.m, self.nodes - 1, self.dynamics.group
        h = final_time / count
        path = rollout(self.dynamics, self.method, number * h, left, u, h, params, self.substeps)
        by_time = (path.sensitivity[:, :, n + m] + number * path.sensitivity[:, :, n + m + 1]) / count
        ends = {name: values[-1] for name, values in path.xs.items()}
        defect = group.difference(right, ends)
        back = group.right_jacobian_inv(defect)
        # J_l^-1 = J_r^-1 - ad: both halves of ad / (1 - exp(-ad)).
        defect_slopes = jnp.concatenate(
            [
                back @ path.sensitivity[-1, :, : n + m],
                group.ad(defect) - back,
                jnp.zeros((n, m), u.dtype),
                (back @ by_time[-1])[:, None],
            ],
            axis=1,
        )
        # The last point is the next node itself.
        points = {name: values.at[-1].set(right[name]) for name, values in path.xs.items()}
        maps = self._maps(number, path.sensitivity, by_time)
        ts = (number + jnp.linspace(0.0, 1.0, self.substeps + 1, dtype=u.dtype)) * h
        rows, by_point = jax.vmap(self._path_slopes, in_axes=(0, 0, None, None))(ts, points, u, params)
        path_slopes = (by_point @ maps).reshape(-1, self.local)[self._kept]
        cost, gradient, curvature = self._running(ts, points, u, params, maps, h)
        return (
            jnp.concatenate([defect, rows.reshape(-1)[self._kept]]),
            jnp.concatenate([defect_slopes, path_slopes]),
            cost,
            gradient,
            curvature,
        )

    def _maps(self, number: jax.Array, sensitivity: jax.Array, by_time: jax.Array) -> jax.Array:
        """(substeps + 1, n + m + 1, local): how [d, u, t] at each point follow from what an interval sees."""
        n, m, count, last = self.n, self.m, self.nodes - 1, self.substeps
        maps = jnp.zeros((last + 1, n + m + 1, self.local), sensitivity.dtype)
        maps = maps.at[:last, :n, : n + m].set(sensitivity[:last, :, : n + m]).at[:last, :n, -1].set(by_time[:last])
        maps = maps.at[last, :n, self.block : self.block + n].set(jnp.eye(n, dtype=sensitivity.dtype))
        maps = maps.at[:, n : n + m, n : n + m].set(jnp.eye(m, dtype=sensitivity.dtype))
        shares = (number + jnp.linspace(0.0, 1.0, last + 1, dtype=sensitivity.dtype)) / count
        return maps.at[:, -1, -1].set(shares)

    def _around(
        self, x: Arrays, u: jax.Array, t: jax.Array
    ) -> tuple[Callable[[jax.Array], tuple[Any, Any, Any]], jax.Array]:
        """(t, x, u) as a function of z = [d, u, t], and the z of the point itself."""
        n, m, group = self.n, self.m, self.dynamics.group

        def point(z: jax.Array) -> tuple[Any, Any, Any]:
            return z[-1], group.retract(x, z[:n]), self.controls.split(z[n : n + m])

        return point, jnp.concatenate([jnp.zeros(n, u.dtype), u, t[None]])

    def _path_slopes(self, t: jax.Array, x: Arrays, u: jax.Array, params: Arrays) -> tuple[jax.Array, jax.Array]:
        """The path rows at a point and their derivatives with respect to [d, u, t]."""
        point, here = self._around(x, u, t)
        return value_and_jacobian(lambda z: self.path_values(*point(z), params), here)

    def path_values(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """The path rows at a point: inequalities, equalities, boxes."""
        family = self.dynamics._functions.evaluate("constraints", t, x, u, params)
        flat = {name: values.reshape(-1) for name, values in (*x.items(), *u.items())}
        boxes = [bound.sign * (flat[bound.leaf][bound.entry] - bound.limit) for bound in self.path.bounds]
        parts = [family["inequality"], family["equality"]]
        return jnp.concatenate([*parts, jnp.stack(boxes)] if boxes else parts)

    def _running(
        self, ts: jax.Array, xs: Arrays, u: jax.Array, params: Arrays, maps: jax.Array, h: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The running cost of an interval by Simpson's rule (trapezoid if the number of substeps is odd)."""
        if self.objective.running is None:
            zeros = jnp.zeros((self.local, self.local), u.dtype)
            return zeros[0, 0], zeros[0], zeros
        weights = jnp.asarray(_weights(self.substeps), u.dtype)

        def density(t: jax.Array, x: Arrays) -> tuple[jax.Array, jax.Array, jax.Array]:
            point, here = self._around(x, u, t)
            return _second_order(lambda z: self._scalar(self.objective.running, *point(z), params), here)

        values, slopes, bends = jax.vmap(density)(ts, xs)
        gradient = h * jnp.einsum("s,si,sij->j", weights, slopes, maps)
        curvature = h * jnp.einsum("s,sia,sij,sjb->ab", weights, maps, bends, maps)
        total = weights @ values
        return h * total, gradient.at[-1].add(total / (self.nodes - 1)), curvature

    def _end(self, x: Arrays, t: jax.Array, params: Arrays) -> tuple[jax.Array, ...]:
        """Rows and slopes of the final conditions and limits of time; the final cost to second order."""
        n, b = self.n, self.block
        columns = np.array([*range(b, b + n), self.local - 1])

        def rows(z: jax.Array) -> jax.Array:
            value = self._final.values(z[-1], self.dynamics.group.retract(x, z[:n]), params)
            low, high = self.time_limits
            return value if low == high else jnp.concatenate([value, jnp.stack([low - z[-1], z[-1] - high])])

        here = jnp.concatenate([jnp.zeros(n, t.dtype), t[None]])
        values, small_slopes = value_and_jacobian(rows, here)
        slopes = jnp.zeros((values.shape[0], self.local), t.dtype).at[:, columns].set(small_slopes)
        gradient = jnp.zeros(self.local, t.dtype)
        curvature = jnp.zeros((self.local, self.local), t.dtype)
        if self.objective.final is None:
            return values, slopes, jnp.zeros((), t.dtype), gradient, curvature

        def cost(z: jax.Array) -> jax.Array:
            return self._scalar(self.objective.final, z[-1], self.dynamics.group.retract(x, z[:n]), {}, params)

        value, slope, bend = _second_order(cost, here)
        return values, slopes, value, gradient.at[columns].set(slope), curvature.at[np.ix_(columns, columns)].set(bend)

    def _scalar(self, expr: Expr | None, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """The value of an expression of the objective, signed so that less is better."""
        inputs = Inputs(t, x, u, params, t.dtype)
        (value,) = evaluate_all([expr] if expr is not None else [], lambda leaf: leaf.read(inputs))
        return self.objective.sign * value


def _second_order(function: Callable[[jax.Array], jax.Array], z: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Value, gradient and the positive semidefinite part of the second derivative."""

    def slope(z: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        value, gradient = jax.value_and_grad(function)(z)
        return gradient, (value, gradient)

    hessian, (value, gradient) = jax.jacfwd(slope, has_aux=True)(z)
    eigenvalues, vectors = jnp.linalg.eigh(0.5 * (hessian + hessian.T))
    return value, gradient, (vectors * jnp.maximum(eigenvalues, 0.0)[None, :]) @ vectors.T


def _weights(substeps: int) -> Array:
    """Weights of the points of a unit interval."""
    weights = np.ones(substeps + 1)
    if substeps % 2:
        weights[1:-1] = 2.0
    else:
        weights[1:-1:2] = 4.0
        weights[2:-1:2] = 2.0
    return weights / weights.sum()
