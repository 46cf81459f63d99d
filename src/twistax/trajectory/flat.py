"""Controls and rates as flat vectors in the order of declaration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp

from ..expr import Control
from ..lowering import Dynamics

__all__ = ["Controls", "flat_rates"]


class Controls:
    """Where each control sits in the flat vector u, every control read row by row.

    Attributes:
        dimension: length of the vector.
        slices: name -> slice.
    """

    def __init__(self, leaves: Sequence[Control]) -> None:
        self._shapes = {leaf.name: leaf.shape for leaf in leaves}
        self.slices: dict[str, slice] = {}
        start = 0
        for name, shape in self._shapes.items():
            self.slices[name] = slice(start, start + prod(shape))
            start += prod(shape)
        self.dimension = start

    def split(self, u: Any) -> dict[str, Any]:
        """The controls by name from the last axis of an array (..., dimension)."""
        return {name: u[..., self.slices[name]].reshape(*u.shape[:-1], *shape) for name, shape in self._shapes.items()}

    def join(self, u: Mapping[str, Any], dtype: Any) -> jax.Array:
        """The flat vector; a control that nothing reads may be missing and counts as zero."""
        parts = [jnp.asarray(u.get(name, jnp.zeros(s, dtype)), dtype).reshape(-1) for name, s in self._shapes.items()]
        return jnp.concatenate(parts) if parts else jnp.zeros(0, dtype)


def flat_rates(dynamics: Dynamics, rates: Mapping[str, jax.Array]) -> jax.Array:
    """The rates as one tangent vector (n,)."""
    return jnp.concatenate([rates[name].reshape(-1) for name in dynamics.group.factors])
