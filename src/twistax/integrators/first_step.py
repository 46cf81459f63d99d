"""The length of the first step to try."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from .charts.whole import Blocks
from .held import held
from .stepper import Stepper
from .tolerances import Tolerances

__all__ = ["first_step"]


def first_step(
    stepper: Stepper,
    tolerances: Tolerances,
    t: jax.Array,
    y: Blocks,
    rate: Blocks,
    fallback: jax.Array,
    room: jax.Array,
) -> jax.Array:
    """A step whose error should be near the tolerance, judged by the rate and how it changes over a short Euler step.

    Pure and traceable; `fallback` where the rates say nothing.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.4, starting step size.
    """
    local, order = stepper.coordinates, stepper.method.error_order

    def size(e: Blocks) -> jax.Array:
        return jnp.sqrt(tolerances.mean_square(local, e, y, y))

    slope = held(local.first_slope(y, rate))
    reach, speed = tolerances.reach(local, y), size(slope)
    short = jnp.where((reach > 1e-5) & (speed > 1e-5), 0.01 * reach / speed, fallback)
    # Controls beyond the end may not be defined.
    short = jnp.minimum(jnp.where(jnp.isfinite(short), short, fallback), room)
    z = jax.tree.map(lambda k: short * k, slope)
    moved = held(local.move(y, z))
    later = local.slope(z, moved, held(stepper.rate(t + short, moved, short)))
    bend = size(jax.tree.map(jnp.subtract, later, slope)) / short
    largest = jnp.maximum(speed, bend)
    h = jnp.where(largest > 1e-15, (0.01 / largest) ** (1.0 / order), jnp.maximum(fallback, 1e-3 * short))
    h = jnp.minimum(100.0 * short, h)
    return jnp.where(jnp.isfinite(h) & (h > 0.0), h, fallback)
