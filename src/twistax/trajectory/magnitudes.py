"""How large states and controls are along a trajectory, in their own units. Traceable."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from .transcribed import Point, Segment


def largest_along(part: Segment, point: Point) -> jax.Array:
    """(n + m,) of tangents and controls of a phase; zero of rotations."""
    own, group, found = part.of(point), part.shooting.dynamics.group, list[Any]()
    for name, factor in group.factors.items():
        most = jax.vmap(factor.sizes)(own.xs[name]).max(axis=0)
        found.append(jnp.where(factor.sized | factor.flat, most, 0.0))
    return jnp.concatenate([*found, jnp.abs(own.us).max(axis=0)])
