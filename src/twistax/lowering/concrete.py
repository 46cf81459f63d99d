"""What is known before a program runs: numbers, as opposed to values that JAX is tracing."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from ..jax_inside import is_tracer

__all__ = ["is_finite", "is_traced"]


def is_traced(tree: Any) -> bool:
    """Whether any leaf is a traced value, whose numbers are not known yet."""
    return any(is_tracer(leaf) for leaf in jax.tree.leaves(tree))


def is_finite(value: Any) -> bool:
    """Whether all entries of an array are finite, as far as they are known."""
    return is_traced(value) or bool(np.isfinite(np.asarray(value)).all())
