"""Winds: velocity of the air relative to the planet, in north-east-down axes in m/s, as a function of place and time.

Any function of (place, t) that returns three expressions is a wind. The winds defined here also check their numbers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from ...checks import short
from ...errors import ModelError
from ...expr import Concat, Constant, Expr, Linterp, Log, Max
from ...units import feet, metres, radians, seconds, taken
from ..environment.earth import Geodetic

__all__ = ["CALM", "LogarithmicShear", "Profile", "Steady", "Wind"]

#: The velocity (3,) of the air relative to the planet, in north-east-down axes, m/s, at a place and a time in s.
Wind: TypeAlias = Callable[[Geodetic, Expr], Any]

_SPEED = metres / seconds
_TWENTY_FEET = float(20.0 * feet)


@dataclasses.dataclass(frozen=True)
class Steady:
    """A wind that is the same everywhere.

    Attributes:
        velocity: in north-east-down axes, m/s. A wind from the west has a positive second entry.
    Raises: InputError for a value that is not a velocity.
    """

    velocity: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", tuple(taken("Steady: velocity", self.velocity, _SPEED, (3,)).tolist()))

    def __call__(self, place: Geodetic, t: Expr) -> Expr:
        return Constant(self.velocity)


#: No wind.
CALM = Steady((0.0, 0.0, 0.0))


@dataclasses.dataclass(frozen=True)
class Profile:
    """A wind that depends on altitude: linear between the altitudes of a table, constant below and above.

    Attributes:
        altitudes: increasing altitudes, m.
        velocities: (n, 3) velocities of the air at these altitudes, in north-east-down axes, m/s.
    Raises: InputError for a wrong unit or shape; ModelError if altitudes do not increase.
    """

    altitudes: Any
    velocities: Any

    def __post_init__(self) -> None:
        for name in ("altitudes", "velocities"):
            if not isinstance(getattr(self, name), (list, tuple, np.ndarray)):
                raise ModelError(f"Profile expects {name} to be a list, got {short(getattr(self, name))}")
        n = len(self.altitudes)
        altitudes = taken("Profile: altitudes", self.altitudes, metres, (n,))
        rows = [taken(f"Profile: velocities[{i}]", row, _SPEED, (3,)) for i, row in enumerate(self.velocities)]
        if n < 2 or len(rows) != n or not (np.diff(altitudes) > 0.0).all():
            raise ModelError(
                "Profile expects two or more altitudes that increase and a velocity at each, "
                f"got {short(self.altitudes)} and {len(rows)} velocities"
            )
        object.__setattr__(self, "altitudes", tuple(altitudes.tolist()))
        object.__setattr__(self, "velocities", tuple(tuple(row.tolist()) for row in rows))

    def __call__(self, place: Geodetic, t: Expr) -> Expr:
        return Linterp(place.altitude, np.array(self.altitudes), np.array(self.velocities))


@dataclasses.dataclass(frozen=True)
class LogarithmicShear:
    """The logarithmic wind profile near the ground: $u(h) = u_20 ln(h / z_0) / ln(h_20 / z_0)$, zero below z_0.

    h_20 is 20 ft. The direction does not depend on height.

    Attributes:
        speed: wind speed u_20 at 20 ft above the ground, m/s.
        towards: the direction to which the wind blows, clockwise from north, rad.
        roughness: roughness length z_0, m: 0.15 ft in terminal flight phases, 2 ft in others.
        ground: altitude of the ground, m.
    Raises: InputError for a wrong unit; ModelError if the roughness is not between 0 and 20 ft.
    Source: MIL-F-8785C, Flying Qualities of Piloted Airplanes (1980), section 3.7.3.3, wind shear.
    """

    speed: float
    towards: float
    roughness: float = float(0.15 * feet)
    ground: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (("speed", _SPEED), ("towards", radians), ("roughness", metres), ("ground", metres)):
            value = float(taken(f"LogarithmicShear: {name}", getattr(self, name), unit))
            object.__setattr__(self, name, value)
        if not 0.0 < self.roughness < _TWENTY_FEET:
            raise ModelError(f"LogarithmicShear expects a roughness between 0 and 20 ft, got {self.roughness!r} m")

    def __call__(self, place: Geodetic, t: Expr) -> Expr:
        height = Max(place.altitude - self.ground, self.roughness)
        size = self.speed * Log(height / self.roughness) / math.log(_TWENTY_FEET / self.roughness)
        return Concat(size * math.cos(self.towards), size * math.sin(self.towards), 0.0)
