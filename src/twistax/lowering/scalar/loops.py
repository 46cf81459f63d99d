"""Equations of JAX that are loops: a step taken again and again, and loops of JAX, all iterations in one kernel."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from ...jax_inside import Primitive, varying_alike, weakly_kept
from .emitter import as_function
from .primitive import Bodies, Rows, Shapes, by_kernel, define
from .program import ScalarProgram


class _Rolled:
    """A loop and the kernels that take all of its iterations. Compared and hashed by identity.

    Args:
        kernel: makes the kernel, for one body (True) or for many; None where there is none.
    """

    function: Any  # the loop as JAX has it
    results: Any  # the shapes and types of its results

    def __init__(self, kernel: Callable[[bool], Rows | None]) -> None:
        self._kernel = functools.lru_cache(kernel)

    def kernel(self, rows: int) -> Rows | None:
        return self._kernel(rows == 1)

    def on_cpu(self, arguments: Sequence[Any], bodies: Bodies, inside: bool) -> list[jax.Array]:
        return bodies.each(self.function, arguments)


@weakly_kept
class Repeated(_Rolled):
    """A step, taken again and again.

    Args:
        step: takes (k, *fixed, *state), gives (*state); or (*state, more), more whether another iteration follows.
        state: how many arguments are the state.
        kernel: as of all loops.
    """

    def __init__(self, step: ScalarProgram, state: int, kernel: Callable[[bool], Rows | None]) -> None:
        super().__init__(kernel)
        self._step, self._state = step, state

    @functools.cached_property
    def results(self) -> Shapes:
        number, *rest = [(a.shape, self._step.graph.dtype_of(a)) for a in self._step.inputs]
        return [*rest[len(rest) - self._state :], number]

    @functools.cached_property
    def function(self) -> Callable[..., list[jax.Array]]:
        """A loop."""
        step, count = as_function(self._step), self._state

        def loop(first: jax.Array, stop: jax.Array, *rest: jax.Array) -> list[jax.Array]:
            fixed, state = rest[: len(rest) - count], rest[len(rest) - count :]

            def going(carried: tuple[jax.Array, jax.Array, Any]) -> jax.Array:
                return carried[1] & (carried[0] < stop)

            def iteration(carried: tuple[jax.Array, jax.Array, Any]) -> tuple[jax.Array, jax.Array, Any]:
                k, _, state = carried
                found = step(k, *fixed, *state)
                if len(found) > count:
                    return k + 1, found[count], found[:count]
                good = jnp.stack([jnp.isfinite(a).all() for a in found]).all()
                kept = [jnp.where(good, new, old) for new, old in zip(found, state, strict=True)]
                return k + good.astype(k.dtype), good, kept

            k, _, found = jax.lax.while_loop(going, iteration, (first, jnp.asarray(True), list(state)))
            return [*found, k]

        return loop


@dataclasses.dataclass(frozen=True)
class Ring:
    """How the arguments and results of one iteration go round.

    A scan takes (*fixed, *state, *rows) and gives (*state, *rows): the rows of an iteration are parts of longer arrays.
    A `while_loop` takes (*fixed, *state) and gives (going, *state): it ends, with the state that came in, where it is
    not going.

    Attributes:
        fixed, state: how many arguments stay the same, and how many are carried.
        length: the iterations of a scan; None: it is a `while_loop`.
        reverse: whether a scan begins with the last rows.
    """

    fixed: int
    state: int
    length: int | None = None
    reverse: bool = False


@weakly_kept
class Looped(_Rolled):
    """A loop of JAX.

    Args:
        function: of (count, *arguments).
        results: the shapes and types of its results.
        kernel: as of all loops.
    """

    def __init__(
        self, function: Callable[..., list[jax.Array]], results: Shapes, kernel: Callable[[bool], Rows | None]
    ) -> None:
        super().__init__(kernel)
        self.function, self.results = function, results


#: A repeated step, or a loop.
_repeat_p = Primitive("repeated_step")
define(_repeat_p, by_kernel)


def repeat(
    step: Repeated, first: jax.Array, stop: jax.Array, fixed: Sequence[jax.Array], state: Sequence[jax.Array]
) -> tuple[list[jax.Array], jax.Array]:
    """state = step(k, fixed, state) for k = first, ..., stop - 1.

    A step that says whether another iteration follows may end that early. One that does not ends it where the new state
    would not be finite, and the state before is kept. Traceable, batched by vmap, not differentiable.

    Returns:
        The state, and the number of the next iteration.
    """
    *found, k = _repeat_p.bind(
        *varying_alike([first, stop, *fixed, *state]), program=step, bodies=Bodies(), inside=False
    )
    return found, k


def loop(looped: Looped, count: int, arguments: Sequence[Any]) -> list[jax.Array]:
    """The results of a loop. Traceable, batched by vmap, not differentiable."""
    return _repeat_p.bind(*varying_alike([jnp.int32(count), *arguments]), program=looped, bodies=Bodies(), inside=False)
