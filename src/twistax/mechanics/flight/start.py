"""The state of a body from what people say of it: where it is, how it moves over the ground, how it is turned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...checks import callable_with, short
from ...errors import InputError, ModelError
from ...expr import Constant, Leaf, canonicalize_all, substitute, to_expr
from ...expr.fields import ExprLike
from ...expr.lie import EulerRotation
from ...units import Quantity, metres, radians, seconds, taken
from ..arguments import matrix, of_kind
from ..environment.earth import north_east_down
from .planets import EARTH, REFERENCE_TAKES, Planet, Reference, fixed_axes

__all__ = ["numbers", "start"]


def numbers(expression: ExprLike, values: Mapping[Leaf, Any] | None = None) -> np.ndarray:
    """The numbers that an expression amounts to, in double precision and without compiling.

    `numbers(EARTH.local_pose(0.6, 0.1, 9e3))` is a pose as numbers, by the function that makes it an expression.

    Args:
        values: of the leaves it depends on: states, controls, parameters, the time.
    Raises: ModelError where a leaf is left, or the result is not finite.
    """
    for leaf in values or {}:
        if not isinstance(leaf, Leaf):
            raise ModelError(f"numbers expects values by leaf, such as {{vehicle.pose: ...}}, got {short(leaf)}")
    known = {leaf.key(): Constant(value) for leaf, value in (values or {}).items()}
    (found,) = canonicalize_all([substitute(to_expr(expression), known)])
    if not isinstance(found, Constant):
        raise ModelError(
            f"numbers expects an expression with finite numbers at the values given, got {short(found)}.\n"
            "  fix: give a value for each of its states, controls and parameters"
        )
    return np.array(found.value, float)


def start(
    latitude: Any,
    longitude: Any,
    altitude: Any,
    ned_velocity: Any = (0.0, 0.0, 0.0),
    euler: Any = (0.0, 0.0, 0.0),
    rate: Any = (0.0, 0.0, 0.0),
    *,
    relative_to: Reference = fixed_axes,
    planet: Planet = EARTH,
    t: Any = 0.0,
    pose: str = "g",
    twist: str = "V",
) -> dict[str, np.ndarray]:
    """The state at a place: its pose in inertial axes and its body twist relative to them, in double precision.

    A number has a unit of `tx.units`, or is in m, s and rad.

    Args:
        latitude, longitude: geodetic.
        altitude: above the ellipsoid.
        ned_velocity: relative to the turning planet, north, east and down.
        euler: roll, pitch and yaw of the body relative to north-east-down, turned about z, y and x in this order.
        rate: about body axes.
        relative_to: what the rate is relative to: `fixed_axes`, so that it stands still on the planet if it is zero,
            `local_axes`, as of a steady flight, or `inertial_axes`.
        planet: where it is.
        t: the time, which turns the planet.
        pose, twist: names of the states.
    Raises:
        InputError: another unit, shape or kind; a latitude beyond a pole; an angle of more than a turn.
    """
    of_kind("start", "planet", planet, Planet)
    callable_with("start: relative_to", relative_to, REFERENCE_TAKES, ModelError)
    place = [
        _angle("latitude", latitude, 0.25),
        _angle("longitude", longitude, 1.0),
        float(taken("start: altitude", altitude, metres)),
    ]
    angles = [_angle(f"euler[{i}]", angle, 1.0) for i, angle in enumerate(_three("euler", euler, radians))]
    over_ground = _three("ned_velocity", ned_velocity, metres / seconds)
    turning = _three("rate", rate, radians / seconds)
    turn = numbers(planet.figure.to_inertial(float(taken("start: t", t, seconds))))
    local = turn @ numbers(north_east_down(*place[:2]))
    attitude = numbers(EulerRotation(angles))
    position = turn @ numbers(planet.figure.position(*place))
    spin = numbers(relative_to(planet, place[0], place[2], over_ground))
    velocity = attitude.T @ (over_ground + local.T @ np.cross([0.0, 0.0, planet.figure.rate], position))
    return {pose: matrix(local @ attitude, position), twist: np.concatenate([velocity, turning + attitude.T @ spin])}


def _three(name: str, value: Any, unit: Quantity) -> np.ndarray:
    return taken(f"start: {name}", value, unit, (3,))


def _angle(name: str, value: Any, turns: float) -> float:
    angle = float(taken(f"start: {name}", value, radians))
    if abs(angle) > 2.0 * np.pi * turns * (1.0 + 1e-15):
        raise InputError(
            f"start: {name} expects an angle within {turns:g} of a turn, got {angle!r} rad.\n"
            f"  fix: degrees are {angle:g} * tx.units.degrees"
        )
    return angle
