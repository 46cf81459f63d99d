"""The variables of a functional mock-up unit: names, units and roles."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ...errors import ModelError
from ...expr import Expr, Leaf, State, declares, leaves_of, postorder
from ...expr.kinds.inference import Inference, infer_kinds
from ...expr.kinds.kinds import Space
from ...expr.kinds.unit import METRE, ONE, SECOND, Unit, parsed
from ..functions import Functions
from ..labels import linear_places
from .functions import UnitFunctions


@dataclasses.dataclass(frozen=True)
class UnitVariable:
    """A real number that a unit exchanges.

    Attributes:
        name: the name, as in tables of a solution: `V[0]`, `g.qw`, `g.x`, `M[0][1]`.
        unit: the unit; None if unknown.
        reference: its value reference.
        causality, variability: the attributes of FMI.
        start: its start value; None for computed variables.
        limits: (min, max), each None if there is none.
        derivative: the reference of the state whose derivative it is.
    """

    name: str
    unit: Unit | None
    reference: int
    causality: str
    variability: str
    start: float | None = None
    limits: tuple[float | None, float | None] = (None, None)
    derivative: int | None = None


class VariableList:
    """All variables of a system: time, states, their derivatives, controls, parameters, outputs, in this order.

    Args:
        functions: the functions of the compiled system.
        of_unit: the unit's functions of vectors.
        starts: the start vectors of states, controls and parameters.

    Attributes:
        all: the variables; the reference of each is its index.
        states: the number of states.
    """

    def __init__(self, functions: Functions, of_unit: UnitFunctions, starts: Sequence[np.ndarray]) -> None:
        self._functions, self._numbers = functions, of_unit.numbers
        system = functions.system
        rates = {state: system.rates[state.name] for state in system.states}
        roots = {f"rates[{name!r}]": rate for name, rate in system.rates.items()}
        roots |= {f"outputs[{name!r}]": expr for name, expr in system.outputs.items()}
        has_kinds = any(map(declares, postorder(*roots.values())))
        self._known = infer_kinds(roots, rates, list(leaves_of(*roots.values()))) if has_kinds else None
        self._linear = linear_places(system.states, roots.values())
        self.all = [UnitVariable("time", SECOND, 0, "independent", "continuous")]
        x, u, p = starts
        states = [entry for state in functions.states for entry in self._of_state(state)]
        self.states = len(states)
        for (name, unit), start in zip(states, x, strict=True):
            self._add(name, unit, "output", start=float(start))
        for k, (name, unit) in enumerate(states):
            self._add(f"der({name})", None if unit is None else unit / SECOND, "local", derivative=1 + k)
        for leaves, values, causality in ((functions.controls, u, "input"), (functions.parameters, p, "parameter")):
            entries = [(*entry, pair) for leaf in leaves for entry, pair in zip(self._of(leaf), _limits(leaf))]
            for (name, unit, limits), start in zip(entries, values, strict=True):
                self._add(name, unit, causality, start=float(start), limits=limits)
        for name, (expr,) in functions.families["outputs"].items():
            units = self._units(system.outputs[name], None)
            for label, unit in zip(_entry_names(name, expr.shape), units, strict=True):
                self._add(label, unit, "output")
        names = [variable.name for variable in self.all]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ModelError(
                f"to_fmu: two variables would have the name {twice[0]!r}.\n  fix: rename a leaf or an output"
            )

    def _add(self, name: str, unit: Unit | None, causality: str, **more: Any) -> None:
        variability = "tunable" if causality == "parameter" else "continuous"
        self.all.append(UnitVariable(name, unit, len(self.all), causality, variability, **more))

    def _of_state(self, state: State) -> list[tuple[str, Unit | None]]:
        numbers = self._numbers[state.name]
        if not numbers.labels:
            return self._of(state)
        units = [ONE] * 4 + [METRE] * (len(numbers.labels) - 4)
        return [(f"{state.name}.{label}", unit) for label, unit in zip(numbers.labels, units)]

    def _of(self, leaf: Leaf) -> list[tuple[str, Unit | None]]:
        labels = self._functions.system.labels.get(leaf.name)
        units = self._units(leaf, leaf.unit) if labels is None else [_unit_of(text) for _, text in labels]
        return list(zip(_entry_names(leaf.name, leaf.shape), units, strict=True))

    def _units(self, value: Expr, unit: Unit | None) -> list[Unit | None]:
        """The unit of each entry of a value."""
        known: Inference | None = self._known
        unit = known.unit(value) if unit is None and known is not None else unit
        if unit is None:
            return [None] * int(np.prod(value.shape))
        spaces: list[Space | None] = [None] * value.ndim
        if isinstance(value, Leaf) and value.kind is not None:
            spaces = [value.kind.space if length == 6 else None for length in value.shape]
        elif known is not None:
            spaces = known.spaces(value)
        return [self._entry(unit, spaces, place) for place in np.ndindex(*value.shape)]

    def _entry(self, unit: Unit, spaces: Sequence[Space | None], place: Sequence[int]) -> Unit | None:
        """The unit of an entry of a value whose angular part has this unit."""
        for space, k in zip(spaces, place, strict=True):
            if space is None:
                continue
            if self._linear is None:
                return None
            if k in self._linear:
                unit = unit * METRE if space is Space.MOTION else unit / METRE
        return unit


def _unit_of(text: str) -> Unit | None:
    try:
        return parsed("a label", text)
    except ModelError:
        return None


def base_exponents(unit: Unit | None) -> dict[str, int] | None:
    """The exponents of base units by name; None if there is no unit, or if exponents are not whole numbers."""
    if unit is None or any(Fraction(n).denominator != 1 for n in unit.exponents):
        return None
    return {name: int(n) for name, n in zip(("kg", "m", "s", "K"), unit.exponents) if n}


def _entry_names(name: str, shape: tuple[int, ...]) -> list[str]:
    return [name + "".join(f"[{k}]" for k in place) for place in np.ndindex(*shape)]


def _limits(leaf: Leaf) -> list[tuple[float | None, float | None]]:
    """The limits of each entry."""
    size = int(np.prod(leaf.shape))
    sides = [getattr(leaf, side, None) for side in ("min", "max")]
    low, high = ([None] * size if side is None else [_finite(v) for v in np.ravel(side)] for side in sides)
    return list(zip(low, high))


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
