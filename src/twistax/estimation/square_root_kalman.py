"""The error-state Kalman filter with square roots of covariances."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from ..errors import ModelError
from ..system.export import CFiles
from .covariance_root import CovarianceRoot, triangular
from .error_state_kalman import ErrorStateKalman
from .prediction.adaptive_prediction import Prediction
from .stochastic_model import OperatingPoint
from .update import LinearMeasurement, Update, root_update


class SquareRootKalman(ErrorStateKalman):
    """`ErrorStateKalman` with a square root of the covariance, $P = L L^T$, for single precision.

    A run propagates L, (n, n), in the units of the tangent. A prediction triangularises $[Phi L, Q^(1/2)]$, and an
    update $[R^(1/2), H L; 0, L]$, by QR factorisations. No entry is squared, so the ratio of standard deviations may
    use all digits of the precision, compared with half of them for a covariance. $L L^T$ is positive semidefinite for
    any round-off. In exact arithmetic the results are those of `ErrorStateKalman`.

    Args:
        dynamics, measurements, method, max_step, rtol, atol, control, gate, noise, reset: as for `ErrorStateKalman`.
    Raises:
        ModelError: the errors of `ErrorStateKalman`.

    Example: `tx.estimation.SquareRootKalman(dynamics, [gps]).run({"gps": (times, positions)}, x0, P0)`.

    Source: Kaminski, Bryson, Schmidt, Discrete square root filtering, IEEE TAC 16 (1971), eq. 35 and 42.
    """

    in_scalars = False

    def to_c(self, directory: str | Path, **options: Any) -> CFiles:
        """Raises ModelError, because a QR factorisation has no scalar form. Use `ErrorStateKalman` for C code."""
        raise ModelError(
            "to_c: the QR factorisation of SquareRootKalman has no scalar form.\n"
            "  fix: use ErrorStateKalman(...).to_c(...)"
        )

    def factored(self, P: jax.Array) -> jax.Array:
        return CovarianceRoot.of(P).matrix

    def multiplied(self, factor: jax.Array) -> jax.Array:
        return factor @ factor.T

    def propagated(self, point: OperatingPoint, P: jax.Array, h: jax.Array) -> Prediction:
        x, transition, Q = self.model.step(point, h)
        root = triangular(jnp.concatenate([transition @ P, CovarianceRoot.of(Q).matrix], axis=1))
        return Prediction(x, root, transition)

    def after(self, measured: LinearMeasurement, P: jax.Array, limit: float | None) -> Update:
        return root_update(self.model.group, measured, P, limit, self.reset)
