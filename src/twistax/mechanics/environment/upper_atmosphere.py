"""The US Standard Atmosphere 1976 up to 1000 km: layers to 86 km, diffusive equilibrium above as a table."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from ...expr import Cinterp, Exp, Expr, Max, Min, Sqrt, Where, to_expr
from ...expr.fields import ExprLike
from .atmosphere import US1976, LayeredAtmosphere

__all__ = ["US1976_TO_1000_KM", "UpperAtmosphere"]


@dataclasses.dataclass(frozen=True, eq=False)
class UpperAtmosphere:
    """An atmosphere of layers, and above them a table of temperature, pressure and density by altitude.

    Cubic splines of the temperature and of the logarithms. Above the last altitude the last values hold.

    Attributes:
        below: up to the first altitude of the table.
        table: rows of geometric altitude, km, temperature, K, ln(p / Pa), ln(rho / (kg/m3)).
    """

    below: LayeredAtmosphere
    table: Any

    def temperature(self, altitude: ExprLike) -> Expr:
        """Kinetic temperature in K at geometric altitudes in m; below the table that of the layers."""
        return self._joined(altitude, self.below.temperature(altitude), 1)

    def pressure(self, altitude: ExprLike) -> Expr:
        """Pressure in Pa at geometric altitudes in m."""
        return self._joined(altitude, self.below.pressure(altitude), 2)

    def density(self, altitude: ExprLike) -> Expr:
        """Density in kg/m3 at geometric altitudes in m."""
        return self._joined(altitude, self.below.density(altitude), 3)

    def speed_of_sound(self, altitude: ExprLike) -> Expr:
        """$sqrt(gamma p / rho)$ in m/s at geometric altitudes in m; the standard has none above 86 km."""
        return Sqrt(self.below.heat_ratio * self.pressure(altitude) / self.density(altitude))

    def _joined(self, altitude: ExprLike, low: Expr, column: int) -> Expr:
        z, rows = to_expr(altitude), np.asarray(self.table)
        bottom, top = 1e3 * rows[0, 0], 1e3 * rows[-1, 0]
        high = Cinterp(1e-3 * Min(Max(z, bottom), top), rows[:, 0], rows[:, column])
        return Where(z <= bottom, low, high if column == 1 else Exp(high))


#: Within 5e-4 of what the standard's equations give for pressure and density, and 0.1 K. The standard's printed tables
#: differ from these by 1e-3 of the pressure above 700 km. The table has the kinetic temperature: it starts 0.08 K below
#: the molecular-scale temperature of the layers.
#: Source: U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562.
US1976_TO_1000_KM = UpperAtmosphere(
    US1976, json.loads(Path(__file__).with_name("us1976_upper.json").read_text())["rows"]
)
