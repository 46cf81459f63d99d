"""What an optimisation gives back, and the rollout of the controls it found, densely and with any method."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..checks import whole
from ..errors import InputError, IntegrationError, TrajectoryError
from ..groups import Group, SpecialEuclidean, SpecialOrthogonal
from ..integrators import RKMK, Method, ZeroOrderHold, integrate
from ..integrators.ambient import Ambient
from ..integrators.tableaus import RK4
from .optimizer import Outcome, Status
from .statement import largest_by_name, violations

if TYPE_CHECKING:
    from .problem import Problem


@dataclasses.dataclass(frozen=True)
class TrajectoryResult:
    """A trajectory and how well it solves its problem. All arrays are NumPy, double precision.

    Attributes:
        xs: states by name, leading axis the nodes.
        us: controls by name, leading axis the intervals; held over each.
        ts: (nodes,) times in s.
        final_time: the last of them.
        cost: the objective as stated (a maximum is not negated).
        violation: the largest violation of a constraint, each measured in its own scale; 0 where all hold.
        violations: row name -> largest violation in the constraint's own unit, all rows of the problem.
        status: how it ended; `message` says it in one sentence, and which constraint is worst and where.
        iterations: evaluations of the problem in the try that gave this result.
        tries: one line (status, cost, violation, iterations) for every guess.
        compile_seconds, solve_seconds: wall time.
    """

    problem: Problem
    xs: dict[str, Array]
    us: dict[str, Array]
    ts: Array
    final_time: float
    cost: float
    violation: float
    violations: dict[str, float]
    status: Status
    message: str
    iterations: int
    tries: tuple[tuple[Status, float, float, int], ...]
    compile_seconds: float
    solve_seconds: float

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED

    def replay(self, method: Any = None, steps: int = 20, *, rtol: float = 1e-10, atol: float = 1e-10) -> Replay:
        """Roll out the found controls from the first node, each held over its interval, and measure what comes out.

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
        method = RKMK(RK4) if method is None else method
        with jax.enable_x64(True):
            if isinstance(method, Method):
                xs = _rollout_on_group(self, method, steps)
            else:
                xs = _rollout_ambient(self, method, steps, rtol, atol)
            return _judged(self, xs, steps)

    def __repr__(self) -> str:
        return (
            f"TrajectoryResult({self.message} cost={self.cost:.6g}, violation={self.violation:.1e}, "
            f"final_time={self.final_time:.6g}, iterations={self.iterations}, "
            f"compile {self.compile_seconds:.1f} s, solve {self.solve_seconds:.1f} s)"
        )


def best_result(
    problem: Problem, outcomes: Sequence[Outcome], tolerance: float, compile_seconds: float, solve_seconds: float
) -> TrajectoryResult:
    """The best of several tries: a solved one of least cost, else the one that violates least."""
    sign = problem.objective.sign

    def rank(outcome: Outcome) -> tuple[bool, bool, float]:
        solved = outcome.status is Status.SOLVED
        return not solved, outcome.status is Status.NON_FINITE, outcome.cost if solved else outcome.violation

    best = min(outcomes, key=rank)
    iterate, final_time = best.evaluation.iterate, float(best.evaluation.iterate.final_time)
    return TrajectoryResult(
        problem=problem,
        xs={name: np.asarray(values) for name, values in iterate.xs.items()},
        us=problem.transcription.controls.split(np.asarray(iterate.us)),
        ts=np.linspace(0.0, final_time, problem.nodes),
        final_time=final_time,
        cost=sign * best.cost,
        violation=best.violation,
        violations=_violations(problem, best),
        status=best.status,
        message=_message(problem, best, tolerance),
        iterations=best.iterations,
        tries=tuple((o.status, sign * o.cost, o.violation, o.iterations) for o in outcomes),
        compile_seconds=compile_seconds,
        solve_seconds=solve_seconds,
    )


def _violations(problem: Problem, outcome: Outcome) -> dict[str, float]:
    """In the constraints' own units."""
    t, rows = problem.transcription, np.asarray(outcome.evaluation.rows)
    sizes = np.where(t.exists, violations(rows, t.equality), 0.0)
    return largest_by_name(t.names, sizes.max(axis=0))


def _message(problem: Problem, outcome: Outcome, tolerance: float) -> str:
    """The status, and where it is no success the worst constraint and the worst break of the dynamics."""
    t, rows = problem.transcription, np.asarray(outcome.evaluation.rows)
    worst = []
    for first, last in ((t.n, len(t.names)), (0, t.n)):
        scaled = outcome.violations[:, first:last]
        if scaled.max(initial=0.0) > tolerance:
            interval, row = divmod(int(scaled.argmax()), scaled.shape[1])
            row += first
            worst.append(f"{t.names[row]!r} {t.place(interval, row)} is off by {abs(rows[interval, row]):.3g}")
    return f"{outcome.status}. Worst: {'; '.join(worst)}." if worst else f"{outcome.status}."


# ---- replay ------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Replay:
    """A dense rollout of found controls.

    Attributes:
        ts: (n,) times in s, equally spaced within each interval.
        xs: states by name, leading axis n.
        us: controls by name, leading axis n; at a node the control that begins there.
        misses: state name -> how far the rollout ends from the planned final node: `position` and `angle` (rad) of a
            pose, `angle` of a rotation, `distance` of a state without a group.
        vectors: state name -> the same as a tangent vector, planned (+) vector = reached.
        violations: name of a path constraint or bound -> its largest violation along the rollout in its own unit, 0
            where it holds; each interval is looked at with its own control, both ends included.
        final: name of a final condition -> its violation at the end of the rollout.
    """

    ts: Array
    xs: dict[str, Array]
    us: dict[str, Array]
    misses: dict[str, dict[str, float]]
    vectors: dict[str, Array]
    violations: dict[str, float]
    final: dict[str, float]


def _rollout_on_group(result: TrajectoryResult, method: Method, steps: int) -> dict[str, Array]:
    problem = result.problem
    intervals = problem.nodes - 1
    tables = {name: ZeroOrderHold(result.ts[:-1], values) for name, values in result.us.items()}
    solution = integrate(
        problem.dynamics,
        {name: values[0] for name, values in result.xs.items()},
        t0=0.0,
        t1=result.final_time,
        steps=intervals * steps,
        method=method,
        u=tables,
        params=problem.params,
        save_at=_times(result, steps),
    )
    return {name: np.asarray(values) for name, values in solution.xs.items()}


def _rollout_ambient(result: TrajectoryResult, solver: Any, steps: int, rtol: float, atol: float) -> dict[str, Array]:
    import diffrax

    if not isinstance(solver, diffrax.AbstractSolver):
        raise InputError(f"method must be a method like tx.RKMK(tx.tableaus.RK4) or a diffrax solver, got {solver!r}")
    problem = result.problem
    ambient = Ambient(problem.dynamics)
    params = {name: jnp.asarray(value) for name, value in problem.params.items()}
    control = diffrax.PIDController(rtol=rtol, atol=atol)

    def interval(y: Any, span: tuple[Any, ...]) -> tuple[Any, Any]:
        t0, t1, u = span
        ts = jnp.linspace(t0, t1, steps + 1)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(ambient.vector_field),
            solver,
            t0,
            t1,
            (t1 - t0) / steps,
            y,
            args=(u, params),
            saveat=diffrax.SaveAt(ts=ts),
            stepsize_controller=control,
            max_steps=100_000,
            throw=False,
        )
        end = jax.tree.map(lambda a: a[-1], solution.ys)
        return end, (jax.tree.map(lambda a: a[:-1], solution.ys), solution.result == diffrax.RESULTS.successful)

    @jax.jit
    def rollout(y: Any, ts: Any, us: Any) -> Any:
        end, (parts, good) = jax.lax.scan(interval, y, (ts[:-1], ts[1:], us))
        whole = jax.tree.map(lambda a, b: jnp.concatenate([a.reshape(-1, *a.shape[2:]), b[None]]), parts, end)
        return jax.vmap(ambient.from_ambient)(whole), good

    start = ambient.to_ambient({name: values[0] for name, values in result.xs.items()})
    xs, good = rollout(start, jnp.asarray(result.ts), jax.tree.map(jnp.asarray, result.us))
    if not bool(good.all()):
        number = int(np.argmin(np.asarray(good)))
        raise IntegrationError(f"the solver gave up between nodes {number} and {number + 1} of the replay")
    return {name: np.asarray(values) for name, values in xs.items()}


def _times(result: TrajectoryResult, steps: int) -> Array:
    return np.linspace(0.0, result.final_time, (len(result.ts) - 1) * steps + 1)


def _judged(result: TrajectoryResult, xs: dict[str, Array], steps: int) -> Replay:
    problem, ts = result.problem, _times(result, steps)
    intervals = problem.nodes - 1
    holds = np.minimum(np.arange(len(ts)) // steps, intervals - 1)
    end = {name: np.asarray(values[-1]) for name, values in xs.items()}
    planned = {name: np.asarray(values[-1]) for name, values in result.xs.items()}
    factors = problem.dynamics.group.factors.items()
    vectors = {name: np.asarray(jax.jit(g.difference)(planned[name], end[name])) for name, g in factors}
    return Replay(
        ts=ts,
        xs=xs,
        us={name: values[holds] for name, values in result.us.items()},
        misses={name: _miss(g, planned[name], end[name], vectors[name]) for name, g in factors},
        vectors=vectors,
        violations=_path_violations(result, ts, xs, steps),
        final=_final_violations(problem, result.final_time, end),
    )


def _miss(group: Group, planned: Array, reached: Array, vector: Array) -> dict[str, float]:
    if isinstance(group, SpecialEuclidean):
        _, angular = group.order.split(vector)
        position = float(np.linalg.norm(reached[:3, 3] - planned[:3, 3]))
        return {"position": position, "angle": float(np.linalg.norm(angular))}
    kind = "angle" if isinstance(group, SpecialOrthogonal) else "distance"
    return {kind: float(np.linalg.norm(vector))}


def _path_violations(result: TrajectoryResult, ts: Array, xs: dict[str, Array], steps: int) -> dict[str, float]:
    problem = result.problem
    rows = problem.transcription.path
    if not rows.names:
        return {}
    window = steps * np.arange(problem.nodes - 1)[:, None] + np.arange(steps + 1)
    at = jax.vmap(problem.transcription.path_values, in_axes=(0, 0, None, None))
    points = {name: values[window] for name, values in xs.items()}
    values = jax.jit(jax.vmap(at, in_axes=(0, 0, 0, None)))(ts[window], points, dict(result.us), problem.params)
    return largest_by_name(rows.names, violations(np.asarray(values), rows.equality).max(axis=(0, 1)))


def _final_violations(problem: Problem, t: float, end: dict[str, Array]) -> dict[str, float]:
    rows = problem.final_rows
    values = np.asarray(jax.jit(rows.values)(jnp.asarray(t), end, problem.params))
    return largest_by_name(rows.names, violations(values, rows.equality))
