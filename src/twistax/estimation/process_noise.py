"""The covariance of the noise of a prediction."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, TypeAlias

import jax
import jax.numpy as jnp

#: From a fraction of a step to F (n, n) and G W G^T (n, n) there: $d' = F d + G w$ with the intensity W of w.
LocalNoise: TypeAlias = Callable[[float], tuple[jax.Array, jax.Array]]


class NoiseDiscretization(ABC):
    """How continuous noise becomes the covariance of a prediction, $P = Phi P Phi^T + Q$.

    Q is (n, n), in products of the units of a tangent.

    Raises: nothing.
    """

    #: Whether it has a scalar form, so that a prediction is one kernel, and C.
    in_scalars: ClassVar[bool] = True

    @abstractmethod
    def covariance(self, local: LocalNoise, transition: jax.Array, h: jax.Array) -> jax.Array:
        """Q (n, n) of a step of h seconds, by its transition matrix (n, n)."""


@dataclasses.dataclass(frozen=True)
class VanLoan(NoiseDiscretization):
    """$Q = int_0^h exp(F s) G W G^T exp(F s)^T ds$ with F, G and the intensity W in the middle of the step.

    Exact for a linear system with constant coefficients, by an exponential of size (2 n, 2 n).

    Raises: nothing.

    Source: Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23 (1978), theorem 1.
    """

    in_scalars = False

    def covariance(self, local: LocalNoise, transition: jax.Array, h: jax.Array) -> jax.Array:
        F, intensity = local(0.5)
        n = len(F)
        block = jnp.block([[-F, intensity], [jnp.zeros_like(F), F.T]]) * h
        exponential = jax.scipy.linalg.expm(block)
        Q = exponential[n:, n:].T @ exponential[:n, n:]
        return 0.5 * (Q + Q.T)


@dataclasses.dataclass(frozen=True)
class Trapezoidal(NoiseDiscretization):
    """$Q = h / 2 (Phi G_0 W_0 G_0^T Phi^T + G_1 W_1 G_1^T)$, the trapezoidal rule of the same integral.

    Its error is proportional to the third power of h in s. It is a few sums where the exponential is a program, so a
    filter in C takes it.

    Raises: nothing.

    Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), sec. 6.3.
    """

    def covariance(self, local: LocalNoise, transition: jax.Array, h: jax.Array) -> jax.Array:
        (_, before), (_, after) = local(0.0), local(1.0)
        return 0.5 * h * (transition @ before @ transition.T + after)
