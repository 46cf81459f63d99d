"""Units as numbers: `30_000 * units.feet` is the float 9144.0 with the unit m.

    from twistax import units

    altitude, speed = 30_000 * units.feet, 400 * units.knots      # 9144.0 m, 205.78 m/s
    inertia = 3.6 * units.slugs * units.feet**2                    # 4.8809 kg m2
    solution.outputs["altitude"] / units.feet                      # and back

All quantities in twistax are in m, kg, s, rad and K. A `Quantity` is a float in these units and can be used like any
float. Functions that expect a unit, such as `flight.start`, raise an error for another unit, and interpret plain
numbers in m, kg, s, rad and K.

The product of a unit with an array or an expression is an array or expression multiplied by its factor, whose unit is
not checked.

Sources of the factors, all exact: the international yard and pound (1959), ISO 80000-3 for the nautical mile, standard
gravity of the General Conference on Weights and Measures (1901).
"""

from __future__ import annotations

import math
import numbers
from typing import Any

import numpy as np

from .checks import reals, short
from .errors import InputError, OperationError

# fmt: off
__all__ = [
    "Quantity", "degrees", "feet", "hours", "inches", "kelvins", "kilograms", "kilometres", "knots", "metres",
    "minutes", "nautical_miles", "newtons", "pascals", "pounds", "pounds_force", "radians", "rankines",
    "same_unit", "seconds", "slugs", "taken",
]
# fmt: on

#: The base units, in the order of exponents.
_BASE = ("kg", "m", "s", "rad", "K")


def _comparison(operation: Any) -> Any:
    def compared(self: Quantity, other: Any) -> Any:
        if isinstance(other, Quantity) and other.exponents != self.exponents:
            raise OperationError(f"{self!r} and {other!r} cannot be compared: their units differ")
        return operation(self, other)

    return compared


class Quantity(float):
    """A float in kg, m, s, rad and K with the exponents of these units.

    Products, quotients and whole powers are quantities; sums and differences are quantities if both units are equal. A
    sum with a plain number is a plain number. A list or tuple of numbers times a unit is a list of quantities.

    Raises: OperationError if a sum, a difference or a comparison by size mixes units, or if a power is not whole.
    """

    exponents: tuple[int, ...]
    __lt__, __le__, __gt__, __ge__ = map(_comparison, (float.__lt__, float.__le__, float.__gt__, float.__ge__))
    #: Above that of NumPy's scalars, which then leave a product to the quantity, and below that of its arrays.
    __array_priority__ = -1.0

    def __new__(cls, value: float, exponents: tuple[int, ...] = (0, 0, 0, 0, 0)) -> Quantity:
        made = super().__new__(cls, value)
        made.exponents = exponents
        return made

    @property
    def unit(self) -> str:
        """The unit in text, such as 'kg m2 s-2'."""
        parts = [name + ("" if n == 1 else str(n)) for name, n in zip(_BASE, self.exponents) if n]
        return " ".join(parts) or "1"

    def __repr__(self) -> str:
        return f"{float(self)!r} {self.unit}"

    def __reduce__(self) -> Any:
        return Quantity, (float(self), self.exponents)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, (list, tuple)):
            return [entry * self for entry in other]
        return self._combined(other, float.__mul__, 1)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self._combined(other, float.__truediv__, -1)

    def __rtruediv__(self, other: Any) -> Any:
        return self**-1 * other

    def __pow__(self, power: Any, modulo: None = None) -> Any:
        if not isinstance(power, numbers.Integral):
            raise OperationError(f"a power of {self!r} expects a whole number as exponent, got {short(power)}")
        return Quantity(float(self) ** int(power), tuple(n * int(power) for n in self.exponents))

    def __add__(self, other: Any) -> Any:
        return self._summed(other, float.__add__)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self._summed(other, float.__sub__)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __neg__(self) -> Quantity:
        return Quantity(-float(self), self.exponents)

    def _combined(self, other: Any, operation: Any, sign: int) -> Any:
        if not isinstance(other, numbers.Real):
            return NotImplemented
        theirs = other.exponents if isinstance(other, Quantity) else (0,) * len(_BASE)
        exponents = tuple(a + sign * b for a, b in zip(self.exponents, theirs))
        return Quantity(operation(float(self), float(other)), exponents)

    def _summed(self, other: Any, operation: Any) -> Any:
        if not isinstance(other, numbers.Real):
            return NotImplemented
        total = operation(float(self), float(other))
        if not isinstance(other, Quantity):
            return total
        if other.exponents != self.exponents:
            raise OperationError(f"{self!r} and {other!r} cannot be added: their units differ")
        return Quantity(total, self.exponents)


def same_unit(place: str, value: Any, unit: Quantity) -> None:
    """Raise InputError, which names the place, if a value, alone or in lists, has another unit; values without a unit
    pass.
    """
    if isinstance(value, (list, tuple)):
        for entry in value:
            if entry is not value:  # a list that holds itself is refused as not numeric
                same_unit(place, entry, unit)
    elif isinstance(value, Quantity) and value.exponents != unit.exponents:
        raise InputError(f"{place} expects {unit.unit}, got {value!r}.\n  fix: pass it in a unit of {unit.unit}")


def taken(place: str, value: Any, unit: Quantity, shape: tuple[int, ...] = ()) -> np.ndarray:
    """An argument of a public function, checked, as numbers in m, kg, s, rad and K.

    Args:
        place: the name of the value in messages.
        value: a number or an array of them; quantities, alone or in lists, must have the unit.
        unit: the expected unit, such as `units.metres`.
        shape: the expected shape.
    Raises:
        InputError: a value with another unit or shape, or that is not a finite real number.
    """
    same_unit(place, value, unit)
    array = reals(place, value, InputError)
    if array.shape != shape or not np.isfinite(array).all():
        what = "a finite number" if not shape else f"finite numbers of shape {shape}"
        raise InputError(f"{place} expects {what} in {unit.unit}, got {short(value)}")
    return array


kilograms = Quantity(1.0, (1, 0, 0, 0, 0))
metres = Quantity(1.0, (0, 1, 0, 0, 0))
seconds = Quantity(1.0, (0, 0, 1, 0, 0))
radians = Quantity(1.0, (0, 0, 0, 1, 0))
kelvins = Quantity(1.0, (0, 0, 0, 0, 1))

kilometres = 1000.0 * metres
feet = 0.3048 * metres
inches = 0.0254 * metres
nautical_miles = 1852.0 * metres
minutes = 60.0 * seconds
hours = 3600.0 * seconds
knots = nautical_miles / hours
degrees = math.pi / 180.0 * radians
newtons = kilograms * metres / seconds**2
pascals = newtons / metres**2
pounds = 0.45359237 * kilograms
#: The weight of a pound in standard gravity, 9.80665 m/s2.
pounds_force = 4.4482216152605 * newtons
#: What a pound-force accelerates by a foot per second squared: 4.4482216152605 / 0.3048 kg, rounded once.
slugs = 14.593902937206364 * kilograms
#: A difference of temperatures, or a temperature from absolute zero.
rankines = 5.0 / 9.0 * kelvins
