"""The check-cases in a file: inputs, and the outputs that belong to them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from ....checks import listed
from ..xml_file import Element
from .functions import needed
from .numbers import number_of


@dataclasses.dataclass(frozen=True)
class StaticCheck:
    """One output of one `staticShot`.

    Attributes:
        shot: name of the shot.
        output: varID.
        expected, tolerance: as in the file; within the tolerance is right.
        found: what the expressions give.
        place: file, line and element, for messages.
    """

    shot: str
    output: str
    expected: float
    tolerance: float
    found: float
    place: str

    @property
    def holds(self) -> bool:
        return abs(self.found - self.expected) <= self.tolerance


@dataclasses.dataclass(frozen=True)
class Value:
    """A signal of a shot: its element, its value and, of outputs, its tolerance."""

    element: Element
    value: float
    tolerance: float


@dataclasses.dataclass(frozen=True)
class Shot:
    """A `staticShot`: values by varID. `internal` may help to find where a calculation went wrong."""

    name: str
    inputs: Mapping[str, Value]
    internal: Mapping[str, Value]
    outputs: Mapping[str, Value]


def read_shots(root: Element, names: Mapping[str, list[str]]) -> list[Shot]:
    """The shots of a file.

    Args:
        names: the varIDs by name of variable, and by varID itself.
    Raises: ModelError for a signal that is no variable, or whose name several have.
    """

    def values(shot: Element, part: str) -> dict[str, Value]:
        block = shot.first(part)
        return dict(_signal(signal, names) for signal in block.all("signal")) if block else {}

    return [
        Shot(
            shot.text("name"), values(shot, "checkInputs"), values(shot, "internalValues"), values(shot, "checkOutputs")
        )
        for data in root.all("checkData")
        for shot in data.all("staticShot")
    ]


def _signal(signal: Element, names: Mapping[str, list[str]]) -> tuple[str, Value]:
    name = needed(signal, "signalName", "varID", "signalID").content.strip()
    found = names.get(name, [])
    if not found:
        raise signal.wrong(f"there is no variable {name!r}; there are {listed(names, name)}")
    if len(found) > 1:
        raise signal.wrong(f"several variables have the name {name!r}: {', '.join(found)}")
    value, tolerance = needed(signal, "signalValue"), signal.first("tol")
    return found[0], Value(
        signal, number_of(value, value.content), 0.0 if tolerance is None else number_of(tolerance, tolerance.content)
    )
