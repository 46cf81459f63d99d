"""The initial state of a vehicle from its position, its velocity over the ground and its attitude."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import callable_with, real_array, short
from ...errors import InputError, ModelError
from ...expr import (
    Concat,
    Constant,
    Cross,
    Expr,
    Inputs,
    Leaf,
    Parameter,
    canonicalize_all,
    evaluate_all,
    substitute,
    to_expr,
)
from ...expr.fields import ExprLike
from ...expr.lie import EulerRotation, Pose
from ...jax_inside import is_traced
from ...progress import watching
from ...units import Quantity, metres, radians, same_unit, seconds, taken
from ..arguments import of_kind
from ..environment.earth import north_east_down
from .planets import EARTH, REFERENCE_TAKES, Planet, Reference, fixed_axes

__all__ = ["numbers", "start"]


def numbers(expression: ExprLike, values: Mapping[Leaf, Any] | None = None) -> np.ndarray:
    """The numerical value of an expression, in double precision, without compilation.

    `numbers(EARTH.local_pose(0.6, 0.1, 9e3))` is a pose as an array.

    Args:
        values: values of the leaves that it depends on: states, controls, parameters and time.
    Raises: ModelError if a leaf has no value, or the result is not finite.
    """
    for leaf in values or {}:
        if not isinstance(leaf, Leaf):
            raise ModelError(f"numbers expects values by leaf, such as {{vehicle.pose: ...}}, got {short(leaf)}")
    known = {leaf.key(): Constant(value) for leaf, value in (values or {}).items()}
    return _folded(substitute(to_expr(expression), known))[0]


def _folded(*expressions: Expr) -> list[np.ndarray]:
    """The numbers that expressions of numbers evaluate to; common subexpressions are computed once. Raises ModelError
    if a leaf has no value.
    """
    folded = canonicalize_all(expressions)
    for expr in folded:
        if not isinstance(expr, Constant):
            raise ModelError(
                f"numbers expects an expression with finite numbers at these values, got {short(expr)}.\n"
                "  fix: pass a value for each of its states, controls and parameters"
            )
    return [np.array(expr.value, float) for expr in folded if isinstance(expr, Constant)]


@watching("start")
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
) -> dict[str, Any]:
    """The state of a vehicle from geodetic position, velocity over the ground and attitude: its pose in inertial axes
    and its body twist relative to them, in double precision.

    Numbers have a unit of `tx.units`, or are in m, s and rad. Values may be traced by JAX, for example in a Monte Carlo
    simulation over initial states. Then the state is traced too, in JAX's precision; angles are not checked, and a rate
    relative to undefined axes is NaN.

    At a pole, north-east-down axes are those of the meridian of `longitude`. Their rate is infinite there, so an
    angular rate relative to `local_axes` is not defined.

    Args:
        latitude, longitude: geodetic coordinates.
        altitude: height above the ellipsoid.
        ned_velocity: velocity relative to the rotating planet, in north, east and down components.
        euler: roll, pitch and yaw of the body relative to north-east-down: rotations about z, y and x, in this order:
            yaw, pitch, roll.
        rate: angular rate in body axes.
        relative_to: the reference axes of `rate`: `fixed_axes` (zero for a body at rest on the planet), `local_axes`
            (zero in steady flight), or `inertial_axes`.
        planet: the planet.
        t: the time, which determines the rotation of the planet.
        pose, twist: names of the states.
    Raises:
        InputError: a value with another unit, shape or type; a latitude beyond a pole; an angle of more than a turn;
            reference axes without a finite rate at this position, such as local axes at a pole.
    """
    of_kind("start", "planet", planet, Planet)
    callable_with("start: relative_to", relative_to, REFERENCE_TAKES, ModelError)
    arguments = {
        "latitude": _angle("latitude", latitude, 0.25),
        "longitude": _angle("longitude", longitude, 1.0),
        "altitude": _taken("altitude", altitude, metres),
        "ned_velocity": _taken("ned_velocity", ned_velocity, metres / seconds, (3,)),
        "euler": _angle("euler", euler, 1.0, (3,)),
        "rate": _taken("rate", rate, radians / seconds, (3,)),
        "t": _taken("t", t, seconds),
    }
    traced = is_traced(arguments)
    leaves: dict[str, Any] = {k: Parameter(k, np.shape(v)) if traced else Constant(v) for k, v in arguments.items()}
    north, east, up, over_ground = (leaves[name] for name in ("latitude", "longitude", "altitude", "ned_velocity"))
    turn = planet.figure.to_inertial(leaves["t"])
    local, attitude = turn @ north_east_down(north, east), EulerRotation(leaves["euler"])
    position = turn @ planet.figure.position(north, east, up)
    carried = Cross([0.0, 0.0, planet.figure.rate], position)
    velocity = attitude.T @ (over_ground + local.T @ carried)
    spin = relative_to(planet, north, up, over_ground)
    if not traced:
        _need_rate(relative_to, spin, arguments["latitude"])
    turning = leaves["rate"] + attitude.T @ spin
    state: dict[str, Expr] = {pose: Pose(local @ attitude, position), twist: Concat(velocity, turning)}
    if not traced:
        return dict(zip(state, _folded(*state.values()), strict=True))
    dtype = jax.dtypes.canonicalize_dtype(np.float64)
    inputs = Inputs(0.0, {}, {}, {name: jnp.asarray(value, dtype) for name, value in arguments.items()}, dtype)
    return dict(zip(state, evaluate_all([*state.values()], lambda leaf: leaf.read(inputs)), strict=True))


def _need_rate(relative_to: Reference, spin: ExprLike, latitude: Any) -> None:
    """Raise InputError for reference axes without a finite rate."""
    if isinstance(to_expr(spin).canonicalize(), Constant):
        return
    name = getattr(relative_to, "__name__", relative_to)
    raise InputError(
        f"start: relative_to={name} expects axes that turn at a finite rate; at a latitude of {float(latitude)!r} rad "
        "these have none: at a pole there is no north.\n"
        "  fix: pass the rate relative to flight.fixed_axes or flight.inertial_axes, or start away from the pole"
    )


def _taken(name: str, value: Any, unit: Quantity, shape: tuple[int, ...] = ()) -> Any:
    place = f"start: {name}"
    if not is_traced(value):
        return taken(place, value, unit, shape)
    same_unit(place, value, unit)
    array = real_array(place, value)
    if array.shape != shape:
        raise InputError(f"{place} expects shape {shape}, got {array.shape}")
    return array


def _angle(name: str, value: Any, turns: float, shape: tuple[int, ...] = ()) -> Any:
    angles = _taken(name, value, radians, shape)
    if is_traced(angles):
        return angles
    for i, angle in enumerate(np.ravel(angles)):
        if abs(angle) > 2.0 * np.pi * turns * (1.0 + 1e-15):
            place = f"{name}[{i}]" if shape else name
            raise InputError(
                f"start: {place} expects an angle within {turns:g} of a turn, got {float(angle)!r} rad.\n"
                f"  fix: write degrees as {angle:g} * tx.units.degrees"
            )
    return angles
