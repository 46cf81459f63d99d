"""A DAVE-ML file as expressions by variable."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import jax
import numpy as np

from ....checks import listed, number, path_of
from ....errors import ModelError, TwistaxError
from ....expr import Constant, Expr, State, to_expr
from ....expr.fields import ExprLike
from ....jax_inside import in_double
from ....system.lower import lower
from ..xml_file import Element, read_xml
from .functions import FunctionReader, by_id, needed
from .mathml import Calculation, names_in
from .static_checks import StaticCheck, read_shots
from .tables import limited

#: Marks of a variable whose value is an input.
_GIVEN = ("isInput", "isControl", "isDisturbance", "isState")
#: The elements allowed under the root. Other elements would change the meaning of the file.
_KNOWN = {
    "fileHeader", "variableDef", "breakpointDef", "griddedTableDef", "ungriddedTableDef", "function", "checkData",
    "provenance", "description", "reference",
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Signal:
    """A variable of a file.

    Attributes:
        name, units, sign, description: as in the file; empty if missing.
        initial: its `initialValue`, None if there is none.
        minimum, maximum: limits to which the value is clipped; None for no limit.
        place: file, line and element, for messages.
    """

    name: str
    units: str
    sign: str
    description: str
    initial: float | None
    minimum: float | None
    maximum: float | None
    place: str


@dataclasses.dataclass(frozen=True)
class _Rule:
    """The calculation of a variable from other variables."""

    needs: tuple[str, ...]
    build: Callable[[Mapping[str, Expr]], Expr]


class DaveModel:
    """The model of a DAVE-ML file (ANSI/AIAA S-119), as expressions.

        aero = load_daveml("F16_aero.dml")
        aero.inputs                       # {'vt': Signal(name='trueAirspeed', units='ft_s', ...), ...}
        c = aero(vt=speed / feet, alpha=alpha / degrees, ...)
        c["cx"]                           # an expression
        aero.check()                      # the file's own check-cases

    Attributes:
        name: the name in the file's header.
        variables: every variable by varID, as `Signal`.
        inputs: the variables that are marked as inputs, or that have neither a calculation, a table nor an initial
            value.
        outputs: the variables that are marked as outputs; if there are none, those that no other variable depends on.
    """

    def __init__(self, root: Element) -> None:
        header = root.first("fileHeader")
        self.name: str = "" if header is None else header.attributes.get("name", "")
        for child in root.children:
            if child.tag not in _KNOWN:
                raise child.wrong(
                    f"is not supported; elements of DAVE-ML are {', '.join(sorted(_KNOWN))} under <{root.tag}>"
                )
        self._root = root
        elements = by_id(root.all("variableDef"), "varID")
        if not elements:
            raise root.wrong("expected <variableDef> elements")
        self.variables: dict[str, Signal] = {name: _signal(element) for name, element in elements.items()}
        self._rules = self._read_rules(elements)
        self._order = _sorted(self._rules, elements)
        self.inputs: dict[str, Signal] = {
            name: self.variables[name]
            for name, element in elements.items()
            if name not in self._rules and (_marked(element, _GIVEN) or self.variables[name].initial is None)
        }
        used = {need for rule in self._rules.values() for need in rule.needs}
        chosen = [name for name, element in elements.items() if _marked(element, ("isOutput",))]
        chosen = chosen or [name for name in elements if name not in used and name not in self.inputs]
        self.outputs: dict[str, Signal] = {name: self.variables[name] for name in chosen}
        self._leaves = {name: State(f"input{i}") for i, name in enumerate(self.inputs)}
        self._built = self._build(
            self._leaves, self.variables
        )  # at this point, so that an invalid file is refused early
        self._shots = read_shots(root, {name: (one.name, one.units) for name, one in self.variables.items()})

    def __repr__(self) -> str:
        return (
            f"<DaveModel {self.name!r}: {len(self.inputs)} inputs, {len(self.outputs)} outputs, "
            f"{len(self.variables)} variables>"
        )

    def __call__(
        self,
        inputs: Mapping[str, ExprLike] | None = None,
        /,
        *,
        outputs: Iterable[str] | None = None,
        **named: ExprLike,
    ) -> dict[str, Expr]:
        """Outputs as expressions of the inputs, by varID.

        Args:
            inputs, named: scalars by varID, in the file's units: expressions, leaves or numbers. A value for another
                variable replaces the variable's calculation, for example a `Parameter` in place of a constant. All
                values are clipped to the limits of the file.
            outputs: varIDs of the outputs, which may be any variables; by default those of `self.outputs`.
        Raises:
            ModelError: an input that is missing, unknown, repeated or not a scalar; an unknown output.
        """
        twice = sorted(set(inputs or {}) & set(named))
        if twice:
            raise ModelError(f"{self.name}: {listed(twice)} given twice")
        arguments = {**(inputs or {}), **named}
        wanted = list(self.outputs if outputs is None else outputs)
        for name in [*arguments, *wanted]:
            if name not in self.variables:
                raise ModelError(
                    f"{self.name}: there is no variable {name!r}; there are {listed(self.variables, name)}"
                )
        values = {name: to_expr(value) for name, value in arguments.items()}
        for name, value in values.items():
            if value.shape != ():
                raise ModelError(f"{self.name}: {name} expects a scalar, got shape {value.shape}")
        built = self._build(values, wanted)
        return {name: built[name] for name in wanted}

    def values(
        self, inputs: Mapping[str, float] | None = None, /, *, outputs: Iterable[str] | None = None, **named: float
    ) -> dict[str, float]:
        """Outputs as numbers, in double precision, by varID. Arguments and errors are those of a call of the model,
        with numbers.

        Raises: ModelError, in addition, for an input or an output that is not a finite number.
        """
        for name, value in {**(inputs or {}), **named}.items():
            number(f"{self.name}: {name}", value, "a finite number", np.isfinite, ModelError)
        with in_double():
            results = lower(self(inputs, outputs=outputs, **named))(0.0)
        values = {name: float(value) for name, value in results.items()}
        not_finite = [name for name, value in values.items() if not np.isfinite(value)]
        if not_finite:
            raise ModelError(
                f"{self.name}: {listed(not_finite)} have no finite value at these inputs, got {values[not_finite[0]]!r}"
            )
        return values

    def check(self) -> list[StaticCheck]:
        """Run the static check-cases of the file, in double precision. Inputs that a case omits have their initial
        values.

        Returns: a `StaticCheck` for every output of every case; an empty list if the file has no cases.
        Raises:
            ModelError: the errors of outputs exceed their tolerances; the message names these outputs, and the first
                wrong internal value of the case. Also if a case omits an input without an initial value, or has a value
                for a variable that is not an input.
        """
        if not self._shots:
            return []
        computed = self._at_shots()
        checks = [
            StaticCheck(shot.name, name, value.value, value.tolerance, computed[name][i], value.element.place)
            for i, shot in enumerate(self._shots)
            for name, value in shot.outputs.items()
        ]
        wrong = [check for check in checks if not check.holds]
        if wrong:
            off = "\n  ".join(
                f"{check.place}: {check.output} of {check.shot!r} is {check.found!r}, expected {check.expected!r} "
                f"within {check.tolerance}{self._first_off(check.shot, computed)}"
                for check in wrong[:10]
            )
            raise ModelError(f"{self.name}: {len(wrong)} of {len(checks)} static checks fail:\n  {off}")
        return checks

    # ---- reading ---------------------------------------------------------------------------------------------------

    def _read_rules(self, elements: Mapping[str, Element]) -> dict[str, _Rule]:
        rules: dict[str, _Rule] = {}
        for name, element in elements.items():
            calculations = element.all("calculation")
            if len(calculations) > 1:
                raise calculations[1].wrong("has more than one calculation")
            for calculation in calculations:
                rules[name] = _calculated(needed(calculation, "math"), elements)
        for function in FunctionReader(self._root).all:
            for axis in function.axes:
                if axis.variable not in elements:
                    raise axis.element.wrong(_unknown(axis.variable, elements))
            if function.output not in elements:
                raise function.element.wrong(_unknown(function.output, elements))
            if function.output in rules:
                raise function.element.wrong(f"varID {function.output!r} has another table or calculation already")
            rules[function.output] = _Rule(tuple(axis.variable for axis in function.axes), function)
        return rules

    # ---- building --------------------------------------------------------------------------------------------------

    def _build(self, arguments: Mapping[str, Expr], wanted: Iterable[str]) -> dict[str, Expr]:
        """The requested variables, and those that they need, as expressions."""
        required, pending = set[str](), list(wanted)
        while pending:
            name = pending.pop()
            if name not in required:
                required.add(name)
                pending += self._rules[name].needs if name in self._rules and name not in arguments else ()
        missing = [name for name in self.inputs if name in required and name not in arguments]
        if missing:
            questions = "; ".join(self._asked(name) for name in missing)
            raise ModelError(f"{self.name}: {len(missing)} inputs are missing: {questions}")
        built: dict[str, Expr] = {}
        for name in (name for name in self._order if name in required):
            signal = self.variables[name]
            if name in arguments:
                value = arguments[name]
            elif name in self._rules:
                try:
                    value = self._rules[name].build(built)
                except TwistaxError as error:
                    raise error if ", line " in str(error) else ModelError(f"{signal.place}: {error}") from None
            else:
                value = Constant(signal.initial)
            built[name] = limited(value, signal.minimum, signal.maximum)
        return built

    def _asked(self, name: str) -> str:
        signal = self.variables[name]
        initial = "" if signal.initial is None else f", initially {signal.initial:g}"
        return f"{name} ({signal.name}, {signal.units or 'no units'}{initial})"

    # ---- checking --------------------------------------------------------------------------------------------------

    def _at_shots(self) -> dict[str, list[float]]:
        """The values of every variable at the inputs of all static shots."""
        columns: dict[str, list[float]] = {name: [] for name in self.inputs}
        for shot in self._shots:
            for name, given_value in shot.inputs.items():
                if name not in self.inputs and given_value.value != self.variables[name].initial:
                    raise given_value.element.wrong(
                        f"sets {name!r} to {given_value.value:g}, but {name!r} is not an input"
                    )
            for name, signal in self.inputs.items():
                value = shot.inputs[name].value if name in shot.inputs else signal.initial
                if value is None:
                    raise self._root.wrong(f"the static shot {shot.name!r} does not give the input {name!r}")
                columns[name].append(value)
        with in_double():
            states = {self._leaves[name].name: np.array(column) for name, column in columns.items()}
            computed = jax.vmap(lambda x: lower(self._built)(0.0, x))(states) if states else lower(self._built)(0.0)
            return {name: np.broadcast_to(v, len(self._shots)).tolist() for name, v in computed.items()}

    def _first_off(self, shot_name: str, computed: Mapping[str, list[float]]) -> str:
        """A text that names the first wrong internal value of a shot, in the order of the calculation."""
        i, shot = next((i, shot) for i, shot in enumerate(self._shots) if shot.name == shot_name)
        for name in self._order:
            if name in shot.internal:
                expected = shot.internal[name].value
                if abs(computed[name][i] - expected) > 1e-6 * max(1.0, abs(expected)):
                    return f"; its internal value {name} is {computed[name][i]!r}, expected {expected!r}"
        return ""


def load_daveml(path: str | Path) -> DaveModel:
    """The model of the DAVE-ML file (ANSI/AIAA S-119-2011, DAVE-ML 1.9 to 2.0) at a path.

    Supported features are variables with limits and initial values, calculations in MathML, gridded tables, ungridded
    tables whose points form a grid, linear and step interpolation, and static checks. A document type may be declared
    and is not opened. Nothing is downloaded, and nothing in the file is executed.

    Raises: ModelError with file, line and element.
    """
    root = read_xml(path_of("load_daveml: path", path), "load_daveml", document_type=True)
    if root.tag != "DAVEfunc":
        raise root.wrong("load_daveml expects DAVE-ML, whose root is <DAVEfunc>")
    return DaveModel(root)


def _signal(element: Element) -> Signal:
    text = {name: element.attributes.get(name, "").strip() for name in ("name", "units", "sign")}
    description = element.first("description")
    words = "" if description is None else " ".join(description.content.split())
    initial = element.number("initialValue") if "initialValue" in element.attributes else None
    lower, upper = element.limits("minValue", "maxValue")
    return Signal(text["name"], text["units"], text["sign"], words, initial, lower, upper, element.place)


def _marked(element: Element, marks: Iterable[str]) -> bool:
    return any(element.first(mark) is not None for mark in marks)


def _calculated(math: Element, elements: Mapping[str, Element]) -> _Rule:
    names = names_in(math)
    for name in names:
        if name.content.strip() not in elements:
            raise name.wrong(_unknown(name.content.strip(), elements))
    return _Rule(
        tuple(name.content.strip() for name in names),
        lambda variables: Calculation(lambda ci: variables[ci.content.strip()])(math),
    )


def _unknown(name: str, known: Iterable[str]) -> str:
    return f"varID {name!r} is not defined; there are {listed(known, name)}"


def _sorted(rules: Mapping[str, _Rule], elements: Mapping[str, Element]) -> list[str]:
    """The variables in an order in which each follows those that it needs. Raises ModelError for a cycle."""
    order: dict[str, None] = {}
    for first in elements:
        stack, ancestors = [(first, False)], dict[str, None]()
        while stack:
            name, finished = stack.pop()
            if finished:
                order[name] = None
                del ancestors[name]
            elif name in ancestors:
                raise elements[name].wrong(f"depends on itself: {' <- '.join([*ancestors, name])}")
            elif name not in order:
                ancestors[name] = None
                stack.append((name, True))
                stack += [(need, False) for need in (rules[name].needs if name in rules else ())]
    return list(order)
