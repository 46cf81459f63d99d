"""The US Standard Atmosphere 1976 up to 1000 km, and its gases in diffusive equilibrium above.

It has layers up to 86 km. From there to 1000 km, a table contains the solution of the standard's equations of diffusive
equilibrium.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import operator
from pathlib import Path
from typing import Any

import numpy as np

from ...checks import reals
from ...errors import ModelError
from ...expr import Cinterp, Exp, Expr, Max, Min, Sqrt, Where, to_expr
from ...expr.fields import ExprLike
from .atmosphere import US1976, LayeredAtmosphere

__all__ = ["US1976_TO_1000_KM", "UpperAtmosphere"]


@dataclasses.dataclass(frozen=True, eq=False)
class UpperAtmosphere:
    """An atmosphere up to any altitude: layers, then a table over altitude, then gases in diffusive equilibrium.

    The table is interpolated by cubic splines of the temperature and of the logarithms of pressure and density. Above
    its last altitude $z_1$ the temperature T is constant, and each gas has its own scale height under gravity that
    falls with the square of the distance: $n_i = n_i1 exp(-g_0 M_i (H - H_1) / (R_u T))$, $H = r z / (r + z)$. Pressure
    is the sum of $n_i$ and density the sum of $M_i n_i$, both scaled so that they continue the table. Light gases
    dominate at high altitude. Gravity, radius and gas constant are those of `below`.

    Attributes:
        below: the layers, used up to the first altitude of the table.
        table: rows of geometric altitude, km, temperature, K, ln(p / Pa), ln(rho / (kg/m3)).
        gases: molar mass, kg/kmol, and number density of each gas at the last altitude; number densities may be in any
            common unit. By default a single gas with the mean molar mass there.
    Raises:
        ModelError: gases that are not pairs of positive numbers.
    Source: U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562, equation (36) without eddy and thermal diffusion and flow,
    for gases above 500 km.
    """

    below: LayeredAtmosphere
    table: Any
    gases: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        pairs = reals("UpperAtmosphere: gases", self.gases, ModelError)
        if pairs.size and not (pairs.ndim == 2 and pairs.shape[1] == 2 and (pairs > 0.0).all()):
            raise ModelError(
                "UpperAtmosphere expects gases as pairs of a molar mass and a number density, both positive, "
                f"got {self.gases}"
            )

    def temperature(self, altitude: ExprLike) -> Expr:
        """Kinetic temperature in K at geometric altitudes in m; below the table, the temperature of the layers."""
        return self._joined(altitude, self.below.temperature(altitude), 1)

    def pressure(self, altitude: ExprLike) -> Expr:
        """Pressure in Pa at geometric altitudes in m."""
        return self._joined(altitude, self.below.pressure(altitude), 2)

    def density(self, altitude: ExprLike) -> Expr:
        """Density in kg/m3 at geometric altitudes in m."""
        return self._joined(altitude, self.below.density(altitude), 3)

    def speed_of_sound(self, altitude: ExprLike) -> Expr:
        """Speed of sound $sqrt(gamma p / rho)$ in m/s at geometric altitudes in m; the standard defines none above 86
        km.
        """
        return Sqrt(self.below.heat_ratio * self.pressure(altitude) / self.density(altitude))

    def _joined(self, altitude: ExprLike, low: Expr, column: int) -> Expr:
        z, rows = to_expr(altitude), np.asarray(self.table)
        bottom, top = 1e3 * rows[0, 0], 1e3 * rows[-1, 0]
        high: Expr = Cinterp(1e-3 * Min(Max(z, bottom), top), rows[:, 0], rows[:, column])
        if column > 1:
            high = Exp(high) * self._left(Max(z, top), top, by_mass=column == 3)
        return Where(z <= bottom, low, high)

    def _left(self, z: Expr, top: float, by_mass: bool) -> Expr:
        """The ratio of pressure or density to its value at the last altitude of the table, at altitudes above it."""
        air = self.below
        temperature, log_pressure, log_density = np.asarray(self.table)[-1, 1:]
        mean = np.exp(log_density - log_pressure) * air.gas_constant * temperature
        masses, numbers = np.array(self.gases or ((mean, 1.0),)).T
        shares = numbers * masses if by_mass else numbers
        climb = (z - top) / ((1.0 + z / air.radius) * (1.0 + top / air.radius))
        falls = air.gravity * masses / (air.gas_constant * temperature)
        parts = [share * Exp(-fall * climb) for share, fall in zip((shares / shares.sum()).tolist(), falls.tolist())]
        return functools.reduce(operator.add, parts)


_UPPER = json.loads(Path(__file__).with_name("us1976_upper.json").read_text())

#: Pressure and density differ from the solution of the standard's equations by at most 5e-4, the temperature by 0.1 K.
#: The standard's printed tables differ from these equations by 1e-3 of the pressure above 700 km. The table has the
#: kinetic temperature: it starts 0.08 K below the molecular-scale temperature of the layers. Above 1000 km, where the
#: standard ends, atomic oxygen, helium and hydrogen are in diffusive equilibrium at 1000 K, from their number densities
#: at 1000 km. Source: U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562.
US1976_TO_1000_KM = UpperAtmosphere(US1976, _UPPER["rows"], tuple(map(tuple, _UPPER["gases"].values())))
