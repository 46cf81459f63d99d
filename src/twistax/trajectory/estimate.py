"""Multipliers of a first point by least squares, where nothing else says how far controls may go.

A thrust of given size in a free direction, least time: no limit and no cost bends the objective along the control, so
the first Newton step is as long as what is added to the diagonal makes it. Multipliers bend it.
Source: Wachter and Biegler, Mathematical Programming 106 (2006), section 3.6.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from .interior_point import InteriorPoint, largest
from .iterate import State
from .riccati import Stages, factorize, refined
from .transcribed import Derivatives

#: Larger multipliers are of dependent constraints, and worse than none.
_MOST = 1e3
#: Less than this, scaled, bends nothing.
_BENT = 1e-8


def is_bound(method: InteriorPoint, free: Array, state: State, slopes: Derivatives) -> jax.Array:
    """Whether limits and costs say of every free control how far it may go.

    Args:
        free: (intervals, m) which controls are.
        state: a first one, without multipliers of the dynamics.
        slopes: in scales of 1, second ones of the objective.
    """
    scales, (n, m) = state.scales, method.size
    if not free.any():
        return jnp.ones((), bool)
    sizes = jnp.concatenate([scales.d[:-1], scales.u], axis=1)
    along = slopes.rows[:, :, : n + m] * sizes[:, None]
    grown, lengths = (
        a[: along[..., 0].size].reshape(*along.shape[:2], 1)
        for a in (jnp.where(method.equality, 1.0, state.rows / state.slack), scales.rows)
    )
    bends = jnp.abs(jnp.diagonal(slopes.hessian[:, : n + m, : n + m], axis1=1, axis2=2)) * sizes**2 / scales.cost
    bends = bends + (grown * (along / lengths) ** 2).sum(axis=1)
    # A linear control is a state: what bends it bends its rate.
    moved = slopes.defects[:-1, :, n : n + m] * sizes[:-1, None, n:] / sizes[1:, :n, None]
    through = (bends[1:, :n, None] * moved**2).sum(axis=1)
    through = jnp.concatenate([through, through[-1:].sum(axis=0, keepdims=True)])
    return jnp.where(free, bends[:, n:] + through > _BENT, True).all()


def estimated(method: InteriorPoint, state: State, slopes: Derivatives) -> State:
    """The state with the multipliers of equations that leave least of the Lagrangian's gradient, as squares (36)."""
    n, m = method.size
    unit = np.diag(np.repeat([1.0, 0.0], [n + m, slopes.hessian.shape[-1] - n - m]))
    flat = slopes._replace(
        hessian=jnp.broadcast_to(unit, slopes.hessian.shape), end_hessian=jnp.eye(len(slopes.end_hessian))
    )
    hard = method.weights(jnp.ones_like(state.slack), jnp.ones_like(state.rows))
    stages = Stages(flat, hard, jnp.zeros(()), None, method.free_start)
    pulled = method.split(jnp.where(method.inequality, state.rows, 0.0))
    found = refined(stages, factorize(stages), jnp.zeros_like(state.dynamics), pulled)
    rows = jnp.where(method.equality, method.join(found.rows), state.rows)
    known = largest((found.dynamics, jnp.where(method.equality, rows, 0.0))) <= _MOST
    return state._replace(
        dynamics=jnp.where(known, found.dynamics, state.dynamics), rows=jnp.where(known, rows, state.rows)
    )
