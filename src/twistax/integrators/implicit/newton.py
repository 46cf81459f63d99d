"""Newton's method with a Jacobian that is kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

__all__ = ["Solved", "newton"]

#: Updates within this many times round-off count as solved when they stop falling.
_STALLED = 1e3


class Solved(NamedTuple):
    """What Newton's method found.

    Attributes:
        Z: the solution.
        done: whether it is one.
        iterations: how many updates were made.
        contraction: r / (1 - r), r the ratio of the last two updates: how far off Z still is, in units of the last one.
    """

    Z: jax.Array
    done: jax.Array
    iterations: jax.Array
    contraction: jax.Array


class _Now(NamedTuple):
    Z: jax.Array
    size: jax.Array
    done: jax.Array
    failed: jax.Array
    iterations: jax.Array
    contraction: jax.Array
    again: jax.Array


def newton(
    update: Callable[[jax.Array], jax.Array],
    size: Callable[[jax.Array], jax.Array],
    guess: jax.Array,
    contraction: jax.Array,
    most: int,
    again: bool,
    rounding: jax.Array | float = 1.0,
) -> Solved:
    """Z <- Z - update(Z) from a guess, until what is left to come is below 1. Pure and traceable.

    It ends early where updates grow, are not finite, or `most` are made. Updates that stop falling while they are below
    1e3 times round-off are solved as well as can be.

    Args:
        size: the size of an update, in units of what is asked for.
        contraction: what the last solution was left with, so that one update may do.
        most: how many updates there may be.
        again: start once more, from zero, where the guess leads nowhere.
        rounding: about the size of an update that is round-off.

    Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.8, on stopping.
    """

    def iterate(now: _Now) -> _Now:
        step = update(now.Z)
        found = size(step)
        later = now.size > 0.0
        ratio = jnp.where(later, found / jnp.where(later, now.size, 1.0), 0.0)
        growing = ratio >= 1.0
        left = jnp.where(later, ratio / jnp.where(growing, 1.0, 1.0 - ratio), jnp.maximum(now.contraction, eps) ** 0.8)
        done = (found == 0.0) | jnp.where(growing, found < _STALLED * rounding, left * found < 1.0)
        failed = ~jnp.isfinite(found) | (growing & ~done)
        Z = now.Z - step
        restart = failed & now.again
        if again:
            Z, found = jnp.where(restart, 0.0, Z), jnp.where(restart, 0.0, found)
        contraction = jnp.where(failed, 1.0, left)
        return _Now(Z, found, done & ~failed, failed & ~restart, now.iterations + 1, contraction, now.again & ~restart)

    eps = float(jnp.finfo(guess.dtype).eps)
    no, none = jnp.asarray(False), jnp.zeros((), int)
    start = _Now(guess, jnp.zeros((), guess.dtype), no, no, none, contraction, jnp.asarray(again))
    end = jax.lax.while_loop(lambda n: ~n.done & ~n.failed & (n.iterations < most), iterate, start)
    return Solved(end.Z, end.done, end.iterations, end.contraction)
