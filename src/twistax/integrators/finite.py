"""Whether numbers are numbers."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

__all__ = ["all_finite"]


def all_finite(tree: Any) -> jax.Array:
    """Whether every entry of a pytree is finite. Traceable.

    One reduction of all entries: XLA would compute a chain of scalar tests again at every place that reads the result.
    """
    return jnp.isfinite(ravel_pytree(tree)[0]).all()
