"""Measurements of instruments in a vehicle. Biases may be numbers, Parameters, or states that are driven by noise."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ...expr import Cross, Expr
from ...expr.fields import ExprLike
from ...expr.lie import angular, linear
from ...expr.lie.base import check_element
from ...units import metres, radians, seconds
from ..arguments import of_kind, of_shape
from .air_data import AirData

__all__ = ["Imu", "ImuReading", "probe"]


class ImuReading(NamedTuple):
    """The measured quantities of an IMU, in its axes: the specific_force (3,), m/s2, and the rate relative to inertial
    axes (3,), rad/s.
    """

    specific_force: Expr
    rate: Expr


@dataclasses.dataclass(frozen=True, eq=False)
class Imu:
    """An inertial measurement unit: three accelerometers and three gyroscopes at one point of a body.

    Attributes:
        position: position (3,) in body axes, m.
        mounting: the rotation (3, 3) from the sensor's axes to body axes.
        accelerometer_bias: (3,), m/s2, and gyro_bias: (3,), rad/s, in the sensor's axes.
    Raises: ShapeError for values of the wrong shape; ModelError for values that are not numbers or expressions.
    """

    position: ExprLike = (0.0, 0.0, 0.0)
    mounting: ExprLike = dataclasses.field(default_factory=lambda: np.eye(3))
    accelerometer_bias: ExprLike = (0.0, 0.0, 0.0)
    gyro_bias: ExprLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        parts = {
            "position": ((3,), metres),
            "mounting": ((3, 3), None),
            "accelerometer_bias": ((3,), metres / seconds**2),
            "gyro_bias": ((3,), radians / seconds),
        }
        for name, (shape, unit) in parts.items():
            object.__setattr__(self, name, of_shape("Imu", name, getattr(self, name), shape, unit=unit))
        check_element("Imu", "mounting", of_shape("Imu", "mounting", self.mounting, (3, 3)))

    def read(self, V: ExprLike, acceleration: ExprLike, gravitation: ExprLike) -> ImuReading:
        """The specific force $v' + w x v + w' x r + w x (w x r) - a_g$ and the rate w, both in the sensor's axes and
        with biases.
        """
        twist, rate = of_shape("Imu", "V", V, (6,)), of_shape("Imu", "acceleration", acceleration, (6,))
        pull = of_shape("Imu", "gravitation", gravitation, (3,))
        w, r = angular(twist), of_shape("Imu", "position", self.position, (3,))
        origin = linear(rate) + Cross(w, linear(twist)) - pull
        force = origin + Cross(angular(rate), r) + Cross(w, Cross(w, r))
        turn = of_shape("Imu", "mounting", self.mounting, (3, 3)).T
        return ImuReading(turn @ force + self.accelerometer_bias, turn @ w + self.gyro_bias)


def probe(air: AirData, position: ExprLike) -> AirData:
    """The air data at a position (3,), m, in the body, such as vanes on a boom: the angular rate w of the body adds $w
    x r$ to the velocity.

    Raises: ShapeError.
    """
    of_kind("probe", "air", air, AirData)
    moved = air.velocity + Cross(air.rate, of_shape("probe", "position", position, (3,), unit=metres))
    return AirData(moved, air.altitude, air.air, air.rate)
