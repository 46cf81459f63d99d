"""A loop of steps that is differentiable in reverse mode with bounded memory."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ...jax_inside import any_of_batch

#: Steps in a block. The backward pass computes them again: only states at the starts of blocks are stored.
_BLOCK = 16
#: More blocks than this are nested.
_NEST = 64
#: Fewer steps than this are one block, without recomputation.
_UNNESTED = 64


def take_steps(
    step: Callable[[Any, Any], Any],
    y: Any,
    entries_by_step: Any,
    count: jax.Array,
    bound: int,
    record: bool,
    together: Callable[..., Any] = lambda *_: None,
) -> tuple[Any, Any]:
    """y after the first `count` of the steps y -> step(y, entries_by_step[k]), k = 0, 1, ..., bound - 1.

    Traceable, and differentiable in forward and reverse mode to any order. Reverse mode stores only the states at the
    starts of blocks, about 16 + 2 (n/16)^(1/2) states for n steps, and takes two more forward passes; up to 64 steps
    are not recomputed. Values that a step closes over are copied for every block, so they should be small. Blocks
    beyond the count are skipped; under vmap, if all members skip them.

    Args:
        record: whether to return the values before each step and after the last one too, with a leading axis of bound +
            1; entries beyond the count repeat the last value.
        together: takes the steps of one block at once, as `scan_again` does.
    """

    def one(y: Any, entry: tuple[jax.Array, Any]) -> tuple[Any, Any]:
        k, inputs = entry

        def taken(y: Any) -> Any:
            return jax.tree.map(lambda new, old: jnp.where(k < count, new, old), step(y, inputs), y)

        after = taken(y) if len(sizes) == 1 else jax.lax.cond(any_of_batch(k < count), taken, lambda y: y, y)
        return after, y if record else None

    def innermost(y: Any, entries: tuple[jax.Array, Any]) -> tuple[Any, Any]:
        taken = together(y, entries, count, record)
        return jax.lax.scan(one, y, entries) if taken is None else taken

    def block_of(level: Any) -> Any:
        """A level of nested blocks, recomputed in reverse mode and skipped beyond the count."""
        run = jax.checkpoint(level)

        def block(y: Any, entries: tuple[jax.Array, Any]) -> tuple[Any, Any]:
            shapes = jax.eval_shape(run, y, entries)[1]
            first = entries[0].reshape(-1)[0]

            def passed(y: Any) -> tuple[Any, Any]:
                return y, shapes and jax.tree.map(lambda a, like: jnp.broadcast_to(a, like.shape), y, shapes)

            return jax.lax.cond(any_of_batch(first < count), lambda y: run(y, entries), passed, y)

        return block

    sizes = _sizes(bound)
    span = math.prod(sizes)

    def padded(a: jax.Array) -> jax.Array:
        return jnp.concatenate([a, jnp.broadcast_to(a[-1], (span - len(a), *a.shape[1:]))])

    entries = (jnp.arange(span), jax.tree.map(padded, entries_by_step))
    entries = jax.tree.map(lambda a: a.reshape(*sizes, *a.shape[1:]), entries)
    level: Any = innermost
    for _ in sizes[1:]:
        level = functools.partial(jax.lax.scan, block_of(level))
    end, before = level(y, entries)
    if not record:
        return end, None
    steps = jax.tree.map(lambda a: a.reshape(span, *a.shape[len(sizes) :])[:bound], before)
    return end, jax.tree.map(lambda a, b: jnp.concatenate([a, b[None]]), steps, end)


def _sizes(bound: int) -> list[int]:
    """Sizes of the nested blocks, outermost first, whose product is at least the bound."""
    if bound <= _UNNESTED:
        return [max(bound, 1)]
    rest = math.ceil(bound / _BLOCK)
    if rest <= _NEST:
        return [rest, _BLOCK]
    outer = math.ceil(math.sqrt(rest))
    return [outer, math.ceil(rest / outer), _BLOCK]
