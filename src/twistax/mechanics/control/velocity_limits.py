"""Bounds of velocities that keep joints within limits of position, speed and acceleration."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..tasks.configuration_space import Arrays, ConfigurationSpace

#: Of bounds that exclude each other by rounding, relative to the speed that an acceleration makes in a period.
_ROUNDING = 1e-6


class VelocityBounds(NamedTuple):
    """Bounds (n,) of velocities.

    Attributes:
        lower, upper: where they exclude each other, the nearest velocity that the acceleration allows.
        overrun: 1 where a joint cannot keep its limits of position and speed under its limit of acceleration, else 0.
    """

    lower: jax.Array
    upper: jax.Array
    overrun: jax.Array


def velocity_bounds(
    space: ConfigurationSpace, x: Arrays, qd: jax.Array | None, dt: Any, speed: Any, acceleration: Any, share: Any
) -> VelocityBounds:
    """The bounds for a step of dt.

    Without a limit of acceleration, a joint moves at most by a share of the distance to its limit. With one, a, it can
    still stop at its limit by steps of a dt, in whole periods. A joint beyond its limit goes
    back, at most at its speed.

    Args:
        qd: present velocities (n,); None without a limit of acceleration.
        speed: (n,), infinite without a limit.
        acceleration: (n,), likewise.
    """
    dtype = speed.dtype
    above, below = space.margins(x, dtype)
    if qd is None:
        reach = [jnp.clip(share * margin / dt, -speed, speed) for margin in (above, below)]
        return VelocityBounds(-reach[0], reach[1], jnp.zeros_like(speed))
    limited = jnp.isfinite(acceleration)
    change = jnp.where(limited, acceleration, 1.0) * dt
    bounds = []
    for margin in (above, below):
        # In k full steps and a part of one: u = v / (a dt) stops within (k + 1) u - k (k + 1) / 2 of a dt2.
        steps = jnp.maximum(margin, 0.0) / (change * dt)
        k = jnp.floor(0.5 * (jnp.sqrt(1.0 + 8.0 * steps) - 1.0))
        stops = jnp.where(limited, change * (steps / (k + 1.0) + 0.5 * k), share * margin / dt)
        stops = jnp.where(jnp.isfinite(margin), stops, np.inf)
        bounds.append(jnp.clip(jnp.where(margin > 0.0, stops, margin / dt), -speed, speed))
    lower, upper = -bounds[0], bounds[1]
    least, most = (qd + jnp.where(limited, sign * change, sign * np.inf) for sign in (-1.0, 1.0))
    small = _ROUNDING * change
    overrun = (lower > most + small) | (upper < least - small)
    return VelocityBounds(jnp.clip(lower, least, most), jnp.clip(upper, least, most), overrun.astype(dtype))


def as_freedoms(value: Any, n: int, default: float) -> np.ndarray:
    """A number, or one for each freedom, as (n,); the default for None."""
    return np.broadcast_to(np.asarray(default if value is None else value, float), (n,)).copy()
