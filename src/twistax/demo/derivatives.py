"""Derivatives of a compiled system against finite differences, in the tangent space."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

#: The largest difference allowed, and the step of the finite differences in scales of the unknowns.
BAR, _STEP = 1e-8, 2e-3


class DerivativeCheck(NamedTuple):
    """The largest difference over all points, relative to the largest entry of the row."""

    points: int  # how many were tried
    rates: float  # and limits, by JAX's differentiation of the compiled system
    interval: float  # its end under held controls, by the closed form of `tx.trajectory.discretize`

    @property
    def holds(self) -> bool:
        return max(self.rates, self.interval) <= BAR


def check_derivatives(dynamics: tx.Dynamics, xs: dict[str, Any], us: dict[str, Any], h: float) -> DerivativeCheck:
    """Compare derivatives with respect to state, controls and length of an interval at several points.

    A state is perturbed by x (+) d, and ends are compared by the tangent between them. Columns are scaled by the scales
    that the leaves declare. The finite differences are central with two steps (error of fourth order). Points xs, us
    have a leading axis; h is the length of the interval, s.
    """
    n, sizes = dynamics.dimension, [math.prod(control.shape) for control in dynamics.controls]
    widths = [*(state.group.dimension for state in dynamics.states), *sizes]
    leaves = zip((*dynamics.states, *dynamics.controls), widths, strict=True)
    scale = np.concatenate([np.ones(k) if leaf.scale is None else np.ravel(leaf.scale) for leaf, k in leaves] + [[h]])
    steps = _STEP * np.concatenate([k * np.eye(len(scale)) for k in (1.0, -1.0, 2.0, -2.0)])

    def moved(x: Any, u: Any, z: jax.Array) -> tuple[Any, Any, jax.Array]:
        step = z * scale
        parts = zip(dynamics.controls, jnp.split(step[n:-1], np.cumsum(sizes)[:-1]), strict=True)
        controls = {control.name: u[control.name] + part.reshape(control.shape) for control, part in parts}
        return dynamics.retract(x, step[:n]), controls, h + step[-1]

    def compared(point: tuple[Any, Any]) -> tuple[jax.Array, ...]:
        interval = tx.trajectory.discretize(dynamics, 0.0, *point, h)
        closed = jnp.column_stack([interval.A, interval.B, interval.h_derivative]) * scale[None, :]

        def pointwise(z: jax.Array) -> jax.Array:
            x, u, _ = moved(*point, z)
            rates, limits = dynamics(0.0, x, u), dynamics.constraints(0.0, x, u)
            return jnp.concatenate([*(rates[s.name].reshape(-1) for s in dynamics.states), *limits.values()])

        def end(z: jax.Array) -> jax.Array:
            return dynamics.difference(interval.x1, tx.trajectory.discretize(dynamics, 0.0, *moved(*point, z)).x1)

        values, tangents = jax.lax.map(lambda z: (pointwise(z), end(z)), jnp.asarray(steps))
        return jax.jacfwd(pointwise)(jnp.zeros(len(scale))), values, closed, tangents

    # Loops, not vmaps: then one point is compiled, and compilation takes most of the time.
    slopes, values, closed, tangents = jax.jit(lambda x, u: jax.lax.map(compared, (x, u)))(xs, us)
    rows = np.concatenate([scale[:n], np.zeros(slopes.shape[1] - n)])
    return DerivativeCheck(len(slopes), _largest(slopes, values, rows), _largest(closed, tangents, scale[:n]))


def _largest(slopes: Any, values: Any, rows: Any) -> float:
    """The largest difference between slopes (points, rows, columns) and central differences of values.

    A row is measured by its largest entry, but not by less than a tenth of its natural size: some rows are zero.
    """
    near_plus, near_minus, far_plus, far_minus = np.split(np.asarray(values), 4, axis=1)
    differences = (8.0 * (near_plus - near_minus) - (far_plus - far_minus)) / (12.0 * _STEP)
    expected = np.swapaxes(differences, 1, 2)
    size = np.maximum(np.abs(expected).max(axis=2), 0.1 * rows)
    error = np.abs(np.asarray(slopes) - expected).max(axis=2)
    return float(np.max(error / np.where(size > 0.0, size, 1.0)))
