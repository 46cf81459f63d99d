"""Function tables: gridded ones, and ungridded ones whose points fill a grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from ....checks import listed
from ....expr import Expr, Interp, Max, Min, Where
from ....expr.tables.kinds import Clamped, Extrapolated
from ..xml_file import Element

#: One condition for each step of a table of steps, of the input and the breakpoints.
Steps: TypeAlias = Callable[[Expr, np.ndarray], list[Expr]]

#: Entries of `interpolate`: linear between breakpoints, or the value at the nearest one, halfway the higher one, at the
#: last that is not above, at the first that is not below. The reference manual of DAVE-ML 2.0.2 is followed: earlier
#: drafts of it have floor and ceiling the other way round.
_LOOKUPS: dict[str, Steps | None] = {
    "linear": None,
    "discrete": lambda x, points: [x >= middle for middle in (points[1:] + points[:-1]) / 2.0],
    "floor": lambda x, points: [x >= point for point in points[1:]],
    "ceiling": lambda x, points: [x > point for point in points[:-1]],
}
#: Values of `extrapolate`: whether the table is extrapolated below its first and above its last breakpoint.
_ENDS = {"neither": (False, False), "min": (True, False), "max": (False, True), "both": (True, True)}


@dataclasses.dataclass(frozen=True)
class TableAxis:
    """How one input enters a table, by `independentVarRef` or `independentVarPts`.

    Attributes:
        element: where the file says it.
        variable: the input's varID.
        lower, upper: the input is kept between these, if they are not None.
        below, above: the table is continued beyond its ends; else the values at the ends hold.
        steps: where the value jumps; None for a table that is linear between breakpoints.
    """

    element: Element
    variable: str
    lower: float | None
    upper: float | None
    below: bool
    above: bool
    steps: Steps | None

    @classmethod
    def read(cls, element: Element) -> TableAxis:
        """Raises ModelError for an unknown `extrapolate` or `interpolate`."""
        ends = element.attributes.get("extrapolate", "neither")
        if ends not in _ENDS:
            raise element.wrong(f"extrapolate expects one of {listed(_ENDS, ends)}, got {ends!r}")
        kind = element.attributes.get("interpolate", "linear")
        if kind not in _LOOKUPS:
            raise element.wrong(
                f"interpolate={kind!r} is not read; tables are looked up by {listed(_LOOKUPS)}.\n"
                "  fix: put the spline's values on finer breakpoints"
            )
        lower, upper = element.limits("min", "max")
        below, above = _ENDS[ends]
        return cls(element, element.text("varID").strip(), lower, upper, below, above, _LOOKUPS[kind])

    def place(self, x: Expr, breakpoints: np.ndarray) -> tuple[Expr, np.ndarray]:
        """The coordinate for a piecewise linear table, and its breakpoints; for steps the whole index of the value.

        NaN stays NaN.
        """
        x = limited(x, self.lower, self.upper)
        if self.steps is None:
            return x, breakpoints
        known = Where(x == x, 0.0, np.nan)  # NaN has passed none of them
        count = sum((Where(passed, 1.0, 0.0) for passed in self.steps(x, breakpoints)), known)
        return count, np.arange(float(len(breakpoints)))


def limited(x: Expr, lower: float | None, upper: float | None) -> Expr:
    """x between limits that may be missing."""
    x = x if lower is None else Max(x, lower)
    return x if upper is None else Min(x, upper)


@dataclasses.dataclass(frozen=True)
class GriddedTable:
    """Values over a grid.

    Attributes:
        breakpoints: of each axis, increasing.
        values: one axis for each of them; the last one changes fastest in the file.
    """

    breakpoints: tuple[np.ndarray, ...]
    values: np.ndarray

    def at(self, inputs: Sequence[Expr], axes: Sequence[TableAxis]) -> Expr:
        """The interpolated value."""
        places, points, outside = [], [], list[Any]()
        for x, axis, breakpoints in zip(inputs, axes, self.breakpoints):
            place, numbers = axis.place(x, breakpoints)
            goes_on = (axis.below or axis.above) and numbers is breakpoints
            if goes_on:  # the last slope, on the sides that the axis says
                place = limited(place, None if axis.below else numbers[0], None if axis.above else numbers[-1])
            places.append(place)
            points.append(numbers)
            outside.append(Extrapolated() if goes_on else Clamped())
        return Interp(*places, axes=points, values=self.values, outside=outside)
