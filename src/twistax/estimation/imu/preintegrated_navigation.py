"""Inertial navigation whose steps are preintegrated readings: the process of a smoother with states at keyframes."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import reals
from ...errors import InputError, ModelError
from ...expr import Control, Noise, State, leaves_of
from ...groups import SO3
from ...integrators import ZeroOrderHold
from ...linear.discretize import value_and_jacobian
from ...scalar.backends import JAX
from ...system.dynamics import Arrays, Dynamics, compile
from ...system.system import System
from ..measurement import Measurement
from ..records import controls_on, jumps_of
from ..stochastic_model import OperatingPoint, StochasticModel
from .preintegration import InertialState, PreintegratedImu, Preintegration

#: The relative motion of an interval among its controls.
_MOTION = "preintegrated readings"


class PreintegratedNavigation:
    """The motion of a vehicle with an inertial measurement unit, between keyframes: the times of other measurements.

    `BatchSmoother` and the filters accept it in place of a compiled system, and then have one step between two
    keyframes. With the preintegrated readings $Delta R, Delta v, Delta p$ and their Jacobian by the biases,

        $R_1 = R_0 Delta R Exp(phi), v_1 = v_0 + g T + R_0 (Delta v + dv),$
        $p_1 = p_0 + v_0 T + g T^2 / 2 + R_0 (Delta p + dp), b_1 = b_0 + db,$

    where $[phi; dv; dp; db]$ has the covariance of the readings and of the random walks. An iteration of a smoother
    does not repeat the integration, so its cost depends on the number of keyframes only. Biases are subtracted from
    the readings at the values of x0, and corrected to first order.

    Args:
        imu: `Preintegration` with the densities of the sensors.
        gravity: (3,) in the world, m/s2.
    Attributes:
        rotation, velocity, position, gyro_bias, accelerometer_bias: the states, for expressions of measurements. The
            rotation transforms body coordinates to the world.
        dynamics: the same motion as rates, with the controls "gyro" and "accelerometer", for filters that integrate
            each reading.
    Raises:
        ModelError: an object that is not a Preintegration; gravity of another shape.

    Example:
        `navigation = tx.estimation.PreintegratedNavigation(imu, [0.0, 0.0, -9.81])`, then
        `tx.Measurement("gps", navigation.position, covariance=1.0)`.

    Source: Forster, Carlone, Dellaert, Scaramuzza, On-manifold preintegration for real-time visual-inertial odometry,
    IEEE TRO 33 (2017), eq. 38, 44, 45 and 48.
    """

    def __init__(self, imu: Preintegration, gravity: Any) -> None:
        if not isinstance(imu, Preintegration):
            raise ModelError(f"PreintegratedNavigation expects a tx.estimation.Preintegration, got {imu!r}")
        self.imu = imu
        self.gravity = reals("PreintegratedNavigation: gravity", gravity, ModelError).astype(float)
        if self.gravity.shape != (3,) or not np.isfinite(self.gravity).all():
            raise ModelError(f"PreintegratedNavigation: gravity expects three finite numbers, got {gravity!r}")
        self.rotation = State("rotation", group=SO3)
        self.velocity, self.position, self.gyro_bias, self.accelerometer_bias = (
            State(name, shape=(3,)) for name in ("velocity", "position", "gyro_bias", "accelerometer_bias")
        )

    @functools.cached_property
    def dynamics(self) -> Dynamics:
        gyro, accelerometer = (Control(name, shape=(3,)) for name in ("gyro", "accelerometer"))
        noise = Noise("readings", shape=(6,), density=self.imu.densities)
        walk = Noise("walks", shape=(6,), density=self.imu.walks)
        force = accelerometer - self.accelerometer_bias - noise[3:]
        rates: dict[State | str, Any] = {
            self.rotation: gyro - self.gyro_bias - noise[:3],
            self.velocity: self.rotation @ force + self.gravity,
            self.position: self.velocity,
            self.gyro_bias: walk[:3],
            self.accelerometer_bias: walk[3:],
        }
        return compile(System(rates=rates, controls=[gyro, accelerometer]))


class PreintegratedModel(StochasticModel):
    """The stochastic model of `PreintegratedNavigation`."""

    def __init__(
        self, navigation: PreintegratedNavigation, measurements: Iterable[Measurement], dynamics: Dynamics | None = None
    ) -> None:
        super().__init__(navigation.dynamics if dynamics is None else dynamics, measurements, None, None)
        self.navigation = navigation
        self._readings = {control.name: control.shape for control in self.dynamics.controls}
        for measurement in self.measurements.values():
            errors = () if measurement.covariance is None else (measurement.covariance,)
            for leaf in leaves_of(measurement.value, *errors):
                if isinstance(leaf, Control) and leaf.name in self._readings:
                    raise ModelError(
                        f"Measurement {measurement.name!r} reads the control {leaf.name!r}, but readings are "
                        "preintegrated.\n  fix: use navigation.dynamics, which integrates each reading"
                    )

    @functools.cached_property
    def in_arrays(self) -> StochasticModel:
        dynamics = Dynamics(self.dynamics.functions.run_by(JAX()))
        return PreintegratedModel(self.navigation, self.measurements.values(), dynamics)

    def jumps(self, u: Any) -> list[np.ndarray]:
        return []

    def stage_controls(self, u: Any, ts: np.ndarray, x0: Arrays, dtype: Any) -> dict[str, PreintegratedImu]:
        """The relative motions of the intervals that end at times (k,), with a leading axis of k."""
        for name in self._readings:
            if not isinstance(u, Mapping) or not isinstance(u.get(name), ZeroOrderHold):
                raise InputError(
                    f"preintegration expects the readings {name!r} as a table.\n"
                    f"  fix: u={{{name!r}: tx.ZeroOrderHold(times, readings)}}"
                )
        inside = [at[(at > ts[0]) & (at < ts[-1])] for at in jumps_of(u)]
        ends = np.unique(np.concatenate([ts, *inside]))
        values = controls_on(u, ends, dtype)
        readings = jnp.concatenate([values[name] for name in ("gyro", "accelerometer")], axis=1)
        bias = jnp.concatenate([x0["gyro_bias"], x0["accelerometer_bias"]])
        lengths = jnp.asarray(np.diff(ends, prepend=ends[0]), dtype)
        intervals = jnp.asarray(np.searchsorted(ts, ends), jnp.int32)
        return {_MOTION: self.navigation.imu.over_intervals(readings, lengths, bias, intervals, len(ts))}

    def with_zeros(self, u: Any, dtype: Any) -> dict[str, Any]:
        zeros = {name: jnp.zeros(shape, dtype) for name, shape in self._readings.items()}
        return super().with_zeros({**zeros, **{name: u[name] for name in u if name != _MOTION}}, dtype)

    def step(self, point: OperatingPoint, h: jax.Array) -> tuple[Arrays, jax.Array, jax.Array]:
        n, dtype = self.dimension, point.t.dtype

        def after(z: jax.Array) -> Arrays:
            return self._reached(point.moved(x=self.group.retract(point.x, z[:n])), z[n:])

        zero = jnp.zeros(n + 15, dtype)
        end = after(zero)
        _, slopes = value_and_jacobian(lambda z: self.group.difference(end, after(z)), zero)
        transition, G = slopes[:, :n], slopes[:, n:]
        return end, transition, G @ self._motion(point).joint_covariance @ G.T

    def process_noise(self, point: OperatingPoint, x1: Arrays, transition: jax.Array, h: jax.Array) -> jax.Array:
        return self.step(point, h)[2]

    def moved(self, point: OperatingPoint, h: jax.Array) -> Arrays:
        return self._reached(point, jnp.zeros(15, point.t.dtype))

    def _motion(self, point: OperatingPoint) -> PreintegratedImu:
        if _MOTION not in point.u:
            raise ModelError(
                "a prediction with preintegrated readings needs the readings of a run.\n"
                "  fix: use run(...), or a filter of navigation.dynamics"
            )
        motion: Any = point.u[_MOTION]
        return cast(PreintegratedImu, motion)

    def _reached(self, point: OperatingPoint, error: jax.Array) -> Arrays:
        """The state at the end of an interval with an error [d; db]."""
        x = point.x
        bias = jnp.concatenate([x["gyro_bias"], x["accelerometer_bias"]])
        start = InertialState(x["rotation"], x["velocity"], x["position"])
        gravity = jnp.asarray(self.navigation.gravity, error.dtype)
        end = self._motion(point).predict(start, gravity, bias, error[:9])
        motion = {"rotation": end.rotation, "velocity": end.velocity, "position": end.position}
        return motion | {"gyro_bias": bias[:3] + error[9:12], "accelerometer_bias": bias[3:] + error[12:]}


def model_of(
    dynamics: Dynamics | PreintegratedNavigation, measurements: Iterable[Measurement], method: Any, noise: Any
) -> StochasticModel:
    """The stochastic model of a compiled system or of preintegrated readings. Raises ModelError."""
    if not isinstance(dynamics, PreintegratedNavigation):
        return StochasticModel(dynamics, measurements, method, noise)
    for name, value in {"method": method, "noise": noise}.items():
        if value is not None:
            raise ModelError(f"{name} expects None where readings are preintegrated, got {value!r}")
    return PreintegratedModel(dynamics, measurements)
