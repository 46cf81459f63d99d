"""Gauss-Newton steps with Levenberg-Marquardt damping after steps that increase the cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

#: The first damping after a step that increased the cost, and the factor between successive values.
_DAMPING, _FACTOR = 1e-2, 10.0
#: A search ends if steps with this damping increase the cost.
MOST_DAMPING = 1e8

#: (value, damping) -> (new value, whether it is better, size of the step).
Tried = Callable[[Any, jax.Array], tuple[Any, jax.Array, jax.Array]]


class LeastSquaresIterate(NamedTuple):
    """The value of an iteration, which may be any pytree, the damping of the next step, and the size of the last
    one.
    """

    value: Any
    damping: jax.Array
    iterations: jax.Array
    step: jax.Array
    done: jax.Array


def levenberg_marquardt(start: Any, tried: Tried, tolerance: jax.Array, max_iterations: int) -> LeastSquaresIterate:
    """The last iterate. A step is accepted if it is better; the damping then decreases, eventually to zero; otherwise
    it increases.

    Args:
        tried: a function that returns a step, and whether it lowers the cost.
        tolerance: the iteration ends after an undamped step of a smaller size.

    Source: Marquardt, An algorithm for least-squares estimation of nonlinear parameters, SIAM J. Appl. Math. 11 (1963).
    """
    zero = jnp.zeros_like(tolerance)

    def advance(iterate: LeastSquaresIterate) -> LeastSquaresIterate:
        new, better, step = tried(iterate.value, iterate.damping)
        return LeastSquaresIterate(
            jax.tree.map(lambda a, b: jnp.where(better, a, b), new, iterate.value),
            next_damping(iterate.damping, better),
            iterate.iterations + 1,
            step,
            (step < tolerance) & (iterate.damping == 0.0),
        )

    def going(iterate: LeastSquaresIterate) -> jax.Array:
        return ~iterate.done & (iterate.iterations < max_iterations) & (iterate.damping < MOST_DAMPING)

    first = LeastSquaresIterate(start, zero, jnp.zeros((), jnp.int32), zero + jnp.inf, jnp.zeros((), bool))
    return jax.lax.while_loop(going, advance, first)


def next_damping(damping: jax.Array, better: jax.Array) -> jax.Array:
    """The next damping: it decreases after a step that lowered the cost, eventually to zero, and increases after
    others.
    """
    down = jnp.where(damping > _DAMPING, damping / _FACTOR, 0.0)
    return jnp.where(better, down, jnp.maximum(damping * _FACTOR, _DAMPING))
