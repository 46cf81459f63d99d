"""Dryden turbulence: filtered white noise, with filter states that are integrated with those of the vehicle.

Source of spectra, scales and intensities: MIL-F-8785C, Flying Qualities of Piloted Airplanes (1980), section 3.7. The
filters here are for noise of unit intensity, E[n(t) n(s)] = delta(t - s). To hold noise constant over dt seconds, use
standard normal numbers divided by sqrt(dt).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

from ...checks import callable_with, short
from ...errors import ModelError
from ...expr import Concat, Control, Expr, Max, Min, Sqrt, State
from ...units import feet, metres, seconds, taken

__all__ = ["Dryden", "Gust", "even_turbulence", "low_altitude_turbulence"]

#: Lengths (L_u, L_v, L_w) in m and intensities (sigma_u, sigma_v, sigma_w) in m/s, as functions of the height above the
#: ground in m.
Scales: TypeAlias = Callable[[Expr], tuple[tuple[Any, Any, Any], tuple[Any, Any, Any]]]


class Gust(NamedTuple):
    """The velocity, m/s, and the angular rate, rad/s, of the air due to turbulence, in body axes; and the `state_rate`
    of the filters.
    """

    velocity: Expr
    rate: Expr
    state_rate: Expr


def even_turbulence(lengths: Any, intensities: Any) -> Scales:
    """Turbulence scales that do not depend on height, as specified above 2000 ft: $L_u = L_v = L_w = 1750$ ft.

    Args:
        lengths: scale lengths (L_u, L_v, L_w), m, positive.
        intensities: (sigma_u, sigma_v, sigma_w), m/s.
    Raises: InputError for a wrong unit or shape; ModelError for a length that is not positive.
    """
    L = tuple(taken("even_turbulence: lengths", lengths, metres, (3,)).tolist())
    if not min(L) > 0.0:
        raise ModelError(f"even_turbulence expects positive lengths in m, got {short(lengths)}")
    sigma = tuple(taken("even_turbulence: intensities", intensities, metres / seconds, (3,)).tolist())
    return lambda height: ((L[0], L[1], L[2]), (sigma[0], sigma[1], sigma[2]))


def low_altitude_turbulence(wind: Any) -> Scales:
    """Turbulence scales between 10 and 1000 ft above the ground, as functions of the wind at 20 ft; constant below and
    above.

    With h in ft: $L_w = h$, $L_u = L_v = h / (0.177 + 0.000823 h)^(1.2)$, $sigma_w = 0.1 u_20$ and
    $sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^(0.4)$.

    Args:
        wind: wind speed u_20 at 20 ft, m/s.
    Raises: InputError for a value of another unit.
    """
    sigma = 0.1 * float(taken("low_altitude_turbulence: wind", wind, metres / seconds))

    def scales(height: Expr) -> tuple[tuple[Any, Any, Any], tuple[Any, Any, Any]]:
        h = Min(Max(height / float(feet), 10.0), 1000.0)
        factor = 0.177 + 0.000823 * h
        length, size = float(feet) * h / factor**1.2, sigma / factor**0.4
        return (length, length, float(feet) * h), (size, size, sigma)

    return scales


@dataclasses.dataclass(frozen=True, eq=False)
class Dryden:
    """Dryden turbulence: gusts in body axes, as a frozen pattern through which the vehicle flies.

    White noise passes through filters. The filter state (8,) starts at zero; the noise is a control (4,). The rates of
    the air follow from the gradients of its velocity: $q = -dw/dx$ and $r = dv/dx$, filtered by the span.

    Attributes:
        scales: `low_altitude_turbulence(...)`, `even_turbulence(...)`, or a function of the height.
        span: wing span b, m.
        ground: altitude of the ground, m.
        name: name of the state; the name of the control is derived from it.
    Raises: InputError for a wrong unit; ModelError for a span that is not positive.
    """

    scales: Scales
    span: float
    ground: float = 0.0
    name: str = "turbulence"

    def __post_init__(self) -> None:
        callable_with("Dryden: scales", self.scales, ("height",), ModelError)
        for name in ("span", "ground"):
            object.__setattr__(self, name, float(taken(f"Dryden: {name}", getattr(self, name), metres)))
        if not self.span > 0.0:
            raise ModelError(f"Dryden expects a positive span in m, got {self.span!r}")

    @property
    def state(self) -> State:
        """Filter states (8,), m/s and rad/s."""
        return State(self.name, shape=(8,))

    @property
    def noise(self) -> Control:
        """White noise of unit intensity (4,), for u, v, w and p."""
        return Control(f"{self.name}_noise", shape=(4,))

    def gust(self, altitude: Expr, airspeed: Expr) -> Gust:
        """Velocity (3,) and rate (3,) of the air in body axes, and the rate of the state.

        Args:
            altitude: (), m.
            airspeed: airspeed V without the gust, (), m/s; positive.
        """
        x, n = self.state, self.noise
        lengths, (sigma_u, sigma_v, sigma_w) = self.scales(altitude - self.ground)
        T_u, T_v, T_w = (L / airspeed for L in lengths)
        T_q, T_r = 4.0 * self.span / (math.pi * airspeed), 3.0 * self.span / (math.pi * airspeed)
        v = x[2] + math.sqrt(3.0) * (x[1] - x[2])
        w = x[4] + math.sqrt(3.0) * (x[3] - x[4])
        roll = (math.pi / (4.0 * self.span)) ** (1.0 / 6.0) * sigma_w / lengths[2] ** (1.0 / 3.0)
        q, r = (w - x[6]) / T_q, (v - x[7]) / T_r
        state_rate = Concat(
            sigma_u * Sqrt(2.0 / T_u) * n[0] - x[0] / T_u,
            sigma_v / Sqrt(T_v) * n[1] - x[1] / T_v,
            (x[1] - x[2]) / T_v,
            sigma_w / Sqrt(T_w) * n[2] - x[3] / T_w,
            (x[3] - x[4]) / T_w,
            (roll * Sqrt(0.8 * math.pi / airspeed) * n[3] - x[5]) / T_q,
            q,
            r,
        )
        return Gust(Concat(x[0], v, w), Concat(x[5], -q / airspeed, r / airspeed), state_rate)
