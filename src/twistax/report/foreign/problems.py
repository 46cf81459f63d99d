"""The problems by the names that `--only` accepts: those of `problems.toml`, and those whose formulas need loops."""

import functools
import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import CodeType
from typing import Any

from .chains import CHAIN, HEAT
from .larger import BIPED, DELTA_III
from .statement import Foreign, Phased, Points, RungeKutta, Var

_IN_PYTHON: Mapping[str, Foreign | Phased] = {"delta_iii": DELTA_III, "biped": BIPED, "chain": CHAIN, "heat": HEAT}

Formula = Callable[[Any, Any], Any]


class _Names(dict[str, Any]):
    """Values by name; intermediate formulas and functions are looked up when a formula reads them."""

    def __init__(self, values: Mapping[str, Any], maths: Any, let: Mapping[str, str]) -> None:
        super().__init__(values)
        self._maths, self._let = maths, let

    def __missing__(self, name: str) -> Any:
        if name not in self._let:
            return getattr(self._maths, name)
        self[name] = self.value(self._let[name])
        return self[name]

    def value(self, formula: str | float) -> Any:
        """The value of a formula; a number is its own value."""
        return eval(_code(formula), {"__builtins__": {}}, self) if isinstance(formula, str) else formula


@functools.cache
def _code(formula: str) -> CodeType:
    return compile(f"({formula})", formula, "eval")  # in parentheses lines may break


def _problem(entry: dict[str, Any]) -> Foreign:
    """A problem as its table in `problems.toml` states it."""
    constants = _Names({}, math, {})
    for name, text in entry.pop("constants", {}).items():
        constants[name] = constants.value(text)
    number, let = constants.value, entry.pop("let", {})

    def formula(text: str) -> Formula:
        return lambda bag, maths: names(bag, maths).value(text)

    def formulas(texts: list[str]) -> Callable[..., list[Any]]:
        return lambda bag, maths, first=None: list(map(names(bag, maths).value, texts))

    def names(bag: Any, maths: Any) -> _Names:
        return _Names({"pi": math.pi} | constants | vars(bag), maths, let)

    def by_share(text: str) -> Callable[[Any], Any]:
        return lambda share: _Names(constants | {"s": share, "abs": abs}, math, {}).value(text)

    def variable(entry: dict[str, Any]) -> Var:
        low, high = map(number, entry.get("limits", (-math.inf, math.inf)))
        ends = {end: number(entry[end]) for end in ("start", "end") if end in entry}
        guess = entry.get("guess")
        if isinstance(guess, str):
            guess = by_share(guess)
        return Var(low, high, guess=guess, **ends)

    def path(rows: dict[str, Any]) -> Formula:
        limits = {name: (number(low), text, number(high)) for name, (low, text, high) in rows.items()}
        return lambda bag, maths: {n: (low, formula(text)(bag, maths), high) for n, (low, text, high) in limits.items()}

    rule, nodes = entry.pop("rule", {}), entry.pop("nodes", None)
    if isinstance(nodes, str):
        nodes = [by_share(nodes)(k / entry["intervals"]) for k in range(entry["intervals"] + 1)]
    final_time = entry.pop("final_time")
    rates = formulas([state["rate"] for state in entry["states"].values()])
    for group in ("states", "controls", "free"):
        entry[group] = {name: variable(var) for name, var in entry.get(group, {}).items()}
    for name in {"running", "cost"} & set(entry):
        entry[name] = formula(entry[name])
    return Foreign(
        rates=rates,
        path=path(entry.pop("path")) if "path" in entry else None,
        ends=formulas(entry.pop("ends")) if "ends" in entry else None,
        final_time=tuple(map(number, final_time)) if isinstance(final_time, list) else number(final_time),
        rule=Points(**rule) if "points" in rule else RungeKutta(**rule),
        nodes=nodes and list(map(number, nodes)),
        published=number(entry.pop("published")) if "published" in entry else None,
        **entry,
    )


def _all() -> dict[str, Foreign | Phased]:
    entries = tomllib.loads(Path(__file__).with_name("problems.toml").read_text())
    return {
        name: _IN_PYTHON[name] if "written_in_python" in entry else _problem(entry) for name, entry in entries.items()
    }


FOREIGN: dict[str, Foreign | Phased] = _all()
