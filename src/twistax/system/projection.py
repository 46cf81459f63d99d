"""Projection of states onto the manifold of a system, by its corrections."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from .functions import Arrays, Functions
from .inputs import Values

#: The most steps of Newton's method. Near the manifold each doubles the digits.
_STEPS = 50
#: A correction of so many units of round-off counts as zero.
_ROUND_OFF = 1e3


def increments(functions: Functions, corrections: Arrays) -> jax.Array:
    """The corrections of all states as one tangent vector; zeros for states without a correction."""
    dtype = next(iter(corrections.values())).dtype
    parts = [
        corrections[name].reshape(-1) if name in corrections else jnp.zeros(group.dimension, dtype)
        for name, group in functions.group.factors.items()
    ]
    return jnp.concatenate(parts)


def project(functions: Functions, t: Any, x: Values, u: Values | None, params: Values | None) -> Arrays:
    """Implements `Dynamics.project`."""
    inputs = functions.prepare(t, x, u, params, reads=("corrections",))
    now, size = dict(inputs.x), np.inf
    least = _ROUND_OFF * float(jnp.finfo(inputs.dtype).eps)
    for _ in range(_STEPS):
        corrections = functions.jitted("corrections", inputs.t, now, inputs.u, inputs.params)
        step = increments(functions, corrections)
        now = functions.group.retract(now, step)
        before, size = size, float(jnp.abs(step).max())
        if (size <= least and not size < 0.5 * before) or size == 0.0:
            return now
        if not np.isfinite(size):
            break
    if size <= 1e3 * least:
        return now
    raise InputError(
        f"project does not converge to the manifold from this state: its last step is {size:.3g}.\n"
        "  fix: start closer to the manifold, for example from a configuration in which the loops are almost closed"
    )
