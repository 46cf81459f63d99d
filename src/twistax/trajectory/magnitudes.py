"""How large states and controls are along a trajectory, in their own units. Traceable."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from ..groups import Euclidean, SpecialEuclidean
from .transcribed import Point, Segment


def largest_along(part: Segment, point: Point) -> jax.Array:
    """(n + m,) of tangents and controls of a phase; zero of rotations."""
    own, group, found = part.of(point), part.shooting.dynamics.group, list[Any]()
    for name, factor in group.factors.items():
        values, most = own.xs[name], jnp.zeros(factor.dimension)
        if isinstance(factor, Euclidean):
            most = jnp.abs(values.reshape(len(values), -1)).max(axis=0)
        elif isinstance(factor, SpecialEuclidean):
            away = jnp.sqrt((values[:, :3, 3] ** 2).sum(axis=1)).max()
            most = jnp.where(part.shooting.turns[group.slices[name]], 0.0, away)
        found.append(most)
    return jnp.concatenate([*found, jnp.abs(own.us).max(axis=0)])
