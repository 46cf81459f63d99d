"""Derivatives of a compiled system against finite differences, in the tangent space."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ..linear.discretize import Controls, value_and_jacobian
from ..scenes.powered_descent import Array
from ..trajectory.transcription.vectors import declared_scales

#: The largest difference allowed.
BAR = 1e-8

#: Step of the finite differences, in scales of the unknowns.
_STEP = 2e-3


class DerivativeCheck(NamedTuple):
    """The largest difference at any point, relative to the largest entry of its row."""

    points: int  # how many were tried
    rates: float  # and limits, by JAX's differentiation of the compiled system
    interval: float  # its end under held controls, by the closed form of `tx.trajectory.discretize`

    @property
    def holds(self) -> bool:
        return max(self.rates, self.interval) <= BAR


def check_derivatives(dynamics: tx.Dynamics, xs: dict[str, Array], us: dict[str, Array], h: float) -> DerivativeCheck:
    """Compare derivatives with respect to state, controls and length of an interval at several points.

    A state moves by x (+) d, and ends are compared by the tangent between them. Columns are measured in the scales that
    the leaves declare. The finite differences are central with two steps (error of fourth order). Points xs, us have a
    leading axis; h is the length of the interval, s.
    """
    scale = jnp.append(declared_scales((*dynamics.states, *dynamics.controls)), h)
    n, flat = dynamics.dimension, Controls(dynamics.controls)
    size = scale.shape[0]
    steps = _STEP * jnp.concatenate([step * jnp.eye(size) for step in (0.0, 1.0, -1.0, 2.0, -2.0)])[size - 1 :]

    def moved(x: Any, u: Any, z: jax.Array) -> tuple[Any, Any, jax.Array]:
        step = z * scale
        controls = {name: u[name] + change for name, change in flat.split(step[n:-1]).items()}
        return dynamics.retract(x, step[:n]), controls, h + step[-1]

    def pointwise(x: Any, u: Any, z: jax.Array) -> jax.Array:
        x, u, _ = moved(x, u, z)
        rates, found = dynamics(0.0, x, u), dynamics.constraints(0.0, x, u)
        return jnp.concatenate([*(rates[s.name].reshape(-1) for s in dynamics.states), *found.values()])

    def at(x: Any, u: Any, z: jax.Array) -> tuple[Any, ...]:
        values, slopes = value_and_jacobian(lambda z: pointwise(x, u, z), z)
        interval = tx.trajectory.discretize(dynamics, 0.0, *moved(x, u, z))
        closed = jnp.column_stack([interval.A, interval.B, interval.h_derivative]) * scale[None, :]
        return slopes, values, closed, interval.x1

    def compared(point: tuple[Any, Any]) -> tuple[jax.Array, ...]:
        # The first of the steps is none: there the derivatives are taken.
        slopes, values, closed, ends = jax.lax.map(lambda z: at(*point, z), steps)
        end = {name: value[0] for name, value in ends.items()}
        tangents = jax.vmap(dynamics.difference, (None, 0))(end, ends)
        return slopes[0], values[1:], closed[0], tangents[1:]

    # Loops, not vmaps: what compiles is one point, and that is where the time goes.
    slopes, values, closed, tangents = jax.jit(lambda x, u: jax.lax.map(compared, (x, u)))(xs, us)
    state_scale = np.asarray(scale[:n])
    rows = np.concatenate([state_scale, np.zeros(slopes.shape[1] - n)])
    return DerivativeCheck(len(slopes), _largest(slopes, values, rows), _largest(closed, tangents, state_scale))


def _largest(slopes: Any, values: Any, rows: Array) -> float:
    """The largest difference between slopes (points, rows, columns) and central differences of values.

    A row is measured by its largest entry, but not by less than a tenth of its natural size: some rows are zero.
    """
    near_plus, near_minus, far_plus, far_minus = np.split(np.asarray(values), 4, axis=1)
    differences = (8.0 * (near_plus - near_minus) - (far_plus - far_minus)) / (12.0 * _STEP)
    expected = np.swapaxes(differences, 1, 2)
    size = np.maximum(np.abs(expected).max(axis=2), 0.1 * rows)
    error = np.abs(np.asarray(slopes) - expected).max(axis=2)
    return float(np.max(error / np.where(size > 0.0, size, 1.0)))
