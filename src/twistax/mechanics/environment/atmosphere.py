"""Static atmospheres in hydrostatic balance, with layers of constant temperature lapse rate: the US Standard Atmosphere
1976.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jax import Array

from ...checks import reals
from ...errors import ModelError
from ...expr import Expr, Sqrt, to_expr
from ...expr.bases import Entrywise
from ...expr.fields import ExprLike, Operand, positive
from ...expr.kinds.rules import FixedUnits
from ...expr.kinds.unit import KELVIN, METRE, NEWTON

__all__ = ["US1976", "LayeredAtmosphere", "Pressure", "Temperature"]


@dataclasses.dataclass(frozen=True)
class LayeredAtmosphere:
    """An atmosphere defined by its temperature, which is linear in geopotential altitude within each layer.

    With $H = r z / (r + z)$ the geopotential altitude of geometric altitude z, $T = T_i + L_i (H - H_i)$ in layer i and
    $p = p_i exp(-g M / R_u integral dH / T)$, so that $dp/dz = -rho g (r / (r + z))^2$.

    The first layer is extrapolated below its base, and the last one above it.

    Attributes:
        bases: geopotential altitude of the layers' bases, increasing, m.
        lapses: temperature gradient dT/dH in each layer, K/m.
        temperature_at_base: temperature at the lowest base, K.
        pressure_at_base: pressure at the lowest base, Pa.
        gravity: acceleration that defines the geopotential metre, m/s2.
        radius: radius of the planet, for the geopotential altitude, m.
        molar_mass: molar mass of the air, kg/kmol.
        gas_constant: universal gas constant, J/(kmol K).
        heat_ratio: ratio of specific heats c_p / c_v.
    Raises:
        ModelError: bases and lapses of different lengths; bases that do not increase; a temperature at a base or in the
            last layer, or another number, that is not positive.
    """

    bases: tuple[float, ...]
    lapses: tuple[float, ...]
    temperature_at_base: float
    pressure_at_base: float
    gravity: float
    radius: float
    molar_mass: float
    gas_constant: float
    heat_ratio: float

    def __post_init__(self) -> None:
        for name in ("pressure_at_base", "gravity", "radius", "molar_mass", "gas_constant", "heat_ratio"):
            positive(self, name, getattr(self, name))
        for values in (self.bases, self.lapses, self.temperature_at_base):
            reals("LayeredAtmosphere: bases, lapses and temperatures", values, ModelError)
        if len(self.bases) != len(self.lapses) or not self.bases:
            raise ModelError(
                f"LayeredAtmosphere expects a lapse for each base, got {len(self.bases)} bases "
                f"and {len(self.lapses)} lapses"
            )
        if not (np.diff(self.bases) > 0.0).all():
            raise ModelError(f"LayeredAtmosphere expects bases that increase, got {self.bases}")
        if not min(self.temperatures) > 0.0 or self.lapses[-1] < 0.0:
            raise ModelError(
                "LayeredAtmosphere expects temperatures above 0 K, and no decrease above the last base, "
                f"got {self.temperatures} K at the bases and a last lapse of {self.lapses[-1]} K/m"
            )

    @property
    def temperatures(self) -> tuple[float, ...]:
        """Temperature at the bases, K."""
        steps = np.multiply(self.lapses[:-1], np.diff(self.bases))
        return tuple((self.temperature_at_base + np.concatenate([[0.0], np.cumsum(steps)])).tolist())

    @property
    def decay(self) -> float:
        """g M / R*, K/m, with d(ln p)/dH = -decay / T."""
        return self.gravity * self.molar_mass / self.gas_constant

    @property
    def specific_gas_constant(self) -> float:
        """R* / M, J/(kg K)."""
        return self.gas_constant / self.molar_mass

    @property
    def log_pressures(self) -> tuple[float, ...]:
        """ln(p / p_0) at the bases."""
        T, L = np.array(self.temperatures), np.array(self.lapses[:-1])
        even = L == 0.0
        inverse = np.where(even, np.diff(self.bases) / T[:-1], np.log(T[1:] / T[:-1]) / np.where(even, 1.0, L))
        return tuple((-self.decay * np.concatenate([[0.0], np.cumsum(inverse)])).tolist())

    def temperature(self, altitude: ExprLike) -> Expr:
        """Temperature in K at geometric altitudes in m, entry by entry."""
        return Temperature(altitude, self)

    def pressure(self, altitude: ExprLike) -> Expr:
        """Pressure in Pa at geometric altitudes in m, entry by entry."""
        return Pressure(altitude, self)

    def density(self, altitude: ExprLike) -> Expr:
        """Density p M / (R* T) in kg/m3 at geometric altitudes in m, entry by entry."""
        altitude = to_expr(altitude)
        return self.pressure(altitude) / (self.specific_gas_constant * self.temperature(altitude))

    def speed_of_sound(self, altitude: ExprLike) -> Expr:
        """Speed of sound $sqrt(gamma R_u T / M)$ in m/s at geometric altitudes in m, entry by entry."""
        return Sqrt(self.heat_ratio * self.specific_gas_constant * self.temperature(altitude))


#: The US Standard Atmosphere 1976 from 0 to 86 km. As in its own tables, the first layer extends down to -5 km. The
#: temperature is the molecular-scale temperature, T M_0 / M. It is the kinetic temperature up to 80 km; between 80 and
#: 86 km, where the molar mass of the standard decreases, it is up to 0.05 % higher. Pressure, density and speed of
#: sound are those of the standard everywhere. Above 86 km this model keeps the temperature of 86 km, while the standard
#: changes to diffusive equilibrium: at 200 km the density here is too small by a factor of 16,000. Planets use
#: `upper_atmosphere.US1976_TO_1000_KM` for these altitudes. Source: U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562:
#: constants and layers of the molecular-scale temperature.
US1976 = LayeredAtmosphere(
    bases=(0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3, 84852.0),
    lapses=(-6.5e-3, 0.0, 1.0e-3, 2.8e-3, 0.0, -2.8e-3, -2.0e-3, 0.0),
    temperature_at_base=288.15,
    pressure_at_base=101325.0,
    gravity=9.80665,
    radius=6356766.0,
    molar_mass=28.9644,
    gas_constant=8314.32,
    heat_ratio=1.4,
)


#: An atmosphere in kilometres and bars: finite differences in tests need values and steps of similar size.
_SMALL = LayeredAtmosphere(
    bases=(0.0, 1.0, 2.0),
    lapses=(-0.5, 0.0, 0.3),
    temperature_at_base=3.0,
    pressure_at_base=1.0,
    gravity=9.8,
    radius=60.0,
    molar_mass=0.3,
    gas_constant=1.0,
    heat_ratio=1.4,
)


class _OfAltitude(Entrywise):
    """Base class of temperature and pressure."""

    altitude: Operand
    air: LayeredAtmosphere = US1976
    keeps_order = False
    abstract = True
    cases = ({"altitude": [-0.4, 0.5, 1.5, 3.0], "air": _SMALL},)
    kinks = ({"altitude": [0.0, 11e3, 90e3, -1e3], "air": US1976},)


class Temperature(_OfAltitude):
    """Temperature of a layered atmosphere in K, entry by entry; the shape is that of altitude.

    At the boundary of two layers, the derivative is that of the layer above.

    Attributes:
        altitude: geometric altitude, m.
        air: the atmosphere, by default the US Standard Atmosphere 1976.
    """

    kinds = FixedUnits((METRE,), KELVIN)

    def evaluate(self, *values: Array) -> Array:
        return profile(self.air, values[0])[0]


class Pressure(_OfAltitude):
    """Pressure of a layered atmosphere in Pa, entry by entry; the shape is that of altitude.

    Its first derivative is continuous; at the boundary of two layers, the second one is that of the layer above.

    Attributes:
        altitude: geometric altitude, m.
        air: the atmosphere, by default the US Standard Atmosphere 1976.
    """

    kinds = FixedUnits((METRE,), NEWTON / METRE**2)

    def evaluate(self, *values: Array) -> Array:
        return self.air.pressure_at_base * jnp.exp(profile(self.air, values[0])[1])


def profile(air: LayeredAtmosphere, altitude: Array) -> tuple[Array, Array]:
    """Temperature in K and ln(p / p_0) at geometric altitudes in m, entry by entry."""
    H = altitude / (1.0 + altitude / air.radius)
    bases, lapses, temperatures, log_pressures = (
        jnp.asarray(table, altitude.dtype) for table in (air.bases, air.lapses, air.temperatures, air.log_pressures)
    )
    layer = jnp.searchsorted(bases[1:], H, side="right", method="compare_all")
    climb, lapse, base = H - bases[layer], lapses[layer], temperatures[layer]
    T = base + lapse * climb
    even = lapse == 0.0
    inverse = jnp.where(even, climb / base, jnp.log1p(lapse * climb / base) / jnp.where(even, 1.0, lapse))
    return T, log_pressures[layer] - air.decay * inverse
