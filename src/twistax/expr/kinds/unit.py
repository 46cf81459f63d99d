"""Units as exponents of kg, m, s and K. An angle is a number, so a radian is 1."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

from ...errors import ModelError
from ...units import Quantity

_BASE = ("kg", "m", "s", "K")


@dataclasses.dataclass(frozen=True)
class Unit:
    """A product of powers of kg, m, s and K, one for all entries of an array.

    Attributes:
        exponents: the powers, whole numbers or fractions.
        text: the unit as it was declared, "rad/s" for 1/s; units with other texts are equal.
    Raises: ModelError in `Unit.of` for an unknown unit.
    Example: `tx.kinds.Unit.of("N m")`.
    """

    exponents: tuple[Fraction | int, ...] = (0,) * len(_BASE)
    text: str = dataclasses.field(default="", compare=False)

    @staticmethod
    def of(text: str) -> Unit:
        """The unit of a text such as "kg m2/s". Raises ModelError for another text."""
        return parsed("a unit", text)

    def __mul__(self, other: Unit) -> Unit:
        return Unit(tuple(a + b for a, b in zip(self.exponents, other.exponents)))

    def __truediv__(self, other: Unit) -> Unit:
        return Unit(tuple(a - b for a, b in zip(self.exponents, other.exponents)))

    def __pow__(self, power: Fraction | int) -> Unit:
        powers = (a * power for a in self.exponents)
        return Unit(tuple(int(n) if n == int(n) else n for n in powers))

    def __str__(self) -> str:
        above, below = (
            [name + ("" if n * sign == 1 else str(n * sign)) for name, n in zip(_BASE, self.exponents) if n * sign > 0]
            for sign in (1, -1)
        )
        return (" ".join(above) or "1") + (f"/{' '.join(below)}" if below else "")

    __repr__ = __str__


def _of(**powers: int) -> Unit:
    return Unit(tuple(powers.get(name, 0) for name in _BASE))


ONE, KILOGRAM, METRE, SECOND, KELVIN = Unit(), _of(kg=1), _of(m=1), _of(s=1), _of(K=1)
NEWTON, JOULE, WATT = _of(kg=1, m=1, s=-2), _of(kg=1, m=2, s=-2), _of(kg=1, m=2, s=-3)
_NAMES = {
    "1": ONE,
    "rad": ONE,
    "kg": KILOGRAM,
    "m": METRE,
    "s": SECOND,
    "K": KELVIN,
    "N": NEWTON,
    "J": JOULE,
    "W": WATT,
    "Pa": NEWTON / METRE**2,
    "Hz": ONE / SECOND,
}
_TURNS = (ONE, ONE / SECOND)
_FACTOR = re.compile(r"(1|[A-Za-z]+)\^?\*{0,2}(-?\d+)?$")


def unit_of_quantity(quantity: Quantity) -> Unit:
    """The unit of a quantity of `tx.units`; a radian counts as 1."""
    kilograms, metres, seconds, radians, kelvins = quantity.exponents
    unit = Unit((kilograms, metres, seconds, kelvins))
    return dataclasses.replace(unit, text="rad" if unit == ONE else "rad/s") if radians and unit in _TURNS else unit


def units_in(value: Any) -> Iterator[Unit]:
    """The units of all quantities in a value or in nested lists of values."""
    if isinstance(value, Quantity):
        yield unit_of_quantity(value)
    elif isinstance(value, (list, tuple)):
        for entry in value:
            yield from units_in(entry)


def common_unit(value: Any) -> Unit | None:
    """The unit of a quantity, or the common unit of all quantities in a list."""
    if isinstance(value, Quantity):
        return unit_of_quantity(value)
    if not isinstance(value, (list, tuple)) or not value:
        return None
    units = {common_unit(entry) for entry in value}
    return units.pop() if len(units) == 1 else None


def parsed(name: str, unit: Any) -> Unit:
    """The unit that a leaf declares: a text such as "kg m2/s", or a value of `tx.units` that is 1 in SI.

    Raises: ModelError for another text, or a unit that is not an SI unit, which leaves always have.
    """
    if isinstance(unit, Unit):
        return unit
    if isinstance(unit, Quantity):
        if float(unit) != 1.0:
            raise ModelError(
                f"{name!r} expects a unit of kg, m, s, rad and K, got {unit!r}.\n"
                "  fix: use an SI unit, and multiply the numbers by their unit"
            )
        return unit_of_quantity(unit)
    if not isinstance(unit, str):
        raise ModelError(f'{name!r} expects a unit such as "m/s" or tx.units.metres, got {unit!r}')
    total, text = ONE, unit.strip()
    for place, part in enumerate(text.split("/")):
        for factor in part.replace("*", " ").split():
            match = _FACTOR.match(factor)
            if match is None or match[1] not in _NAMES:
                raise ModelError(
                    f'{name!r} expects a unit such as "m/s", "kg m2" or "N m", got {unit!r}: {factor!r} is none of '
                    f"{', '.join(_NAMES)}"
                )
            power = int(match[2] or 1)
            total *= _NAMES[match[1]] ** (-power if place else power)
    return dataclasses.replace(total, text=unit.strip())
