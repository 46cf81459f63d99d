"""The arguments of many cases, and their results: arrays whose first axis counts the cases."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy import ndarray as Array

from ...checks import short
from ...errors import InputError, ShapeError, TrajectoryError, TwistaxError
from ...system import name_of
from ..transcribed import Point
from ..watch import Status
from .phased import PhasedResult
from .quality import Optimality, Tried, found_params
from .result import TrajectoryResult

if TYPE_CHECKING:
    from ..problem.phases import PhasedProblem
    from ..problem.problem import Problem
    from ..problem.solving import Solvable, Started

One = TypeVar("One")
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

    def __init__(self, axes: Mapping[str, Any], given: Mapping[str, Any]) -> None:
        self._counts: dict[str, int] = {}
        self._chosen = {what: self._of(what, own, axes.get(what)) for what, own in given.items()}
        if not self._counts:
            raise TrajectoryError(
                "solve_many: no argument has an axis of cases; e.g. initial={state: array of (cases, *shape)}"
            )
        self.count = next(iter(self._counts.values()))
        if len(set(self._counts.values())) > 1:
            told = ", ".join(f"{name} has {count}" for name, count in self._counts.items())
            raise ShapeError(f"solve_many expects as many cases in every argument: {told}")

    def case(self, k: int) -> dict[str, Any]:
        """The arguments of one."""
        return {name: choose(k) for name, choose in self._chosen.items()}

    def _of(self, what: str, given: Any, axes: Any) -> Choose:
        """What has so many axes, or is a dict of what has; what is not known is the same in all cases."""
        if isinstance(axes, int):
            return self._axis(what, given, axes)
        if not isinstance(given, Mapping) or axes is None:
            return lambda _: given
        own: dict[Any, Choose] = {}
        for key, value in given.items():
            name = name_of(key)
            own[name] = self._of(f"{what}[{name!r}]", value, axes.get(name, 0))
        return lambda k: {name: choose(k) for name, choose in own.items()}

    def _axis(self, what: str, value: Any, dimensions: int) -> Choose:
        """An argument with so many axes in each case; with one more, the first counts the cases."""
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
    problem: Solvable[Any, Any], cases: Cases, sizes: Callable[[int], Any] | None = None
) -> list[Started | TwistaxError]:
    """What each case starts from and is for; the error of a case whose arguments do not fit the problem.

    Args:
        sizes: as `Solvable.started` takes them, by the number of the case.

    Raises:
        TwistaxError: no case fits: that of the first, with its number.
    """
    found: list[Started | TwistaxError] = []
    for k in range(cases.count):
        try:
            found.append(problem.started(**cases.case(k), sizes=None if sizes is None else sizes(k)))
        except TwistaxError as error:
            error.args = (f"case {k}: {error}",)
            found.append(error)
    if isinstance(found[0], TwistaxError) and all(isinstance(case, TwistaxError) for case in found):
        raise found[0]
    return found


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Results(Sequence[One], Generic[One]):
    """The results of many cases: arrays with a leading axis, and by number a result each.

    Attributes:
        status: of every case.
        final_time, cost, violation, iterations: (cases,).
        params: by name, (cases, ...), the parameters that were found among them.
        optimality: the numbers of an `Optimality` by name, (cases,) each.
        compile_seconds, solve_seconds: wall time.
    """

    problem: Any
    status: tuple[Status, ...]
    final_time: Array
    cost: Array
    violation: Array
    iterations: Array
    params: dict[str, Array]
    optimality: dict[str, Array]
    compile_seconds: float
    solve_seconds: float
    _tried: Sequence[Tried]

    @property
    def solved(self) -> Array:
        """(cases,) whether the status is SOLVED."""
        return np.array([status is Status.SOLVED for status in self.status])

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, case: Any) -> Any:
        if isinstance(case, slice):
            return [self[k] for k in range(len(self))[case]]
        try:
            k = range(len(self))[case]
        except (IndexError, TypeError):
            raise InputError(f"results have the cases 0 to {len(self) - 1}, got {short(case)}") from None
        return self.problem.result(self._tried[k])

    def __iter__(self) -> Iterator[One]:
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        parts = []
        for status, count in Counter(self.status).most_common():
            which = [str(k) for k, own in enumerate(self.status) if own is status]
            named = "" if status is Status.SOLVED else f" (case {', '.join([*which[:8], *['...'][: len(which) > 8]])})"
            parts.append(f"{count} {status.name}{named}")
        return f"{type(self).__name__}({len(self)} cases: {', '.join(parts)}; solve {self.solve_seconds:.1f} s)"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class TrajectoryResults(Results[TrajectoryResult]):
    """The results of many cases; see `Results`.

    Attributes:
        xs: states by name, (cases, nodes, ...).
        us: controls by name, (cases, intervals, ...), linear ones (cases, nodes, ...).
    """

    xs: dict[str, Array]
    us: dict[str, Array]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class PhasedResults(Results[PhasedResult]):
    """The results of many cases of phases; see `Results`.

    Attributes:
        xs: by phase and state, (cases, nodes, ...).
        us: by phase and control, (cases, intervals, ...), linear ones (cases, nodes, ...).
        durations: by phase, (cases,).
    """

    xs: dict[str, dict[str, Array]]
    us: dict[str, dict[str, Array]]
    durations: dict[str, Array]


def trajectory_results(problem: Problem, tried: Sequence[Tried]) -> TrajectoryResults:
    """What was found of all cases."""
    points = [own.best.point for own in tried]
    return TrajectoryResults(**_fields(problem, tried) | _states_and_controls(problem, points))


def phased_results(problem: PhasedProblem, tried: Sequence[Tried]) -> PhasedResults:
    """What was found of all cases."""
    found = [
        _states_and_controls(part, [segment.of(own.best.point) for own in tried])
        for part, segment in zip(problem.parts, problem.shooting.segments)
    ]
    by_phase: dict[str, Any] = {key: dict(zip(problem.names, [own[key] for own in found])) for key in ("xs", "us")}
    times = np.array([np.asarray(own.best.point.border)[: len(problem.names)] for own in tried])
    return PhasedResults(**_fields(problem, tried) | by_phase, durations=dict(zip(problem.names, times.T)))


def _states_and_controls(problem: Problem, points: Sequence[Point]) -> dict[str, dict[str, Array]]:
    split, names = problem.shooting.local.controls.split, [s.name for s in problem.reduced.states]
    us = [problem.restated.us(point.xs, split(np.asarray(point.us))) for point in points]
    return {
        "xs": {name: np.stack([np.asarray(point.xs[name]) for point in points]) for name in names},
        "us": {name: np.stack([np.asarray(own[name]) for own in us]) for name in us[0]},
    }


def _fields(problem: Solvable[Any, Any], tried: Sequence[Tried]) -> dict[str, Any]:
    """The fields of `Results`."""
    outcomes, phases = [own.best for own in tried], problem.border.phases
    params = [found_params(problem.border, own.best, own.params) for own in tried]
    names = [field.name for field in dataclasses.fields(Optimality)]
    return {
        "problem": problem,
        "status": tuple(o.status for o in outcomes),
        "final_time": np.array([float(np.asarray(o.point.border)[:phases].sum()) for o in outcomes]),
        "cost": problem.sign * np.array([o.cost for o in outcomes]),
        "violation": np.array([o.violation for o in outcomes]),
        "iterations": np.array([o.iterations for o in outcomes]),
        "params": {name: np.stack([own[name] for own in params]) for name in params[0]},
        "optimality": dict(zip(names, np.array([o.errors for o in outcomes]).T, strict=True)),
        "compile_seconds": sum(own.compile_seconds for own in tried),
        "solve_seconds": sum(own.solve_seconds for own in tried),
        "_tried": tried,
    }
