"""What an optimisation gives back, and the rollout of the controls it found, densely and with any method."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..checks import whole
from ..errors import TrajectoryError
from ..integrators import RKMK, FirstOrderHold, ZeroOrderHold
from ..integrators.tableaus import RK4
from ..precision import in_double
from .border import Border
from .replay import Replay, replayed
from .solver import Outcome
from .statement import largest_by_name, violations
from .transcribed import Point, Transcribed
from .warm import WarmStart
from .watch import Status

if TYPE_CHECKING:
    from .phased_result import PhasedResult
    from .problem import Problem


#: A scaled multiplier above this is one of an active constraint.
_ACTIVE = 1e-5


@dataclasses.dataclass(frozen=True)
class Optimality:
    """How far a trajectory is from the first-order conditions of an optimum, in scaled form.

    Unknowns count in units of how far they move along the trajectory, the objective in units of what that does to it.

    Attributes:
        stationarity: largest entry of the gradient of the Lagrangian.
        feasibility: largest residual of the dynamics and of a constraint.
        complementarity: largest product of a slack and its multiplier.
        gap: what slacks, and the residuals that are left, can change of the objective: the sum of |multiplier times
            slack or residual|.
    """

    stationarity: float
    feasibility: float
    complementarity: float
    gap: float


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """States and controls of a problem, or of one phase of it. All arrays are NumPy, double precision.

    Attributes:
        xs: states by name, leading axis the nodes.
        us: controls by name, leading axis the intervals for held ones, the nodes for linear ones.
        ts: (nodes,) times in s.
        final_time: the last of them.
        params: the parameters it was solved for, and those that were found.
        added: what `Integral` and `Initial` became, states by name.
    """

    problem: Problem
    xs: dict[str, Array]
    us: dict[str, Array]
    ts: Array
    final_time: float
    params: dict[str, Array]
    added: dict[str, Array]

    @property
    def controls(self) -> dict[str, ZeroOrderHold | FirstOrderHold]:
        """The controls over time, as `tx.integrate(u=...)` takes them."""
        return {
            name: FirstOrderHold(self.ts, values)
            if len(values) == len(self.ts)
            else ZeroOrderHold(self.ts[:-1], values)
            for name, values in self.us.items()
        }

    @property
    def integrals(self) -> dict[str, Array]:
        """`Integral(...)` -> from the beginning until each node."""
        return {name: self.added[name] for name in self.problem.reduced.integrals}

    @functools.cached_property
    def _dense(self) -> Replay:
        return self.replay()

    @property
    def extremes(self) -> dict[str, float]:
        """`Maximum(...)`, `Minimum(...)` -> that value along a dense rollout."""
        return self._dense.extremes

    @property
    def between_nodes(self) -> dict[str, float]:
        """Name of a path constraint or box -> its largest violation along a dense rollout, in its own unit."""
        return self._dense.violations

    @functools.cached_property
    def mesh_error(self) -> dict[str, dict[str, float]]:
        """State name -> how far a rollout in ten times as many steps ends from the planned final node."""
        return self.replay(steps=10 * self.problem.transcription.substeps).misses

    def replay(self, method: Any = None, steps: int = 20, *, rtol: float = 1e-10, atol: float = 1e-10) -> Replay:
        """Roll out the found controls from the first node, and measure what comes out.

        Args:
            method: an RKMK method, RK4 if left out; or a diffrax solver, which integrates the same system as a plain
                ODE in quaternions with adaptive steps.
            steps: samples an interval, and for an RKMK method its steps there.
            rtol, atol: tolerances of a diffrax solver.
        Raises:
            TrajectoryError: steps is no positive whole number.
            InputError: method is neither.
            IntegrationError: the rollout did not reach its end.
        """
        whole("steps", steps, 1, TrajectoryError)
        with in_double():
            return replayed(self, RKMK(RK4) if method is None else method, steps, rtol, atol)


@dataclasses.dataclass(frozen=True)
class TrajectoryResult(Trajectory):
    """A trajectory and how well it solves its problem. All arrays are NumPy, double precision.

    Attributes:
        xs, us, ts, final_time, params, added: see `Trajectory`.
        cost: the objective as stated (a maximum is not negated).
        violation: the largest violation of a constraint, each measured in its own scale; 0 where all hold.
        violations: row name -> largest violation at the nodes in the constraint's own unit, all rows of the problem.
        optimality: how far the first-order conditions are from holding.
        multipliers: row name -> multipliers of what is minimised, in the units of the objective over those of the row,
            in the order of its places; a norm's are those of its square. "dynamics of <state>" (intervals, dimension).
        active: names of the constraints that bind, those first that matter most to the objective.
        status: how it ended; `message` says it in one sentence, and which constraint is worst and where.
        iterations: steps of the solver in the try that gave this result.
        tries: one line (status, cost, violation, iterations) for every guess.
        compile_seconds, solve_seconds: wall time.
        warm: what `solve(warm=...)` starts from.
        slacks: (rows,) what is left to every inequality in its own unit, as the solver knows it.
    """

    cost: float
    violation: float
    violations: dict[str, float]
    optimality: Optimality
    multipliers: dict[str, Array]
    active: tuple[str, ...]
    status: Status
    message: str
    iterations: int
    tries: tuple[tuple[Status, float, float, int], ...]
    compile_seconds: float
    solve_seconds: float
    warm: WarmStart
    slacks: Array

    def shifted(self, steps: int = 1) -> WarmStart:
        """A start for `solve(warm=...)` that is so many intervals later, as a receding horizon needs it.

        Controls, states and multipliers move on. The last control is held, and the states are rolled out.

        Raises:
            TrajectoryError: steps is no positive whole number.
        """
        return self.warm.shifted(steps)

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED

    def explain(self) -> str:
        """How good it is, a line each: errors, active constraints, what a finer rollout misses and exceeds."""
        return explained(self)

    def __repr__(self) -> str:
        return (
            f"TrajectoryResult({self.message} cost={self.cost:.6g}, violation={self.violation:.1e}, "
            f"final_time={self.final_time:.6g}, iterations={self.iterations}, "
            f"compile {self.compile_seconds:.1f} s, solve {self.solve_seconds:.1f} s)"
        )


def explained(result: TrajectoryResult | PhasedResult) -> str:
    """How good a result is, a line each."""
    size = {name: float(np.abs(result.multipliers[name]).max()) for name in result.active}
    errors = ", ".join(f"{name} {value:.1e}" for name, value in dataclasses.asdict(result.optimality).items())
    missed = "; ".join(
        f"{name} {', '.join(f'{kind} {value:.2g}' for kind, value in own.items())}"
        for name, own in result.mesh_error.items()
    )
    broken = {name: value for name, value in result.between_nodes.items() if value > 0.0}
    lines = [
        result.message,
        f"first-order conditions: {errors}",
        f"active, by multiplier: {', '.join(f'{name} ({size[name]:.3g})' for name in result.active) or 'none'}",
        f"misses of a finer rollout at the end: {missed}",
        "exceeded along it: " + (", ".join(f"{n} by {v:.2g}" for n, v in broken.items()) or "nothing"),
    ]
    return "\n".join(lines)


def best_result(
    problem: Problem,
    outcomes: Sequence[Outcome],
    params: dict[str, Array],
    tolerance: float,
    compile_seconds: float,
    solve_seconds: float,
) -> TrajectoryResult:
    """The best of several tries: a solved one of least cost, else the one that violates least."""
    sign, best = problem.objective.sign, best_of(outcomes)
    params = found_params(problem.border, best, params)
    point = best.point
    with in_double():
        violations = violations_of(problem, best, params)
    return TrajectoryResult(
        **trajectory_at(problem, point, params),
        cost=sign * best.cost,
        violation=best.violation,
        violations=violations,
        optimality=Optimality(*best.errors),
        multipliers=multipliers_of(problem, best),
        active=active_of(problem.shooting, best),
        status=best.status,
        message=_message(problem, best, violations, tolerance),
        iterations=best.iterations,
        tries=tuple((o.status, sign * o.cost, o.violation, o.iterations) for o in outcomes),
        compile_seconds=compile_seconds,
        solve_seconds=solve_seconds,
        warm=WarmStart(problem, jax.tree.map(np.asarray, point), best.dynamics, best.rows, best.scales, params),
        slacks=best.slack,
    )


def best_of(outcomes: Sequence[Outcome]) -> Outcome:
    """A solved one of least cost, else the one that violates least."""

    def rank(outcome: Outcome) -> tuple[int, float]:
        order = [Status.SOLVED, Status.EXCEEDED, Status.ACCEPTABLE]
        if outcome.status in order:
            return order.index(outcome.status), outcome.cost
        return 2 + (outcome.status is Status.NON_FINITE), outcome.violation

    return min(outcomes, key=rank)


def found_params(border: Border, outcome: Outcome, params: dict[str, Array]) -> dict[str, Array]:
    """The parameters with those that were found."""
    return params | {name: np.asarray(value) for name, value in border.params(np.asarray(outcome.point.border)).items()}


def trajectory_at(problem: Problem, point: Point, params: dict[str, Array]) -> dict[str, Any]:
    """The fields of a `Trajectory` at a point."""
    controls = problem.shooting.local.controls.split(np.asarray(point.us))
    states, ts = problem.reduced.states, times_of(problem, point)
    own = {s.name for s in states}
    return {
        "problem": problem,
        "xs": {s.name: np.asarray(point.xs[s.name]) for s in states},
        "added": {name: np.asarray(values) for name, values in point.xs.items() if name not in own},
        "us": {n: np.asarray(values) for n, values in problem.restated.us(point.xs, controls).items()},
        "ts": ts,
        "final_time": float(ts[-1]),
        "params": params,
    }


def times_of(problem: Problem, point: Point) -> Array:
    """The times of the nodes."""
    return np.asarray(problem.restated.times(point.xs, problem.shooting.times(np.asarray(point.border))))


def multipliers_of(problem: Problem, outcome: Outcome) -> dict[str, Array]:
    """By the names of rows."""
    shooting = problem.shooting
    found = {f"dynamics of {name}": outcome.dynamics[:, part] for name, part in problem.dynamics.group.slices.items()}
    for name in dict.fromkeys(shooting.names[shooting.exists]):
        found[name] = outcome.rows[shooting.exists & (shooting.names == name)]
    return found


def active_of(shooting: Transcribed, outcome: Outcome) -> tuple[str, ...]:
    """The names of rows whose multipliers, scaled, are not nothing."""
    names, sizes = shooting.names, np.abs(outcome.scaled_rows)
    found = largest_by_name([str(name) for name in names], sizes)
    return tuple(sorted((name for name, size in found.items() if size > _ACTIVE), key=lambda n: -found[n]))


def violations_of(problem: Problem, outcome: Outcome, params: dict[str, Array]) -> dict[str, float]:
    """At the nodes, in the constraints' own units."""
    shooting, path, point = problem.shooting, problem.path, outcome.point
    defects = np.abs(np.asarray(outcome.values.defects)).max(axis=0)
    found = {f"dynamics of {n}": float(defects[p].max(initial=0.0)) for n, p in problem.dynamics.group.slices.items()}
    if path.shown:
        ts = times_of(problem, point)
        held = shooting.local.controls.split(np.asarray(point.us))
        ends = [({n: np.asarray(a)[s] for n, a in point.xs.items()}, ts[s]) for s in (slice(None, -1), slice(1, None))]
        sizes = [
            violations(np.asarray(problem.shown_rows(t, x, held, params)), path.shown_equality).max(axis=0)
            for x, t in ends
        ]
        found |= largest_by_name(path.shown, np.maximum(*sizes))
    own = shooting.own
    lost = violations(np.asarray(outcome.values.rows), shooting.equality)
    return found | largest_by_name([str(name) for name in shooting.names[own]], lost[own])


def _message(problem: Problem, outcome: Outcome, sizes: dict[str, float], tolerance: float) -> str:
    """The status, and where it is no success the worst constraint and the worst break of the dynamics."""
    shooting, worst = problem.shooting, []
    count = shooting.intervals * shooting.n
    if outcome.status in (Status.SOLVED, Status.EXCEEDED, Status.ACCEPTABLE):
        return f"{outcome.status}."
    rows, dynamics = outcome.violations[count:], outcome.violations[:count].reshape(-1, shooting.n)
    if rows.max(initial=0.0) > tolerance:
        row = int(rows.argmax())
        name, place = shooting.names[row], shooting.places[row]
        raw = abs(float(outcome.values.rows[row]))
        worst.append(f"{name!r} {place} is off by {sizes[name] if name in problem.path.shown else raw:.3g}")
    if dynamics.max(initial=0.0) > tolerance:
        interval, column = divmod(int(dynamics.argmax()), shooting.n)
        size = abs(float(outcome.values.defects[interval, column]))
        between = f"between nodes {interval} and {interval + 1}"
        worst.append(f"'dynamics of {shooting.states[column]}' {between} is off by {size:.3g}")
    return f"{outcome.status}. Worst: {'; '.join(worst)}." if worst else f"{outcome.status}."
