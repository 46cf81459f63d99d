"""A loop of steps that can be differentiated both ways, in little memory."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ..jax_inside import any_of_batch

__all__ = ["take_steps"]

#: Steps in a block: what lies between is computed again on the way back, so that only states are kept.
_BLOCK = 16
#: Blocks are nested where there would be more of them than this.
_NEST = 64


def take_steps(
    step: Callable[[Any, Any], Any], y: Any, each: Any, count: jax.Array, bound: int, record: bool
) -> tuple[Any, Any]:
    """y after the first `count` of the steps y -> step(y, each[k]), k = 0, 1, ..., bound - 1.

    Traceable, and differentiable forward and in reverse to any order. On the way back only the states at the starts of
    blocks are kept: for n steps about 16 + 2 (n/16)^(1/2) states, at the cost of two more passes forward. Blocks beyond
    the count are passed over, also for a whole batch at once under vmap.

    Args:
        each: what each step needs, a pytree with a leading axis of `bound`. What a step closes over is copied for every
            block on the way back, so it should be small.
        record: also return the values before each step, and after the last one, on a leading axis of bound + 1; entries
            beyond the count repeat the end.
    """

    def one(y: Any, entry: tuple[jax.Array, Any]) -> tuple[Any, Any]:
        k, own = entry

        def taken(y: Any) -> Any:
            return jax.tree.map(lambda new, old: jnp.where(k < count, new, old), step(y, own), y)

        return jax.lax.cond(any_of_batch(k < count), taken, lambda y: y, y), y if record else None

    def block_of(level: Any) -> Any:
        """Runs of a level, computed again on the way back, and passed over where the count is reached."""

        @jax.checkpoint
        def run(y: Any, entries: tuple[jax.Array, Any]) -> tuple[Any, Any]:
            return jax.lax.scan(level, y, entries)

        def block(y: Any, entries: tuple[jax.Array, Any]) -> tuple[Any, Any]:
            shapes = jax.eval_shape(run, y, entries)[1]
            first = entries[0].reshape(-1)[0]
            return jax.lax.cond(
                any_of_batch(first < count), lambda y: run(y, entries), lambda y: (y, _repeated(y, shapes)), y
            )

        return block

    sizes = _sizes(bound)
    span = math.prod(sizes)
    entries = (jnp.arange(span), jax.tree.map(lambda a: _padded(a, span), each))
    entries = jax.tree.map(lambda a: a.reshape(*sizes, *a.shape[1:]), entries)
    level: Any = one
    for _ in sizes[1:]:
        level = block_of(level)
    end, before = jax.lax.scan(level, y, entries)
    if not record:
        return end, None
    steps = jax.tree.map(lambda a: a.reshape(span, *a.shape[len(sizes) :])[:bound], before)
    return end, jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), steps, end)


def _sizes(bound: int) -> list[int]:
    """Sizes of the nested blocks, outermost first, whose product is at least the bound."""
    if bound <= _BLOCK:
        return [max(bound, 1)]
    rest = math.ceil(bound / _BLOCK)
    if rest <= _NEST:
        return [rest, _BLOCK]
    outer = math.ceil(math.sqrt(rest))
    return [outer, math.ceil(rest / outer), _BLOCK]


def _padded(a: jax.Array, length: int) -> jax.Array:
    """The rows of a, the last one repeated up to a length."""
    return jnp.concatenate([a, jnp.broadcast_to(a[-1], (length - len(a), *a.shape[1:]))])


def _repeated(y: Any, shapes: Any) -> Any:
    """y along the leading axes of the shapes; None where nothing is recorded."""
    return None if shapes is None else jax.tree.map(lambda a, like: jnp.broadcast_to(a, like.shape), y, shapes)
