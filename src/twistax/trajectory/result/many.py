"""The results of many cases, as arrays whose first axis is that of the cases."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import short
from ...errors import InputError
from ..strategy.status import Status
from ..transcription.iterate import Iterate
from .quality import Attempts, Optimality, params_of
from .result import TrajectoryResult, best_result


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class TrajectoryResults(Sequence[TrajectoryResult]):
    """The results of many cases as arrays with a leading axis of cases; an index returns the result of one case.

    Attributes:
        status: a list with the status of every case.
        final_time, cost, violation, iterations: (cases,).
        params: by name, (cases, ...), including optimal free parameters.
        optimality: the attributes of an `Optimality` by name, each (cases,).
        compile_seconds, solve_seconds: wall time.
        xs: states by name, (cases, nodes, ...); for several phases, dicts by the name of the phase.
        us: controls by name, (cases, intervals, ...), continuous ones (cases, nodes, ...); for several phases, dicts by
            the name of the phase.
        durations: (cases,) by the name of the phase.
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
    xs: dict[str, Any]
    us: dict[str, Any]
    durations: dict[str, Array]
    _tried: Sequence[Attempts]

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
            raise InputError(f"the index of a case must be from 0 to {len(self) - 1}, got {short(case)}") from None
        return best_result(self.problem, self._tried[k])

    def __iter__(self) -> Iterator[TrajectoryResult]:
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        parts = []
        for status, count in Counter(self.status).most_common():
            which = [str(k) for k, status_of in enumerate(self.status) if status_of is status]
            named = "" if status is Status.SOLVED else f" (case {', '.join([*which[:8], *['...'][: len(which) > 8]])})"
            parts.append(f"{count} {status.name}{named}")
        return f"{type(self).__name__}({len(self)} cases: {', '.join(parts)}; solve {self.solve_seconds:.1f} s)"


class PhasedResults(TrajectoryResults):
    """The results of many cases of a problem of several phases: `xs[phase][state]` is (cases, nodes, ...); see
    `TrajectoryResults`.
    """


def many_results(problem: Any, tried: Sequence[Attempts]) -> TrajectoryResults:
    """The results of all cases."""
    outcomes = [case.best for case in tried]
    params = [params_of(problem.border, case.best, case.params) for case in tried]
    durations = np.array([np.asarray(o.point.border)[: len(problem.names)] for o in outcomes])
    names = [field.name for field in dataclasses.fields(Optimality)]
    pairs = zip(problem.parts, problem.shooting.segments)
    phases = [_states_and_controls(part, [segment.of(o.point) for o in outcomes]) for part, segment in pairs]
    xs, us = zip(*phases)
    return (TrajectoryResults if problem.alone else PhasedResults)(
        problem=problem,
        status=tuple(o.status for o in outcomes),
        final_time=durations.sum(axis=1),
        cost=problem.sign * np.array([o.cost for o in outcomes]),
        violation=np.array([o.violation for o in outcomes]),
        iterations=np.array([o.iterations for o in outcomes]),
        params={name: np.stack([values[name] for values in params]) for name in params[0]},
        optimality=dict(zip(names, np.array([o.errors for o in outcomes]).T, strict=True)),
        compile_seconds=sum(case.compile_seconds for case in tried),
        solve_seconds=sum(case.solve_seconds for case in tried),
        xs=xs[0] if problem.alone else dict(zip(problem.names, xs)),
        us=us[0] if problem.alone else dict(zip(problem.names, us)),
        durations=dict(zip(problem.names, durations.T)),
        _tried=tried,
    )


def _states_and_controls(part: Any, points: Sequence[Iterate]) -> tuple[dict[str, Array], dict[str, Array]]:
    split = part.shooting.local.controls.split
    xs, us = zip(*(part.seen(point.xs, split(np.asarray(point.us))) for point in points))
    return (
        {name: np.stack([np.asarray(values[name]) for values in xs]) for name in xs[0]},
        {name: np.stack([np.asarray(values[name]) for values in us]) for name in us[0]},
    )
