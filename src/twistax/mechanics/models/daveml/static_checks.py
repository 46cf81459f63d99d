"""The check-cases in a file: inputs with the expected outputs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from ....checks import listed
from ..xml_file import Element
from .functions import needed


@dataclasses.dataclass(frozen=True)
class StaticCheck:
    """The comparison of one output of one `staticShot`.

    Attributes:
        shot: name of the shot.
        output: varID.
        expected, tolerance: as in the file; an output is correct if its error is within the tolerance.
        found: the value of the expressions.
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
    """A signal of a shot: its element, its value and, for outputs, its tolerance."""

    element: Element
    value: float
    tolerance: float


@dataclasses.dataclass(frozen=True)
class Shot:
    """A `staticShot`: values by varID. Values in `internal` may help to locate an error of a calculation."""

    name: str
    inputs: Mapping[str, Value]
    internal: Mapping[str, Value]
    outputs: Mapping[str, Value]


def read_shots(root: Element, variables: Mapping[str, tuple[str, str]]) -> list[Shot]:
    """The shots of a file.

    Args:
        variables: name and units by varID.
    Raises: ModelError for a signal that is not a variable, whose name is ambiguous, or whose units differ.
    """

    def values(shot: Element, part: str) -> dict[str, Value]:
        block = shot.first(part)
        return dict(_signal(signal, variables) for signal in block.all("signal")) if block else {}

    return [
        Shot(
            shot.text("name"), values(shot, "checkInputs"), values(shot, "internalValues"), values(shot, "checkOutputs")
        )
        for data in root.all("checkData")
        for shot in data.all("staticShot")
    ]


def _signal(signal: Element, variables: Mapping[str, tuple[str, str]]) -> tuple[str, Value]:
    reference = needed(signal, "signalName", "varID", "signalID")
    word = reference.content.strip()
    by_name, by_id = [v for v, (name, _) in variables.items() if name == word], [word] if word in variables else []
    matching = by_id or by_name if reference.tag == "varID" else by_name or by_id
    if not matching:
        known = dict.fromkeys([*variables, *(name for name, _ in variables.values())])
        raise signal.wrong(f"there is no variable {word!r}; there are {listed(known, word)}")
    if len(matching) > 1:
        raise signal.wrong(f"several variables have the name {word!r}: {', '.join(matching)}")
    units, variable_unit = signal.first("signalUnits"), variables[matching[0]][1]
    if units is not None and variable_unit and units.content.strip() not in ("", variable_unit):
        raise signal.wrong(f"gives {word!r} in {units.content.strip()!r}, but its variable is in {variable_unit!r}")
    value, tolerance = needed(signal, "signalValue"), signal.first("tol")
    return matching[0], Value(
        signal, value.read(value.content), 0.0 if tolerance is None else tolerance.read(tolerance.content)
    )
