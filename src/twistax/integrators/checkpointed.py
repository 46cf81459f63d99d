"""A loop of steps that can be differentiated both ways, in little memory."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["take_steps"]

#: Steps in a block: what lies between is computed again on the way back, so that only states are kept.
_BLOCK = 16
#: Blocks are nested where there would be more of them than this.
_NEST = 64


def take_steps(
    step: Callable[[jax.Array, Any], Any], y: Any, count: jax.Array, bound: int, record: bool
) -> tuple[Any, Any]:
    """y after the steps step(0, .), step(1, .), ..., step(count - 1, .), where count <= bound.

    Traceable, and differentiable forward and in reverse to any order. On the way back only the states at the starts of
    blocks are kept: for n steps about 16 + 2 (n/16)^(1/2) states, at the cost of two more passes forward. Blocks beyond
    the count are passed over, also for a whole batch at once under vmap.

    Args:
        record: also return the values before each step, and after the last one, on a leading axis of bound + 1; entries
            beyond the count repeat the end.
    """
    from equinox.internal import unvmap_any

    def one(y: Any, k: jax.Array) -> tuple[Any, Any]:
        taken = _where_any(unvmap_any, k < count, lambda y: step(k, y), y)
        return taken, y if record else None

    def several(level: Callable[[Any, jax.Array], tuple[Any, Any]], size: int, span: int) -> Any:
        """`size` runs of a level that takes `span` steps itself."""

        @jax.checkpoint
        def block(y: Any, start: jax.Array) -> tuple[Any, Any]:
            return jax.lax.scan(level, y, start + span * jnp.arange(size))

        def block_or_nothing(y: Any, start: jax.Array) -> tuple[Any, Any]:
            shapes = jax.eval_shape(block, y, start)[1]
            return jax.lax.cond(
                unvmap_any(start < count), lambda y: block(y, start), lambda y: (y, _repeated(y, shapes)), y
            )

        return block_or_nothing

    sizes = _sizes(bound)
    level, span = one, 1
    for size in sizes:
        level, span = several(level, size, span), span * size
    end, before = level(y, jnp.zeros((), int))
    if not record:
        return end, None
    steps = jax.tree.map(lambda a: a.reshape(span, *a.shape[len(sizes) :])[:bound], before)
    return end, jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), steps, end)


def _sizes(bound: int) -> list[int]:
    """Sizes of the nested blocks, innermost first, whose product is at least the bound."""
    if bound <= _BLOCK:
        return [max(bound, 1)]
    rest = math.ceil(bound / _BLOCK)
    if rest <= _NEST:
        return [_BLOCK, rest]
    inner = math.ceil(math.sqrt(rest))
    return [_BLOCK, inner, math.ceil(rest / inner)]


def _where_any(any_of: Callable[[Any], Any], active: jax.Array, function: Callable[[Any], Any], y: Any) -> Any:
    """function(y) where active; not computed at all where nothing in a batch is."""

    def chosen(y: Any) -> Any:
        return jax.tree.map(lambda new, old: jnp.where(active, new, old), function(y), y)

    return jax.lax.cond(any_of(active), chosen, lambda y: y, y)


def _repeated(y: Any, shapes: Any) -> Any:
    """y along the leading axes of the shapes; None where nothing is recorded."""
    if shapes is None:
        return None
    return jax.tree.map(lambda a, like: jnp.broadcast_to(a, like.shape), y, shapes)
