"""The arguments of many cases, and their results: arrays whose first axis counts the cases."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..checks import short
from ..errors import ShapeError, TrajectoryError, TwistaxError
from ..system import name_of
from .result import Optimality, TrajectoryResult, best_result
from .solver import Outcome
from .transcribed import Given, Point
from .watch import Status

if TYPE_CHECKING:
    from .problem import Problem

#: An argument of one case.
Choose = Callable[[int], Any]


class Cases:
    """Splits arguments of `solve_many` into those of each case.

    Attributes:
        count: how many cases there are.

    Raises:
        ShapeError: arguments for different numbers of cases.
        TrajectoryError: none of them has an axis of cases.
    """

    def __init__(self, problem: Problem, given: Mapping[str, Any], final_time: Any) -> None:
        leaves: dict[str, tuple[int, ...]] = {
            leaf.name: leaf.shape for leaf in (*problem.dynamics.states, *problem.dynamics.controls)
        }
        boxes = {box.name for box in problem.border.boxes}
        params = {name: np.shape(value) for name, value in problem.params.items()}
        self._counts: dict[str, int] = {}
        self._chosen: dict[str, Choose] = {}
        for what, own in given.items():
            shapes = params if what == "params" else leaves | params
            extra = {name for name in leaves if what == "guess" and name not in boxes}
            self._chosen[what] = self._of(what, own, shapes, extra)
        free = 1 if problem.border.free[0] else 0
        self._chosen["final_time"] = self._axis("final_time", final_time, free)
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

    def _of(self, what: str, given: Any, shapes: Mapping[str, tuple[int, ...]], longer: set[str]) -> Choose:
        """Of a dict by leaf; `longer` may have an axis of nodes."""
        if not isinstance(given, Mapping):
            return lambda _: given
        own: dict[str, Choose] = {}
        for key, value in given.items():
            name = name_of(key)
            dimensions = len(shapes.get(name, ())) + (name in longer)
            own[name] = self._axis(f"{what}[{name!r}]", value, dimensions)
        return lambda k: {name: choose(k) for name, choose in own.items()}

    def _axis(self, what: str, value: Any, dimensions: int) -> Choose:
        """An argument with so many axes in each case; with one more, the first counts the cases."""
        try:
            shared = value is None or np.ndim(value) <= dimensions
        except ValueError as error:
            raise ShapeError(f"solve_many: {what} expects an array, got {short(value)}: {error}") from None
        if shared:
            return lambda _: value
        if len(value) == 0:
            raise ShapeError(f"solve_many: {what} has no cases, its shape is {np.shape(value)}")
        self._counts[what] = len(value)
        return lambda k: value[k]


def prepared(problem: Problem, cases: Cases) -> tuple[Point, Given, list[dict[str, Array]]]:
    """Where the cases start, what they are solved for (arrays with a leading axis), and their parameters.

    Raises:
        TwistaxError: as `solve` does, with the number of the case.
    """
    found: list[tuple[Point, Given, dict[str, Array]]] = []
    for k in range(cases.count):
        try:
            found.append(problem.started(**cases.case(k)))
        except TwistaxError as error:
            error.args = (f"case {k}: {error}",)
            raise
    stacked = [jax.tree.map(lambda *own: np.stack([np.asarray(a) for a in own]), *side) for side in zip(*found)]
    return stacked[0], stacked[1], [own for *_, own in found]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class TrajectoryResults(Sequence[TrajectoryResult]):
    """The results of many cases: arrays with a leading axis, and by number a `TrajectoryResult` each.

    Attributes:
        status: of every case.
        xs: states by name, (cases, nodes, ...).
        us: controls by name, (cases, intervals, ...), linear ones (cases, nodes, ...).
        final_time, cost, violation, iterations: (cases,).
        optimality: the numbers of an `Optimality` by name, (cases,) each.
        compile_seconds, solve_seconds: wall time.
    """

    problem: Problem
    status: tuple[Status, ...]
    xs: dict[str, Array]
    us: dict[str, Array]
    final_time: Array
    cost: Array
    violation: Array
    iterations: Array
    optimality: dict[str, Array]
    compile_seconds: float
    solve_seconds: float
    _outcomes: Sequence[Outcome]
    _params: Sequence[dict[str, Array]]
    _tolerance: float

    @property
    def solved(self) -> Array:
        """(cases,) whether the status is SOLVED."""
        return np.array([status is Status.SOLVED for status in self.status])

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, case: Any) -> Any:
        if isinstance(case, slice):
            return [self[k] for k in range(len(self))[case]]
        k = range(len(self))[case]
        share = self.solve_seconds / len(self)
        return best_result(self.problem, [self._outcomes[k]], self._params[k], self._tolerance, 0.0, share)

    def __iter__(self) -> Iterator[TrajectoryResult]:
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        parts = []
        for status, count in Counter(self.status).most_common():
            which = [str(k) for k, own in enumerate(self.status) if own is status]
            named = "" if status is Status.SOLVED else f" (case {', '.join([*which[:8], *['...'][: len(which) > 8]])})"
            parts.append(f"{count} {status.name}{named}")
        return f"TrajectoryResults({len(self)} cases: {', '.join(parts)}; solve {self.solve_seconds:.1f} s)"


def results(
    problem: Problem,
    outcomes: Sequence[Outcome],
    params: Sequence[dict[str, Array]],
    tolerance: float,
    compile_seconds: float,
    solve_seconds: float,
) -> TrajectoryResults:
    """What was found of all cases."""
    us = np.stack([np.asarray(o.point.us) for o in outcomes])
    split = problem.shooting.local.controls.split(us)
    every = [problem.restated.us(o.point.xs, {name: a[k] for name, a in split.items()}) for k, o in enumerate(outcomes)]
    names = [field.name for field in dataclasses.fields(Optimality)]
    return TrajectoryResults(
        problem=problem,
        status=tuple(o.status for o in outcomes),
        xs={s.name: np.stack([np.asarray(o.point.xs[s.name]) for o in outcomes]) for s in problem.reduced.states},
        us={name: np.stack([np.asarray(own[name]) for own in every]) for name in every[0]},
        final_time=np.array([float(o.point.border[0]) for o in outcomes]),
        cost=problem.objective.sign * np.array([o.cost for o in outcomes]),
        violation=np.array([o.violation for o in outcomes]),
        iterations=np.array([o.iterations for o in outcomes]),
        optimality=dict(zip(names, np.array([o.errors for o in outcomes]).T, strict=True)),
        compile_seconds=compile_seconds,
        solve_seconds=solve_seconds,
        _outcomes=outcomes,
        _params=params,
        _tolerance=tolerance,
    )
