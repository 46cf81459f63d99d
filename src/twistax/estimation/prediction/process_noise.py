"""The discretisation of process noise: its covariance over a prediction."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, TypeAlias

import jax
import jax.numpy as jnp

from ..update import symmetric

#: From a fraction of a step to F (n, n) and G W G^T (n, n) there: $d' = F d + G w$ with the intensity W of w.
LocalNoise: TypeAlias = Callable[[float], tuple[jax.Array, jax.Array]]


class NoiseDiscretization(ABC):
    """The interface of discretisations: the covariance Q of a prediction, $P = Phi P Phi^T + Q$, from continuous noise.

    Q is (n, n), in products of the units of the tangent.

    Raises: nothing.
    """

    #: The fractions of a step at which it reads the noise.
    fractions: ClassVar[tuple[float, ...]] = (0.0, 0.5, 1.0)

    @abstractmethod
    def covariance(self, local: LocalNoise, transition: jax.Array, h: jax.Array) -> jax.Array:
        """The covariance Q (n, n) of a step of h seconds, with the transition matrix (n, n) of the step."""


@dataclasses.dataclass(frozen=True)
class VanLoan(NoiseDiscretization):
    """The covariance $Q = int_0^h exp(F s) G W G^T exp(F s)^T ds$, with F, G and the intensity W at the midpoint of the
    step.

    It is exact for a linear system with constant coefficients, to the accuracy of a matrix exponential, also if decay
    rates are much faster than the step. NaN if the norm of F h exceeds about 5e9, in single precision 1e11.

    Raises: nothing.

    Source: Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23 (1978), for the integral; its
    evaluation by doubling is that of Moler, Van Loan, Nineteen dubious ways, SIAM Review 45 (2003), method 3.
    """

    fractions = (0.5,)

    def covariance(self, local: LocalNoise, transition: jax.Array, h: jax.Array) -> jax.Array:
        F, intensity = local(0.5)
        return gramian(F * h, intensity * h)


@dataclasses.dataclass(frozen=True)
class Trapezoidal(NoiseDiscretization):
    """The covariance $Q = h / 2 (Phi G_0 W_0 G_0^T Phi^T + G_1 W_1 G_1^T)$, the trapezoidal rule for the same integral.

    Its error is proportional to $h^3$, h in s. It needs a few sums in place of a matrix exponential, so its code in C
    is short and has no loop.

    Raises: nothing.

    Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), sec. 6.3.
    """

    fractions = (0.0, 1.0)

    def covariance(self, local: LocalNoise, transition: jax.Array, h: jax.Array) -> jax.Array:
        (_, before), (_, after) = local(0.0), local(1.0)
        return 0.5 * h * (transition @ before @ transition.T + after)


# ---- the integral of exponentials ------------------------------------------------------------------------------------

#: The terms of the series over the shortest interval.
_TERMS = 6
#: How often an interval is doubled at most. More is an F h of 5e9, in single precision 1e11, and gives NaN.
_MOST_DOUBLINGS = 40


def gramian(A: jax.Array, W: jax.Array) -> jax.Array:
    """The integral $int_0^1 exp(A s) W exp(A s)^T ds$ (n, n), for a symmetric W.

    It is computed by its Taylor series over 2^-k of the interval, which is doubled k times,

        $Q(2 s) = Q(s) + Phi Q(s) Phi^T, Phi(2 s) = Phi(s)^2, Phi = exp(A s)$.

    The number k follows from the value of A, so that the series is exact to round-off. The recursion uses Phi - 1, so
    unnecessary doublings lose no accuracy. In contrast to exp(-A s) in Van Loan's block matrix, no exponential grows
    that does not grow in the integral.
    """
    square = A @ A
    norms = (jnp.max(jnp.sum(jnp.abs(M), axis=0)) for M in (A, square, A @ square))
    one, two, three = jax.lax.stop_gradient(tuple(norms))
    # As the series has powers from the second on, what bounds it is less than the norm where A is nilpotent.
    size = jnp.minimum(one, jnp.maximum(jnp.sqrt(two), jnp.cbrt(three)))
    rounding = 0.5 * float(jnp.finfo(A.dtype).eps)
    longest = 0.5 * (math.factorial(_TERMS + 1) * rounding) ** (1.0 / _TERMS)
    doublings = jnp.ceil(jnp.log2(jnp.maximum(size / longest, 1.0)))
    doublings = jnp.where(doublings <= _MOST_DOUBLINGS, doublings, jnp.nan)
    B = A * 0.5**doublings
    term, power = W * 0.5**doublings, B
    Q, change = term, power
    for k in range(2, _TERMS + 1):
        half = B @ term
        term, power = (half + half.T) / k, B @ power / k
        Q, change = Q + term, change + power
    return _doubled(doublings, change, symmetric(Q))


def _doubling(change: jax.Array, Q: jax.Array) -> tuple[jax.Array, jax.Array]:
    moved = Q + change @ Q
    return 2.0 * change + change @ change, symmetric(Q + moved + moved @ change.T)


@jax.custom_jvp
def _doubled(count: jax.Array, change: jax.Array, Q: jax.Array) -> jax.Array:
    """Q over an interval that is doubled so many times; `change` is Phi - 1 over it."""

    def double(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        left, change, Q = state
        return left - 1.0, *_doubling(change, Q)

    return jax.lax.while_loop(lambda state: state[0] > 0.0, double, (count, change, Q))[2]


@_doubled.defjvp
def _doubled_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    """By a loop of known length, which reverse passes need."""
    count, *start = primals

    def double(state: Any, k: jax.Array) -> tuple[Any, None]:
        # What is doubled once more than needed may be beyond all numbers, and a reverse pass multiplies it by zero.
        safe = [jnp.where(k < count, old, jnp.zeros_like(old)) for old in state]
        return jax.lax.cond(k < count, lambda: _doubling(*safe), lambda: state), None

    def scanned(change: jax.Array, Q: jax.Array) -> jax.Array:
        return jax.lax.scan(double, (change, Q), jnp.arange(_MOST_DOUBLINGS, dtype=count.dtype))[0][1]

    return jax.jvp(scanned, tuple(start), tuple(tangents[1:]))
