"""Functions of a DAVE-ML file: variables that are tables over other variables."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from ....checks import listed
from ....expr import Expr
from ..xml_file import Element
from .tables import GriddedTable, TableAxis

_GRIDDED, _UNGRIDDED = ("griddedTableDef", "griddedTable"), ("ungriddedTableDef", "ungriddedTable")


@dataclasses.dataclass(frozen=True)
class TableLookup:
    """A variable whose value is looked up in a table.

    Attributes:
        element: its element in the file.
        output: varID of the variable.
        axes: for each axis of the table, the input and its treatment.
        table: the table of values.
    """

    element: Element
    output: str
    axes: tuple[TableAxis, ...]
    table: GriddedTable

    def __call__(self, variables: Mapping[str, Expr]) -> Expr:
        return self.table.at([variables[axis.variable] for axis in self.axes], self.axes)


def by_id(elements: Iterable[Element], attribute: str) -> dict[str, Element]:
    """Elements by an attribute that must be unique. Raises ModelError for a repeated one."""
    by_name: dict[str, Element] = {}
    for element in elements:
        name = element.text(attribute).strip()
        if name in by_name:
            raise element.wrong(f"{attribute} {name!r} is already defined in line {by_name[name].line}")
        by_name[name] = element
    return by_name


def within(element: Element) -> Iterator[Element]:
    """An element and all its descendants."""
    pending = [element]
    while pending:
        yield (current := pending.pop())
        pending += reversed(current.children)


def needed(element: Element, *tags: str) -> Element:
    """The first child element with one of these tags. Raises ModelError if there is none."""
    matching = next((child for child in element.children if child.tag in tags), None)
    if matching is None:
        raise element.wrong(f"expected <{'> or <'.join(tags)}> inside")
    return matching


class FunctionReader:
    """Reads the functions of a file. A table that several functions use is read once."""

    def __init__(self, root: Element) -> None:
        self._breakpoints = {
            name: increasing(needed(e, "bpVals")) for name, e in by_id(root.all("breakpointDef"), "bpID").items()
        }
        defined = list(within(root))
        self._gridded = by_id((e for e in defined if e.tag in _GRIDDED and "gtID" in e.attributes), "gtID")
        self._ungridded = by_id((e for e in defined if e.tag in _UNGRIDDED and "utID" in e.attributes), "utID")
        self._read: dict[int, GriddedTable] = {}
        self.all = [self._function(element) for element in root.all("function")]

    def _function(self, element: Element) -> TableLookup:
        points = element.all("independentVarPts")
        refs = element.all("independentVarRef")
        if points and refs:
            raise refs[0].wrong("a function has either <independentVarRef> or <independentVarPts>")
        inputs = points or refs
        output = needed(element, "dependentVarPts" if points else "dependentVarRef")
        axes = tuple(TableAxis.read(one) for one in inputs)
        if points:
            table = on_grid([increasing(one) for one in points], output.values, output)
        else:
            table = self._table(needed(element, "functionDefn"))
        if len(axes) != len(table.breakpoints):
            raise element.wrong(f"{len(axes)} independent variables for a table with {len(table.breakpoints)} axes")
        return TableLookup(element, output.text("varID").strip(), axes, table)

    def _table(self, definition: Element) -> GriddedTable:
        element = needed(definition, *_GRIDDED, "griddedTableRef", *_UNGRIDDED, "ungriddedTableRef")
        if element.tag == "griddedTableRef":
            element = referred(element, "gtID", self._gridded)
        elif element.tag == "ungriddedTableRef":
            element = referred(element, "utID", self._ungridded)
        if id(element) not in self._read:
            read = self._from_grid if element.tag in _GRIDDED else from_points
            self._read[id(element)] = read(element)
        return self._read[id(element)]

    def _from_grid(self, element: Element) -> GriddedTable:
        refs = needed(element, "breakpointRefs").all("bpRef")
        breakpoints = [referred(ref, "bpID", self._breakpoints) for ref in refs]
        data = needed(element, "dataTable")
        return on_grid(breakpoints, data.values, data)


def referred(element: Element, attribute: str, known: Mapping[str, Any]) -> Any:
    """The element that a reference names. Raises ModelError if there is none."""
    name = element.text(attribute).strip()
    if name not in known:
        raise element.wrong(f"{attribute} {name!r} is not defined; there are {listed(known, name)}")
    return known[name]


def increasing(element: Element) -> np.ndarray:
    """Breakpoints as an array. Raises ModelError if they do not increase."""
    values = element.values
    if len(values) < 2 or not (np.diff(values) > 0).all():
        raise element.wrong(f"expected two or more increasing breakpoints, got {values.tolist()}")
    return values


def on_grid(breakpoints: list[np.ndarray], values: np.ndarray, element: Element) -> GriddedTable:
    """Values in the order of the file as an array over the grid. Raises ModelError for a wrong number of values."""
    shape = tuple(map(len, breakpoints))
    if not shape or values.size != np.prod(shape):
        raise element.wrong(f"expected {' x '.join(map(str, shape)) or 'breakpoints and'} values, got {values.size}")
    return GriddedTable(tuple(breakpoints), values.reshape(shape))


def from_points(element: Element) -> GriddedTable:
    """An ungridded table in any order, of a single input or of points that fill a grid. Raises ModelError for other
    tables.
    """
    rows = [point.values for point in element.all("dataPoint")]
    widths = {len(row) for row in rows}
    if len(widths) != 1 or widths.pop() < 2:
        raise element.wrong("expected <dataPoint> elements that have the same number of inputs and one value each")
    points = np.array(rows)
    breakpoints = [np.unique(column) for column in points[:, :-1].T]
    order = np.lexsort(points[:, -2::-1].T)
    filled = len(points) == np.prod([len(axis) for axis in breakpoints])
    if not filled or len(np.unique(points[:, :-1], axis=0)) != len(points) or min(map(len, breakpoints)) < 2:
        raise element.wrong(
            f"its {len(points)} points do not fill a grid of {' x '.join(str(len(a)) for a in breakpoints)}.\n"
            "  fix: interpolate the scattered points to a grid and write a griddedTableDef"
        )
    return GriddedTable(tuple(breakpoints), points[order, -1].reshape([len(axis) for axis in breakpoints]))
