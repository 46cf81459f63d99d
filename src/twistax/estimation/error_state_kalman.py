"""The error-state Kalman filter, multiplicative on groups."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..checks import callable_with
from ..errors import ModelError
from ..groups import Product
from ..integrators import StepControl
from ..system.dynamics import Dynamics
from ..system.export import CFiles
from .filter import Filter
from .imu.preintegrated_navigation import PreintegratedModel, PreintegratedNavigation
from .measurement import Measurement
from .prediction.adaptive_prediction import Prediction
from .prediction.process_noise import NoiseDiscretization
from .stochastic_model import OperatingPoint
from .update import LinearMeasurement, Reset, Update, linear_update, symmetric


class ErrorStateKalman(Filter):
    """The extended Kalman filter on the group of the state, multiplicative (an MEKF) on rotations and poses.

    The state stays on the group; the covariance P is that of the error d with $x_true = x Exp(d)$, in the tangent space
    at x. A prediction integrates the mean by the method and propagates the covariance, $P = Phi P Phi^T + Q$, with Phi
    the derivative of the step and Q by Van Loan's method. An update is

        $S = H P H^T + R, K = P H^T S^-1, d = K Log(h(x)^-1 z),$
        $x = x Exp(d), P = J_r(d) ((I - K H) P (I - K H)^T + K R K^T) J_r(d)^T$,

    in Joseph's symmetric form. The right Jacobian J_r(d) transforms the covariance to the tangent space at the new
    state.

    Args:
        dynamics: the compiled system, with `tx.Noise` in its rates; or a `PreintegratedNavigation`.
        measurements: the models of the sensors, a `tx.Measurement` each.
        method: the integration method of the mean; RKMK with RK4 by default.
        max_step: the longest step of a prediction in s; by default there is one step between two times.
        rtol, atol: tolerances of a step, as of `tx.integrate`. With them each prediction is divided into steps whose
            estimated errors of the mean and of standard deviations, in units of `atol + rtol * size`, have a root mean
            square of at most one. The method is an embedded pair, by default RKMK with TSIT5. The error of the noise
            covariance has no estimate; `max_step` bounds it.
        control: a `tx.StepControl` of these steps. A prediction tries at most `max_steps`, by default 256.
        gate: a probability. A measurement is used only if its normalised innovation squared is below the chi-square
            quantile of this probability.
        noise: the discretisation of continuous noise: `VanLoan()`, the default, or `Trapezoidal()`.
        reset: a function (group, d) -> (n, n), the transformation of covariances to the new state; the default is
            `group.right_jacobian(d)`, which is exact to first order.
    Raises:
        ModelError: two measurements of one name, a state or control that the system does not have, a noise both in
            rates and in measurements, a gate outside of (0, 1), a reset that is not a function of two arguments,
            tolerances with a method without an embedded solution.
        InputError: invalid tolerances.

    Example: `tx.estimation.ErrorStateKalman(dynamics, [gps]).run({"gps": (times, positions)}, x0, P0)`.

    Source: Markley, Attitude error representations for Kalman filtering, JGCD 26 (2003), eq. 38-45; Sola, Quaternion
    kinematics for the error-state Kalman filter (2017), sec. 6.3, for the reset.
    """

    def __init__(
        self,
        dynamics: Dynamics | PreintegratedNavigation,
        measurements: Iterable[Measurement],
        *,
        method: Any = None,
        max_step: float | None = None,
        rtol: Any = None,
        atol: Any = None,
        control: StepControl | None = None,
        gate: float | None = None,
        noise: NoiseDiscretization | None = None,
        reset: Reset = Product.right_jacobian,
    ) -> None:
        steps: dict[str, Any] = {"max_step": max_step, "rtol": rtol, "atol": atol, "control": control}
        super().__init__(dynamics, measurements, method=method, gate=gate, noise=noise, **steps)
        callable_with("reset", reset, ("group", "d"), ModelError)
        self.reset = reset

    def propagated(self, point: OperatingPoint, P: jax.Array, h: jax.Array) -> Prediction:
        x, transition, Q = self.model.step(point, h)
        return Prediction(x, symmetric(transition @ symmetric(P) @ transition.T + Q), transition)

    def corrected(self, name: str, point: OperatingPoint, P: jax.Array, z: jax.Array, limit: float | None) -> Update:
        update: Update = self.model.matrices(self.after, limit=limit)(self.model.residual(name, point, z), P)
        return update

    def to_c(
        self,
        directory: str | Path,
        *,
        name: str = "kalman",
        dtype: Any = np.float64,
        tolerance: float | None = None,
    ) -> CFiles:
        """Write C99 code: `name.h` with the interface, `name.c`, and `name_test.c` with reference values.

        `name_predict` takes time, states, controls, parameters, P and the step size h, and returns the states and P
        after the step. `name_update_gps` takes the value of the measurement "gps", and returns states, P and the
        normalised innovation squared; if that is beyond the gate, states and P are unchanged. They compute `predict`
        and `update` of this filter, allocate no memory and need only libm. Only the lower triangle of P is read. With
        `VanLoan()` the prediction has a loop of at most 40 iterations; with `Trapezoidal()` it has none.

        Args:
            directory: the folder of the files, which is created if missing.
            name: the name of the files, and the prefix of all functions.
            dtype: float64 or float32, the precision of the code, independent of JAX's x64 setting.
            tolerance: tolerance of the test's comparison, relative to the largest entry of a function; by default
                1e-10, or 1e-4 for float32.
        Returns:
            The paths `header`, `source` and `test`.
        Raises:
            ModelError: a filter with tolerances; a part that has no scalar form; two names that become the same in C.
            InputError: a name that is not a C identifier, or another dtype; a directory that is not writable, or that
                contains other files of these names.
        """
        from .filter_code import write_filter

        if self.adaptive is not None:
            raise ModelError(
                "to_c: a prediction with rtol has no form in C.\n"
                "  fix: export a filter without rtol and atol, and call its prediction several times with short steps"
            )
        if isinstance(self.model, PreintegratedModel):
            raise ModelError(
                "to_c: a filter with preintegrated readings has no C code.\n  fix: use a filter of navigation.dynamics"
            )

        return write_filter(self, directory, name=name, dtype=dtype, tolerance=tolerance)

    def after(self, measured: LinearMeasurement, P: jax.Array, limit: float | None) -> Update:
        """The estimate after a linearised measurement."""
        return linear_update(self.model.group, measured, symmetric(P), limit, self.reset)
