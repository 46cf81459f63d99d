"""Function tables: gridded tables, and ungridded tables whose points form a grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from ....checks import listed
from ....expr import Expr, Interp, Max, Min, Where
from ....expr.tables.kinds import Clamped, Extrapolated
from ..xml_file import Element

#: For each kind of step table, the comparison of the input with the breakpoints.
Steps: TypeAlias = Callable[[Expr, np.ndarray], list[Expr]]

#: The values of `interpolate`: linear between breakpoints; or the value at the nearest breakpoint (the higher one at
#: the midpoint), at the last one that is not above the input, or at the first one that is not below. This follows the
#: reference manual of DAVE-ML 2.0.2; earlier drafts of it exchange floor and ceiling.
_LOOKUPS: dict[str, Steps | None] = {
    "linear": None,
    "discrete": lambda x, points: [x >= middle for middle in (points[1:] + points[:-1]) / 2.0],
    "floor": lambda x, points: [x >= point for point in points[1:]],
    "ceiling": lambda x, points: [x > point for point in points[:-1]],
}
#: The values of `extrapolate`: whether the table is extrapolated below its first and above its last breakpoint.
_ENDS = {"neither": (False, False), "min": (True, False), "max": (False, True), "both": (True, True)}


@dataclasses.dataclass(frozen=True)
class TableAxis:
    """One input of a table, by `independentVarRef` or `independentVarPts`.

    Attributes:
        element: its element in the file.
        variable: varID of the input.
        lower, upper: limits to which the input is clipped; None for no limit.
        below, above: whether the table is extrapolated beyond its ends; otherwise the values at the ends are used.
        steps: the location of the jumps; None for a table that is linear between breakpoints.
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
                f"interpolate={kind!r} is not supported; possible values are {listed(_LOOKUPS)}.\n"
                "  fix: tabulate the spline at finer breakpoints"
            )
        lower, upper = element.limits("min", "max")
        below, above = _ENDS[ends]
        return cls(element, element.text("varID").strip(), lower, upper, below, above, _LOOKUPS[kind])

    def place(self, x: Expr, breakpoints: np.ndarray) -> tuple[Expr, np.ndarray]:
        """The coordinate for a piecewise linear table, and its breakpoints; for step tables, the integer index of the
        value.

        An input of NaN gives NaN.
        """
        x = limited(x, self.lower, self.upper)
        if self.steps is None:
            return x, breakpoints
        known = Where(x == x, 0.0, np.nan)  # NaN is above none of the breakpoints
        count = sum((Where(passed, 1.0, 0.0) for passed in self.steps(x, breakpoints)), known)
        return count, np.arange(float(len(breakpoints)))


def limited(x: Expr, lower: float | None, upper: float | None) -> Expr:
    """x clipped to limits that may be None."""
    x = x if lower is None else Max(x, lower)
    return x if upper is None else Min(x, upper)


@dataclasses.dataclass(frozen=True)
class GriddedTable:
    """Values over a grid.

    Attributes:
        breakpoints: of each axis, increasing.
        values: one axis for each of them; in the file the last axis varies fastest.
    """

    breakpoints: tuple[np.ndarray, ...]
    values: np.ndarray

    def at(self, inputs: Sequence[Expr], axes: Sequence[TableAxis]) -> Expr:
        """The interpolated value at inputs."""
        places, points, outside = [], [], list[Any]()
        for x, axis, breakpoints in zip(inputs, axes, self.breakpoints):
            place, numbers = axis.place(x, breakpoints)
            goes_on = (axis.below or axis.above) and numbers is breakpoints
            if goes_on:  # extrapolate with the last slope, at the ends where the axis requires it
                place = limited(place, None if axis.below else numbers[0], None if axis.above else numbers[-1])
            places.append(place)
            points.append(numbers)
            outside.append(Extrapolated() if goes_on else Clamped())
        return Interp(*places, axes=points, values=self.values, outside=outside)
