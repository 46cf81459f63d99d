"""The arguments of `solve_many`, split into the arguments of each case."""

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
    """Splits the arguments of `solve_many` by case.

    Args:
        axes: the number of axes of each argument in one case, in dicts of the arguments' structure.
        given: the arguments of `solve_many`.

    Attributes:
        count: the number of cases.

    Raises:
        ShapeError: arguments for different numbers of cases.
        TrajectoryError: no argument has an axis of cases.
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
            raise ShapeError(f"solve_many expects the same number of cases in every argument, got {counts}")

    def case(self, k: int) -> dict[str, Any]:
        """The arguments of one case."""
        return {name: choose(k) for name, choose in self._chosen.items()}

    def _of(self, what: str, value: Any, axes: Any) -> Choose:
        """A function that selects one case of an argument: an array with this number of axes, or a
        dict of such arrays.
        """
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
        """A function that selects one case of an array: with one axis more than `dimensions`, the first axis is that of
        the cases.
        """
        try:
            shared = value is None or isinstance(value, Mapping) or np.ndim(value) <= dimensions
        except ValueError as error:
            raise ShapeError(f"solve_many: {what} expects numbers or arrays, got {short(value)}: {error}") from None
        if shared:
            return lambda _: value
        if len(value) == 0:
            raise ShapeError(f"solve_many: {what} has no cases, its shape is {np.shape(value)}")
        self._counts[what] = len(value)
        return lambda k: value[k]


def started_cases(
    problem: Any, cases: Cases, sizes: Callable[[int], Any] | None = None
) -> list[Started | TwistaxError]:
    """The starts and the data of all cases, with the error of each case whose arguments do not fit the problem.

    Args:
        sizes: as in `Problem.started`, by the index of the case.

    Raises:
        TwistaxError: no case is valid; the error is that of the first case, with its index.
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
