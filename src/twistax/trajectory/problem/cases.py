"""The arguments of many cases of a problem, split into those of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...checks import short
from ...errors import ShapeError, TrajectoryError, TwistaxError
from ...system import name_of
from .start import Started

#: An argument of one case.
Choose = Callable[[int], Any]


class Cases:
    """Splits arguments of `solve_many` into those of each case.

    Args:
        axes: how many axes an argument has in one case, in dicts as the arguments are.
        given: the arguments.

    Attributes:
        count: how many cases there are.

    Raises:
        ShapeError: arguments for different numbers of cases.
        TrajectoryError: none of them has an axis of cases.
    """

    def __init__(self, axes: Mapping[str, Any], arguments: Mapping[str, Any]) -> None:
        self._counts: dict[str, int] = {}
        self._chosen = {what: self._of(what, value, axes.get(what)) for what, value in arguments.items()}
        if not self._counts:
            raise TrajectoryError(
                "solve_many: no argument has an axis of cases; e.g. initial={state: array of (cases, *shape)}"
            )
        self.count = next(iter(self._counts.values()))
        if len(set(self._counts.values())) > 1:
            counts = ", ".join(f"{name} has {count}" for name, count in self._counts.items())
            raise ShapeError(f"solve_many expects as many cases in every argument: {counts}")

    def case(self, k: int) -> dict[str, Any]:
        """The arguments of one case."""
        return {name: choose(k) for name, choose in self._chosen.items()}

    def _of(self, what: str, value: Any, axes: Any) -> Choose:
        """How to choose an argument of a case: an array with so many axes, or a dict of such arrays."""
        if isinstance(axes, int):
            return self._axis(what, value, axes)
        if not isinstance(value, Mapping) or axes is None:
            return lambda _: value
        choices: dict[Any, Choose] = {}
        for key, entry in value.items():
            name = name_of(key)
            choices[name] = self._of(f"{what}[{name!r}]", entry, axes.get(name, 0))
        return lambda k: {name: choose(k) for name, choose in choices.items()}

    def _axis(self, what: str, value: Any, dimensions: int) -> Choose:
        """How to choose an array of a case: with one axis more than `dimensions`, the first one counts the cases."""
        try:
            shared = value is None or isinstance(value, Mapping) or np.ndim(value) <= dimensions
        except ValueError as error:
            raise ShapeError(f"solve_many: {what} expects an array, got {short(value)}: {error}") from None
        if shared:
            return lambda _: value
        if len(value) == 0:
            raise ShapeError(f"solve_many: {what} has no cases, its shape is {np.shape(value)}")
        self._counts[what] = len(value)
        return lambda k: value[k]


def started_cases(
    problem: Any, cases: Cases, sizes: Callable[[int], Any] | None = None
) -> list[Started | TwistaxError]:
    """What each case starts from and is for; the error of a case whose arguments do not fit the problem.

    Args:
        sizes: as `Problem.started` takes them, by the number of the case.

    Raises:
        TwistaxError: no case fits: that of the first, with its number.
    """
    started: list[Started | TwistaxError] = []
    for k in range(cases.count):
        try:
            started.append(problem.started(**cases.case(k), sizes=None if sizes is None else sizes(k)))
        except TwistaxError as error:
            error.args = (f"case {k}: {error}",)
            started.append(error)
    if isinstance(started[0], TwistaxError) and all(isinstance(case, TwistaxError) for case in started):
        raise started[0]
    return started
