"""Gauss-Newton steps that are damped after Levenberg and Marquardt where they do not help."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

#: The first damping after a step that raised the cost, the factor between two, and the largest.
_DAMPING, _FACTOR, _MOST = 1e-2, 10.0, 1e8

#: (value, damping) -> (new value, whether it is better, size of the step).
Tried = Callable[[Any, jax.Array], tuple[Any, jax.Array, jax.Array]]


class LeastSquaresIterate(NamedTuple):
    """The value of an iteration, any pytree, the damping of the next step, and the size of the last one."""

    value: Any
    damping: jax.Array
    iterations: jax.Array
    step: jax.Array
    done: jax.Array


def levenberg_marquardt(start: Any, tried: Tried, tolerance: jax.Array, max_iterations: int) -> LeastSquaresIterate:
    """The last iterate. A step is taken if it is better; the damping falls after it to zero, else it rises.

    Args:
        tried: a step, and whether it lowers the cost.
        tolerance: an undamped step of a size below it is the last one.

    Source: Marquardt, An algorithm for least-squares estimation of nonlinear parameters, SIAM J. Appl. Math. 11 (1963).
    """
    zero = jnp.zeros_like(tolerance)

    def advance(iterate: LeastSquaresIterate) -> LeastSquaresIterate:
        new, better, step = tried(iterate.value, iterate.damping)
        down = jnp.where(iterate.damping > _DAMPING, iterate.damping / _FACTOR, zero)
        up = jnp.maximum(iterate.damping * _FACTOR, jnp.asarray(_DAMPING, zero.dtype))
        return LeastSquaresIterate(
            jax.tree.map(lambda a, b: jnp.where(better, a, b), new, iterate.value),
            jnp.where(better, down, up),
            iterate.iterations + 1,
            step,
            (step < tolerance) & (iterate.damping == 0.0),
        )

    def going(iterate: LeastSquaresIterate) -> jax.Array:
        return ~iterate.done & (iterate.iterations < max_iterations) & (iterate.damping < _MOST)

    first = LeastSquaresIterate(start, zero, jnp.zeros((), jnp.int32), zero + jnp.inf, jnp.zeros((), bool))
    return jax.lax.while_loop(going, advance, first)
