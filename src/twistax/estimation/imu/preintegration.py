"""Preintegration: the readings of an inertial measurement unit between two times as one relative motion, with its
covariance.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import real_array, reals
from ...errors import InputError, ModelError, ShapeError
from ...groups import SO3, Euclidean, Product
from ...groups.arrays import Input, floats, multiply, of_shape
from ...groups.series import stumpff
from ...groups.so3 import exp, hat
from ...jax_inside import is_traced
from ...linear.discretize import value_and_jacobian
from ...system.inputs import is_finite

#: Rotation, velocity and position relative to the start, with d = [phi; dv; dp].
_MOTION = Product({"R": SO3, "v": Euclidean(3), "p": Euclidean(3)})
_STATE = {"rotation": (3, 3), "velocity": (3,), "position": (3,)}


class InertialState(NamedTuple):
    """Attitude, velocity and position of a vehicle in the world.

    Attributes:
        rotation: attitude, (3, 3).
        velocity: (3,) in m/s.
        position: (3,) in m.
    """

    rotation: jax.Array
    velocity: jax.Array
    position: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PreintegratedImu:
    """The relative motion between two times, computed from the readings alone. A pytree.

    Attributes:
        duration: T, s.
        rotation, velocity, position: $R_0^T R_1$; $R_0^T (v_1 - v_0 - g T)$; $R_0^T (p_1 - p_0 - v_0 T - g T^2 / 2)$.
        joint_covariance: (15, 15) covariance of $[d; db]$ with the error $d = [phi; dv; dp]$ and the change db of the
            biases by their random walks: the true rotation is $R Exp(phi)$, the true vectors are $v + dv$ and $p + dp$.
        jacobian: (9, 6), the derivative of d with respect to the biases of gyroscope and accelerometer.
        bias: (6,), the biases that were subtracted: rad/s and m/s2.
    """

    duration: jax.Array
    rotation: jax.Array
    velocity: jax.Array
    position: jax.Array
    joint_covariance: jax.Array
    jacobian: jax.Array
    bias: jax.Array

    @property
    def covariance(self) -> jax.Array:
        """(9, 9) covariance of the error $d = [phi; dv; dp]$."""
        return self.joint_covariance[:9, :9]

    def corrected(self, bias: Input) -> InertialState:
        """The relative motion for other biases (6,), to first order in their change. Raises ShapeError for another
        shape.

        Source: Forster et al. (2017), eq. 44.
        """
        (other,) = of_shape("corrected", {"bias": (6,)}, bias)
        motion = {"R": self.rotation, "v": self.velocity, "p": self.position}
        return _inertial(_MOTION.retract(motion, self.jacobian @ (other - self.bias)))

    def predict(
        self, start: InertialState, gravity: Input, bias: Input | None = None, error: Input | None = None
    ) -> InertialState:
        """The state at the end, from the state at the start, gravity (3,) in m/s2, biases (6,) and the error d (9,) of
        the relative motion, which is zero by default. Raises ShapeError for another shape.
        """
        delta, T = self._delta(bias), self.duration
        if error is not None:
            motion = {"R": delta.rotation, "v": delta.velocity, "p": delta.position}
            delta = _inertial(_MOTION.retract(motion, *of_shape("predict", {"error": (9,)}, error)))
        R, v, p, g = of_shape("predict", {**_STATE, "gravity": (3,)}, *start, gravity)
        return InertialState(
            multiply(R, delta.rotation),
            v + g * T + multiply(R, delta.velocity),
            p + v * T + 0.5 * T * T * g + multiply(R, delta.position),
        )

    def residual(
        self, start: InertialState, end: InertialState, gravity: Input, bias: Input | None = None
    ) -> jax.Array:
        """The residual (9,) between the states at both ends and the readings; its covariance is `covariance`.

        Raises: ShapeError.

        Source: Forster et al. (2017), eq. 45.
        """
        delta, T = self._delta(bias), self.duration
        R, v, p, g = of_shape("residual", {**_STATE, "gravity": (3,)}, *start, gravity)
        R1, v1, p1 = of_shape("residual", _STATE, *end)
        seen = {
            "R": multiply(R.T, R1),
            "v": multiply(R.T, v1 - v - g * T),
            "p": multiply(R.T, p1 - p - v * T - 0.5 * T * T * g),
        }
        return _MOTION.difference({"R": delta.rotation, "v": delta.velocity, "p": delta.position}, seen)

    def _delta(self, bias: Input | None) -> InertialState:
        return self.corrected(self.bias if bias is None else bias)


class Preintegration:
    """Integration of gyroscope and accelerometer readings between two times, in the body frame at the first time.

    The result does not depend on states, so an optimiser that changes the states does not repeat the integration.
    Biases are corrected to first order. Readings are constant over each interval, and the motion is exact for them:

        $R' = R Exp(w h), v' = v + R G_1(w h) a h, p' = p + v h + R G_2(w h) a h^2, G_m(x) = sum_n hat(x)^n / (n + m)!$,

    where Forster et al. use one step of Euler's method. Traceable.

    A bias that walks shifts the readings of an interval of length h by the mean of its change over the interval. The
    covariance of this mean and of the change at the end is $sigma^2 h [1/3, 1/2; 1/2, 1]$.

    Args:
        gyro: density of the gyroscope's white noise, rad/s per $Hz^(1/2)$: a number or one for each axis.
        accelerometer: density of the accelerometer's white noise, m/s2 per $Hz^(1/2)$.
        gyro_walk, accelerometer_walk: densities of the white noise that drives the random walks of the biases, rad/s2
            and m/s3 per $Hz^(1/2)$; zero by default.
    Raises:
        ModelError: densities that are negative or of another shape.

    Example: `tx.estimation.Preintegration(2e-4, 2e-3).integrate(rates, forces, 0.01).rotation`.

    Source: Forster, Carlone, Dellaert, Scaramuzza, On-manifold preintegration for real-time visual-inertial odometry,
    IEEE TRO 33 (2017), sec. VI.
    """

    def __init__(self, gyro: Any, accelerometer: Any, *, gyro_walk: Any = 0.0, accelerometer_walk: Any = 0.0) -> None:
        self.densities = np.concatenate([_density("gyro", gyro), _density("accelerometer", accelerometer)])
        self.walks = np.concatenate(
            [_density("gyro_walk", gyro_walk), _density("accelerometer_walk", accelerometer_walk)]
        )

    def integrate(self, gyro: Input, accelerometer: Input, h: Any, bias: Input | None = None) -> PreintegratedImu:
        """The relative motion from k readings.

        Args:
            gyro: (k, 3) in rad/s; accelerometer: (k, 3) in m/s2, specific forces.
            h: length of the interval of each reading, s: a number or (k,).
            bias: (6,) biases of both, which are subtracted; zero by default.
        Raises: InputError, ShapeError for invalid readings.
        """
        (rates,) = floats(gyro, names=["gyro"])
        if rates.ndim != 2 or rates.shape[1] != 3 or not len(rates):
            raise ShapeError(f"gyro expects readings of shape (k, 3), got {rates.shape}")
        count, dtype = len(rates), rates.dtype
        (forces,) = of_shape("integrate", {"accelerometer": (count, 3)}, accelerometer)
        (biases,) = of_shape("integrate", {"bias": (6,)}, jnp.zeros(6, dtype) if bias is None else bias)
        lengths = real_array("h", h)
        if lengths.shape not in ((), (count,)):
            raise ShapeError(f"h expects a number or shape ({count},), got {lengths.shape}")
        for name, values in {"gyro": rates, "accelerometer": forces, "h": lengths, "bias": biases}.items():
            if not is_finite(values):
                raise InputError(f"{name} expects finite numbers, got others")
        if not is_traced(lengths) and (np.asarray(lengths) <= 0.0).any():
            raise InputError(f"h expects positive numbers of s, got {np.asarray(lengths).min():g}")
        forces, biases, lengths = (jnp.asarray(a, dtype) for a in (forces, biases, lengths))
        lengths = jnp.broadcast_to(lengths, (count,))
        readings = jnp.concatenate([rates, forces], axis=1)
        intervals = jnp.zeros(count, jnp.int32)
        return jax.tree.map(lambda a: a[0], self.over_intervals(readings, lengths, biases, intervals, 1))

    def over_intervals(
        self, readings: jax.Array, lengths: jax.Array, bias: jax.Array, intervals: jax.Array, count: int
    ) -> PreintegratedImu:
        """The relative motions of several intervals, with a leading axis of them. Arguments are not checked.

        Args:
            readings: (k, 6), gyroscope and accelerometer.
            lengths: (k,) in s.
            bias: (6,), which is subtracted.
            intervals: (k,) int32, to which interval a reading belongs, in order.
            count: the number of intervals.
        """
        intensities = (jnp.asarray(a, readings.dtype) ** 2 for a in (self.densities, self.walks))
        T, motion, P, J = _integrated((readings - bias[None, :], lengths, intervals), *intensities, count)
        return PreintegratedImu(
            T, motion["R"], motion["v"], motion["p"], P, J, jnp.broadcast_to(bias, (count, *bias.shape))
        )


@functools.partial(jax.jit, static_argnames="count")
def _integrated(rows: tuple[jax.Array, ...], white: jax.Array, walk: jax.Array, count: int) -> Any:
    """Durations, motions, covariances and derivatives by the biases, from intensities of the noise."""
    dtype = white.dtype
    start = (
        jnp.zeros((), dtype),
        _MOTION.identity(dtype),
        jnp.zeros((15, 15), dtype),
        jnp.zeros((9, 6), dtype),
    )

    def advance(carry: Any, row: Any) -> tuple[Any, None]:
        (reading, h, i), (state, before, results) = row, carry
        T, motion, P, J = jax.tree.map(lambda a, b: jnp.where(i == before, a, b), state, start)
        after, A, B = _step(motion, reading, h)
        F = jnp.eye(15, dtype=dtype).at[:9].set(jnp.concatenate([A, -h * B], axis=1))
        moved = B * (h * white + h**3 / 3.0 * walk)[None, :] @ B.T
        cross = -0.5 * h * h * B * walk[None, :]
        P = F @ P @ F.T + jnp.block([[moved, cross], [cross.T, jnp.diag(h * walk)]])
        new = (T + h, after, 0.5 * (P + P.T), A @ J - h * B)
        return (new, i, jax.tree.map(lambda a, b: a.at[i].set(b), results, new)), None

    results = jax.tree.map(lambda a: jnp.zeros((count, *a.shape), dtype), start)
    (_, _, results), _ = jax.lax.scan(advance, (start, jnp.asarray(-1, jnp.int32), results), rows)
    return results


def _step(motion: dict[str, jax.Array], reading: jax.Array, h: jax.Array) -> tuple[Any, jax.Array, jax.Array]:
    """The motion after a reading [w; a] that is held for h, and its slopes by motion (9, 9) and h [w; a] (9, 6)."""

    def after(z: jax.Array) -> dict[str, jax.Array]:
        before, moved = _MOTION.retract(motion, z[:9]), h * reading + z[9:]
        R, v, p = before["R"], before["v"], before["p"]
        turn, force = moved[:3], moved[3:]
        W, square = hat(turn), turn @ turn
        once, twice = multiply(W, force), multiply(W, multiply(W, force))
        dv = force + stumpff(2, square) * once + stumpff(3, square) * twice
        dp = 0.5 * force + stumpff(3, square) * once + stumpff(4, square) * twice
        return {"R": multiply(R, exp(turn)), "v": v + multiply(R, dv), "p": p + v * h + multiply(R, dp) * h}

    zero = jnp.zeros(15, reading.dtype)
    end = after(zero)
    _, slopes = value_and_jacobian(lambda z: _MOTION.difference(end, after(z)), zero)
    return end, slopes[:, :9], slopes[:, 9:]


def _inertial(motion: dict[str, jax.Array]) -> InertialState:
    return InertialState(motion["R"], motion["v"], motion["p"])


def _density(name: str, value: Any) -> np.ndarray:
    density = reals(f"Preintegration: {name}", value, ModelError).astype(float)
    if density.shape not in ((), (3,)) or not np.isfinite(density).all() or (density < 0.0).any():
        raise ModelError(f"Preintegration: {name} expects a density that is not negative, or three, got {value!r}")
    return np.broadcast_to(density, (3,))
