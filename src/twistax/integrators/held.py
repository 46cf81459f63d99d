"""Numbers that are worked out once."""

from __future__ import annotations

from typing import TypeVar

import jax
from jax.flatten_util import ravel_pytree

from ..lowering.small_call import inside_small_call

__all__ = ["held"]

Tree = TypeVar("Tree")


def held(tree: Tree) -> Tree:
    """The same numbers, kept in one array. Inside a small function XLA else works scalars out anew at every reader."""
    if not inside_small_call():
        return tree
    packed, read = ravel_pytree(tree)
    kept: Tree = read(jax.lax.optimization_barrier(packed))
    return kept
