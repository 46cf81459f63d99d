"""A rigid body in flight over a planet: its pose and twist, and the quantities that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from ...checks import callable_with, listed
from ...errors import ModelError
from ...expr import Concat, Expr, Norm, State, Time, Where, to_expr
from ...expr.fields import ExprLike
from ...expr.kinds import kinds
from ...expr.kinds.declare import known_as
from ...expr.kinds.unit import METRE, ONE, SECOND
from ...expr.lie import EulerAngles, angular, linear
from ...groups import SE3
from ...system import System
from ..arguments import of_kind, of_shape
from ..bodies import SpatialInertia
from ..environment.earth import Geodetic, north_east_down
from ..environment.gravity import gradient_torque
from .air_data import AirData
from .planets import EARTH, REFERENCE_TAKES, Planet, Reference, inertial_axes
from .start import start
from .turbulence import Dryden, Gust
from .wind import CALM, Wind

__all__ = ["Vehicle"]

#: Names of frames for leaves with declared kinds: inertial axes; planet-fixed axes; north, east, down; body axes.
INERTIAL, FIXED, LOCAL, BODY = "inertial", "fixed", "ned", "body"
_SPEED, _RATE = METRE / SECOND, ONE / SECOND


class Vehicle:
    """A rigid body in flight over a planet. Its states are the pose g in inertial axes and the body twist V.

    The properties are expressions that are built when first read, so unused ones have no cost. Angles are in rad. The
    longitude of `place` is the geographic one.

    On the axis of the planet there is no north direction: `attitude`, `euler`, `ned_velocity` and a wind are NaN there,
    and at a pole also `rate(local_axes)`.

    In a system with declared kinds (`tx.kinds`), its frames are named "inertial", "fixed" (to the planet), "ned" and
    "body".

    Args:
        planet: ellipsoid, rotation, gravity and atmosphere.
        wind: velocity of the air relative to the planet, as a function of (place, t).
        turbulence: gusts in addition to the wind; their state and noise become part of `system`.
        pose, twist: names of the states.
    Raises:
        ModelError: planet is not a `Planet`, turbulence is not a `Dryden`, or wind is not a function of (place, t).
    """

    def __init__(
        self,
        planet: Planet = EARTH,
        wind: Wind = CALM,
        turbulence: Dryden | None = None,
        *,
        pose: str = "g",
        twist: str = "V",
    ) -> None:
        of_kind("Vehicle", "planet", planet, Planet)
        if not callable(wind):
            raise ModelError(
                f"Vehicle expects wind to be a function of (place, t), got {wind!r}.\n"
                "  fix: for a constant wind use flight.Steady((north, east, down))"
            )
        callable_with("Vehicle: wind", wind, ("place", "t"), ModelError)
        if turbulence is not None:
            of_kind("Vehicle", "turbulence", turbulence, Dryden)
        self.planet, self.wind, self.turbulence = planet, wind, turbulence
        self.pose = known_as(State(pose, group=SE3), kinds.Pose(INERTIAL, BODY))
        self.twist = known_as(State(twist, shape=(6,)), kinds.Twist(BODY))
        self.time = Time()

    # ---- place and attitude --------------------------------------------------------------------------------------

    @property
    def position(self) -> Expr:
        """The position (3,) in inertial axes, m."""
        return self.pose[:3, 3]

    @cached_property
    def velocity(self) -> Expr:
        """The velocity (3,) relative to inertial axes, in inertial axes, m/s."""
        return known_as(self.pose[:3, :3] @ linear(self.twist), kinds.FreeVector(INERTIAL), _SPEED)

    @cached_property
    def fixed_position(self) -> Expr:
        """The position (3,) in planet-fixed axes, m."""
        return known_as(self._turn.T @ self.position, kinds.Point(FIXED))

    @cached_property
    def place(self) -> Geodetic:
        """Geodetic latitude, longitude and altitude."""
        return Geodetic(
            self._over.latitude, self.planet.figure.geodetic(self.fixed_position).longitude, self._over.altitude
        )

    @cached_property
    def attitude(self) -> Expr:
        """The rotation (3, 3) from body axes to north, east, down."""
        return known_as(self._local.T @ self.pose[:3, :3], kinds.Rotation(LOCAL, BODY))

    @cached_property
    def euler(self) -> Expr:
        """Roll, pitch and yaw (3,) of the attitude, rad. If the pitch is +-90 degrees, roll is set to 0."""
        return EulerAngles(self.attitude)

    @cached_property
    def ned_velocity(self) -> Expr:
        """The velocity (3,) relative to the planet, in north-east-down axes, m/s."""
        return known_as(self._local.T @ self._ground_velocity, kinds.FreeVector(LOCAL), _SPEED)

    def rate(self, relative_to: Reference = inertial_axes) -> Expr:
        """The body's rate (3,) in body axes, rad/s, relative to `inertial_axes`, `fixed_axes` or `local_axes`."""
        w = angular(self.twist)
        if relative_to is inertial_axes:
            return w
        callable_with("Vehicle.rate: relative_to", relative_to, REFERENCE_TAKES, ModelError)
        spin = relative_to(self.planet, self._over.latitude, self._over.altitude, self.ned_velocity)
        return w - self.attitude.T @ known_as(to_expr(spin), kinds.FreeVector(LOCAL), _RATE)

    # ---- air and gravity -----------------------------------------------------------------------------------------

    @cached_property
    def air(self) -> AirData:
        """The air data. Rates relative to the air are relative to the rotating planet and to gusts."""
        turning = Concat(0.0, 0.0, self.planet.figure.rate)
        velocity, rate = self._steady_air_velocity, angular(self.twist) - self.pose[:3, :3].T @ turning
        if self._gust is not None:
            velocity, rate = velocity - self._gust.velocity, rate - self._gust.rate
        velocity = known_as(velocity, kinds.FreeVector(BODY), _SPEED)
        return AirData(velocity, self._over.altitude, self.planet.air, known_as(rate, kinds.FreeVector(BODY), _RATE))

    @cached_property
    def gravitation(self) -> Expr:
        """Gravitational acceleration at the body's origin, (3,) in inertial axes, m/s2."""
        pull = self.planet.gravitation(self.position, self.time)
        return known_as(pull, kinds.FreeVector(INERTIAL), _SPEED / SECOND)

    def gradient_torque(self, body: SpatialInertia) -> Expr:
        """The gravity-gradient torque on a body about its centre of mass, (3,) in body axes, N m."""
        of_kind("Vehicle", "body", body, SpatialInertia)
        at_center = self.pose[:3, :3].T @ self.position + body.center_of_mass
        return gradient_torque(self.planet.gravity.gm, at_center, body.inertia)

    # ---- a system ------------------------------------------------------------------------------------------------

    def acceleration(self, body: SpatialInertia, wrench: ExprLike = (0.0,) * 6) -> Expr:
        """The rate V' (6,) of the twist of a body under gravity and a wrench.

        Args:
            body: instantaneous mass, centre of mass and inertia in body axes. The effect of masses that move in the
                body is included. The effect of mass that leaves the body belongs to `wrench`, see `SpatialInertia`.
            wrench: [f; tau] (6,) of all forces except gravity, at the body's origin in its axes.
        Raises:
            ModelError: body is not a SpatialInertia.
            ShapeError: wrench is not of shape (6,).
        """
        of_kind("Vehicle", "body", body, SpatialInertia)
        applied = known_as(of_shape("Vehicle", "wrench", wrench, (6,)), kinds.Wrench(BODY))
        F = applied + body.weight(self.pose, self.gravitation)
        return body.acceleration(self.twist, F)

    def system(
        self,
        body: SpatialInertia,
        wrench: ExprLike = (0.0,) * 6,
        *,
        rates: Mapping[State | str, ExprLike] | None = None,
        outputs: Mapping[str, ExprLike] | None = None,
        **more: Any,
    ) -> System:
        """The system of the body's motion under gravity and a wrench, and of the turbulence.

        Args:
            body, wrench: as for `acceleration`.
            rates: rates of additional states; masses of the body that depend on these states move at these rates.
            outputs: additional outputs, besides those of the method `outputs`.
            more: further arguments of `System`.
        Raises: ModelError, ShapeError, as for `acceleration`; ModelError for a rate of the vehicle's own states, or an
            output whose name is in use.
        """
        of_kind("Vehicle", "body", body, SpatialInertia)
        motion: dict[State | str, ExprLike] = {
            self.pose: self.twist,
            self.twist: self.acceleration(body.with_rates(rates or {}), wrench),
        }
        if self.turbulence is not None and self._gust is not None:
            motion[self.turbulence.state] = self._gust.state_rate
        named = {state if isinstance(state, str) else state.name for state in rates or {}}
        motion_states = [name for name in (getattr(state, "name", state) for state in motion) if name in named]
        if motion_states:
            raise ModelError(
                f"Vehicle.system expects rates of additional states, got {listed(motion_states)}, whose "
                "rates the vehicle determines.\n  fix: add forces and torques to wrench, or write a "
                "System of vehicle.acceleration(body, wrench)"
            )
        ready = self.outputs()
        twice = [name for name in outputs or {} if name in ready]
        if twice:
            raise ModelError(
                f"Vehicle.system expects additional outputs, got {listed(twice)}, which are outputs of every vehicle.\n"
                "  fix: give it another name, or write a System of vehicle.acceleration(body, wrench)"
            )
        return System({**motion, **(rates or {})}, {**ready, **(outputs or {})}, **more)

    def outputs(self) -> dict[str, Expr]:
        """The standard outputs for comparisons of flights.

        position, velocity (inertial), fixed_position (3,); latitude, longitude, altitude (); ned_velocity (3,);
        attitude (3, 3), from body to north-east-down; euler (3,), its roll, pitch and yaw; rate (3,), relative to
        inertial axes; airspeed, density ().
        """
        return {
            "position": self.position,
            "velocity": self.velocity,
            "fixed_position": self.fixed_position,
            "latitude": self.place.latitude,
            "longitude": self.place.longitude,
            "altitude": self.place.altitude,
            "ned_velocity": self.ned_velocity,
            "attitude": self.attitude,
            "euler": self.euler,
            "rate": self.rate(),
            "airspeed": self.air.airspeed,
            "density": self.air.density,
        }

    def start(self, *place: Any, **motion: Any) -> dict[str, Any]:
        """`flight.start` on this planet, with the names of this vehicle's states."""
        return start(*place, **motion, planet=self.planet, pose=self.pose.name, twist=self.twist.name)

    # ---- shared parts --------------------------------------------------------------------------------------------

    @cached_property
    def _turn(self) -> Expr:
        return known_as(self.planet.figure.to_inertial(self.time), kinds.Rotation(INERTIAL, FIXED))

    @cached_property
    def _over(self) -> Geodetic:
        """The geodetic position with the longitude from the inertial x axis, which does not need the rotation of the
        planet.
        """
        return self.planet.figure.geodetic(self.position)

    @cached_property
    def _local(self) -> Expr:
        """The rotation from north-east-down to inertial axes; NaN on the axis of the planet, which has no north
        direction.
        """
        off_axis = Where(Norm(self.position[:2]) > 0.0, 1.0, np.nan)
        axes = north_east_down(self._over.latitude, self._over.longitude * off_axis)
        return known_as(axes, kinds.Rotation(INERTIAL, LOCAL))

    @cached_property
    def _ground_velocity(self) -> Expr:
        """The velocity relative to the planet, in inertial axes."""
        return self.planet.figure.air_velocity(self.position, self.velocity)

    @cached_property
    def _steady_air_velocity(self) -> Expr:
        """The velocity relative to the wind, in body axes."""
        velocity = self._ground_velocity
        if self.wind is not CALM:
            blown = of_shape("Vehicle", "the wind's velocity", self.wind(self.place, self.time), (3,))
            velocity = velocity - self._local @ known_as(blown, kinds.FreeVector(LOCAL), _SPEED)
        return self.pose[:3, :3].T @ velocity

    @cached_property
    def _gust(self) -> Gust | None:
        if self.turbulence is None:
            return None
        return self.turbulence.gust(self._over.altitude, Norm(self._steady_air_velocity))
