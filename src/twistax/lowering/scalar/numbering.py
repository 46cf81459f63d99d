"""Value numbering: nodes that are equal for other reasons than how they are written, found by their numbers."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from .graph import LIMITS, Graph, Limits
from .operations import Operation, by_primitive

__all__ = ["NumberedGraph", "ValueNumbering"]

#: Smooth operations: where two of their compositions agree at points drawn at random they agree everywhere.
_SMOOTH = frozenset(
    by_primitive[name]
    for name in [
        *("add", "sub", "mul", "div", "neg", "sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "sinh"),
        *("cosh", "tanh", "asinh", "atan", "logistic"),
    ]
)
_SUMS = (by_primitive["add"], by_primitive["sub"])
_NEG = by_primitive["neg"]


@dataclasses.dataclass(frozen=True)
class ValueNumbering:
    """Merge scalars that are equal for all arguments, as symmetric products are, though they are written differently.

    Each scalar is worked out at random points; two that agree at all of them become one, and sums that vanish become
    zero. What was merged is verified at other points in extended precision; if a single one fails, none is merged.

    The risk: two different functions may agree to within the tolerance at all points, by an accident that each further
    point makes rarer by about that factor, or because they nearly agree everywhere, as x and x + 1e-14 do; the program
    is then wrong by as little as the tolerance says. Rounding differs from the program as written. Functions with kinks
    or branches are never merged.

    Attributes:
        points: how many random points; at least 2.
        seed: of the random numbers.
        tolerance: how closely numbers must agree, relative.
    """

    points: int = 6
    seed: int = 0
    tolerance: float = 1e-11

    def __post_init__(self) -> None:
        if self.points < 2:
            raise ModelError(f"ValueNumbering expects at least 2 points, got {self.points}")
        if not 0.0 < self.tolerance < 1e-6:
            raise ModelError(f"ValueNumbering expects a tolerance between 0 and 1e-6, got {self.tolerance}")


class NumberedGraph(Graph):
    """A graph whose nodes carry their values at random points.

    Attributes:
        merged: (operation, its arguments, the node it was found equal to) of everything merged.
    """

    def __init__(self, dtype: Any, largest: int, numbering: ValueNumbering, limits: Limits = LIMITS) -> None:
        self.numbering = numbering
        self.merged: list[tuple[Operation, tuple[int, ...], int]] = []
        self._random = np.random.default_rng(numbering.seed)
        self._values: list[NDArray[Any]] = []
        self._places: dict[int, list[int]] = {}
        super().__init__(dtype, False, largest, limits)

    def _intern(self, key: tuple[Any, ...], dtype: np.dtype[Any], number: Any = None) -> int:
        if key in self._known:
            return self._known[key]
        values = self._worked_out(key, dtype, number)
        smooth = isinstance(key[0], Operation) and key[0] in _SMOOTH and dtype == self.dtype
        if smooth and key[0] is not _NEG:
            found = self._equal(key, values)
            if found is not None:
                self.merged.append((key[0], key[1:], found))
                self._known[key] = found
                return found
        node = super()._intern(key, dtype, number)
        self._values.append(values)
        if dtype == self.dtype and number is None:
            self._places.setdefault(_bucket(values[0]), []).append(node)
        return node

    def _worked_out(self, key: tuple[Any, ...], dtype: np.dtype[Any], number: Any) -> NDArray[Any]:
        """The values of a new node; of what is not smooth, or not finite, as of an input, drawn at random."""
        if number is not None:
            return np.full(self.numbering.points, float(number))
        if isinstance(key[0], Operation) and key[0] in _SMOOTH:
            with np.errstate(all="ignore"):
                values = key[0].number(*(self._values[a] for a in key[1:]))
            if np.isfinite(values).all():
                return np.asarray(values, float)
        return _drawn(self._random, self.numbering.points)

    def _equal(self, key: tuple[Any, ...], values: NDArray[Any]) -> int | None:
        """A node with these values, or their opposite, or zero."""
        tolerance = self.numbering.tolerance
        if key[0] in _SUMS:
            size = np.maximum(*(np.abs(self._values[a]) for a in key[1:]))
            if np.all(np.abs(values) <= 0.01 * tolerance * size):
                return self.zero
        place = _bucket(values[0])
        for near in (place, place - 1, place + 1):
            for node in self._places.get(near, ()):
                other = self._values[node]
                if np.all(np.abs(values - other) <= tolerance * np.abs(values)):
                    return node
                if np.all(np.abs(values + other) <= tolerance * np.abs(values)):
                    return self.neg(node)
        return None

    def verified(self) -> bool:
        """Whether everything merged is equal at fresh points in extended precision too."""
        random = np.random.default_rng(self.numbering.seed + 1)
        count = self.numbering.points
        values: list[NDArray[Any]] = []
        with np.errstate(all="ignore"):
            for entry, number in zip(self.nodes, self.numbers, strict=True):
                if number is not None:
                    found = np.full(count, number, np.longdouble)
                elif isinstance(entry[0], Operation) and entry[0] in _SMOOTH:
                    found = np.asarray(entry[0].number(*(values[a] for a in entry[1:])), np.longdouble)
                    found = np.where(np.isfinite(found), found, _drawn(random, count))
                else:
                    found = _drawn(random, count).astype(np.longdouble)
                values.append(found)
            for operation, arguments, node in self.merged:
                given = [values[a] for a in arguments]
                size = np.maximum(np.max(np.abs(given), axis=0), np.abs(values[node]))
                if not np.all(
                    np.abs(operation.number(*given) - values[node]) <= 1e-3 * self.numbering.tolerance * size
                ):
                    return False
        return True


def _drawn(random: np.random.Generator, count: int) -> NDArray[Any]:
    """Numbers of both signs away from zero."""
    return random.uniform(0.3, 1.3, count) * random.choice([-1.0, 1.0], count)


def _bucket(value: float) -> int:
    """The same, or a neighbour, for values that agree to nine digits, whatever their sign."""
    return int(math.log(abs(float(value)) + 1e-300) * 1e9)
