"""Bounds of velocities that keep joints within limits of position, speed and acceleration."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..tasks.configuration_space import Arrays, ConfigurationSpace

#: The tolerance of bounds that contradict each other by round-off, relative to acceleration limit times period.
_ROUNDING = 1e-6
#: The part of the deceleration that all joints together can give to a constraint; the rest is left to the curvature of
#: the constraint, to others, and to the limits of the joints.
_BRAKING = 0.5


class VelocityBounds(NamedTuple):
    """Bounds (n,) of velocities.

    Attributes:
        lower, upper: the bounds; if limits contradict each other, both are the nearest velocity that the acceleration
            limit allows.
        overrun: 1 if a joint cannot satisfy its position and speed limits under its acceleration limit, else 0.
    """

    lower: jax.Array
    upper: jax.Array
    overrun: jax.Array


def velocity_bounds(
    space: ConfigurationSpace, x: Arrays, qd: jax.Array | None, dt: Any, speed: Any, acceleration: Any, share: Any
) -> VelocityBounds:
    """The bounds of velocities for a step of dt.

    Without an acceleration limit, a joint moves at most by a fraction of the distance to its position limit. With an
    acceleration limit a, it can still stop at its position limit in steps of a dt, in whole periods. A joint beyond its
    limit moves back, at most at its speed limit.

    Args:
        qd: present velocities (n,); None without acceleration limits.
        speed: (n,), infinite for no limit.
        acceleration: (n,), infinite for no limit.
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
        stops = jnp.where(limited, _stopping_speed(margin, change, dt), share * margin / dt)
        stops = jnp.where(jnp.isfinite(margin), stops, np.inf)
        bounds.append(jnp.clip(jnp.where(margin > 0.0, stops, margin / dt), -speed, speed))
    lower, upper = -bounds[0], bounds[1]
    least, most = (qd + jnp.where(limited, sign * change, sign * np.inf) for sign in (-1.0, 1.0))
    small = _ROUNDING * change
    overrun = (lower > most + small) | (upper < least - small)
    return VelocityBounds(jnp.clip(lower, least, most), jnp.clip(upper, least, most), overrun.astype(dtype))


def constraint_bounds(
    c: jax.Array, C: jax.Array, qd: jax.Array | None, dt: Any, acceleration: Any, gain: Any
) -> tuple[jax.Array, jax.Array]:
    """The bounds (k,) of $c' = C qd$ for constraints $c <= 0$, and whether a joint moves one that cannot hold (n,).

    The bound is $-k_c c$. With acceleration limits $a$, the constraint can also stop at zero with half of its largest
    deceleration $sum |C_i| a_i$. Where even this deceleration cannot satisfy the bound in one step, it is the bound.

    Args:
        c, C: the residuals (k,) and their derivatives (k, n).
        qd: present velocities (n,); None without acceleration limits.
        acceleration: (n,), infinite for no limit.
        gain: $k_c$, 1/s.
    """
    wanted = -gain * c
    if qd is None:
        return wanted, jnp.zeros_like(acceleration)
    involved = C != 0.0
    most = jnp.sum(jnp.where(involved, jnp.abs(C) * acceleration[None], 0.0), axis=1)
    limited = jnp.isfinite(most) & (most > 0.0)
    change = jnp.where(limited, most, 1.0) * dt
    stops, last = (
        jnp.where(limited & (c < 0.0), _stopping_speed(-c, part * change, dt), wanted) for part in (_BRAKING, 1.0)
    )
    reachable = jnp.where(limited, C @ qd - _BRAKING * change, -np.inf)
    late = limited & (reachable > last + _ROUNDING * change)
    upper = jnp.maximum(jnp.minimum(wanted, stops), reachable)
    return upper, jnp.sum((late[:, None] & involved).astype(c.dtype), axis=0)


def _stopping_speed(margin: jax.Array, change: jax.Array, dt: Any) -> jax.Array:
    """The largest speed that stops within a margin, if it decreases by at most `change` in each period dt."""
    # With k full steps and a fraction of one, u = v / (a dt) stops within (k + 1) u - k (k + 1) / 2 of a dt2.
    steps = jnp.maximum(margin, 0.0) / (change * dt)
    k = jnp.floor(0.5 * (jnp.sqrt(1.0 + 8.0 * steps) - 1.0))
    return change * (steps / (k + 1.0) + 0.5 * k)


def as_freedoms(value: Any, n: int, default: float) -> np.ndarray:
    """A number, or one for each degree of freedom, as an array (n,); None gives the default."""
    return np.broadcast_to(np.asarray(default if value is None else value, float), (n,)).copy()
