"""A step that is taken again and again, as one equation of JAX: one kernel on the CPU, a loop elsewhere."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import Primitive, shaped_array
from .emitter import as_function
from .primitive import at_once, define, over_rows
from .program import ScalarProgram

__all__ = ["Repeated", "repeat"]

#: From rows and their number to results.
Rows = Callable[..., list[jax.Array]]


class Repeated:
    """A step and the kernels that take it. Compared and hashed by identity.

    Args:
        step: takes (k, *fixed, *state), gives (*state); or (*state, more), more whether another iteration follows.
        state: how many arguments are the state.
        kernel: makes the kernel, for one body (True) or for many; None where there is none.
    """

    def __init__(self, step: ScalarProgram, state: int, kernel: Callable[[bool], Rows | None]) -> None:
        self.step = step
        self.state = state
        self.kernel = functools.lru_cache(kernel)

    @functools.cached_property
    def function(self) -> Any:
        return as_function(self.step)


repeat_p = Primitive("repeated_step")


def repeat(
    repeated: Repeated, first: jax.Array, stop: jax.Array, fixed: Sequence[jax.Array], state: Sequence[jax.Array]
) -> tuple[list[jax.Array], jax.Array]:
    """state = step(k, fixed, state) for k = first, ..., stop - 1.

    A step that says whether another iteration follows may end that early. One that does not ends it where the new state
    would not be finite, and the state before is kept. Traceable, batched by vmap, not differentiable.

    Returns:
        The state, and the number of the next iteration.
    """
    *found, k = repeat_p.bind(first, stop, *fixed, *state, repeated=repeated, depth=0)
    return found, k


def _run(*arguments: Any, repeated: Repeated, depth: int) -> list[jax.Array]:
    """On the CPU: one kernel for all bodies."""
    rows = math.prod(jnp.shape(arguments[0])[:depth])
    kernel = repeated.kernel(rows == 1) if rows else None
    if kernel is None:
        return _run_wide(*arguments, repeated=repeated, depth=depth)
    return over_rows(kernel, arguments, depth)


def _run_wide(*arguments: Any, repeated: Repeated, depth: int) -> list[jax.Array]:
    """On accelerators: all bodies at once, in a loop."""

    count = repeated.state

    def one(first: jax.Array, stop: jax.Array, *rest: jax.Array) -> list[jax.Array]:
        fixed, state = rest[: len(rest) - count], rest[len(rest) - count :]

        def going(carried: tuple[jax.Array, jax.Array, Any]) -> jax.Array:
            return carried[1] & (carried[0] < stop)

        def iteration(carried: tuple[jax.Array, jax.Array, Any]) -> tuple[jax.Array, jax.Array, Any]:
            k, _, state = carried
            found = repeated.function(k, *fixed, *state)
            if len(found) > count:
                return k + 1, found[count], found[:count]
            good = jnp.stack([jnp.isfinite(a).all() for a in found]).all()
            kept = [jnp.where(good, new, old) for new, old in zip(found, state, strict=True)]
            return k + good.astype(k.dtype), good, kept

        k, _, found = jax.lax.while_loop(going, iteration, (first, jnp.asarray(True), list(state)))
        return [*found, k]

    return at_once(one, arguments, depth)


def _abstract(*arguments: Any, repeated: Repeated, depth: int) -> list[Any]:
    ends = (*arguments[len(arguments) - repeated.state :], arguments[0])
    return [shaped_array(np.shape(a), a.dtype) for a in ends]


define(repeat_p, ("repeated", "depth"), _abstract, _run, _run_wide)
