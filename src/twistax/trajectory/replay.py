"""Roll out the controls that an optimisation found, densely and with any method, and measure what comes out."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..errors import InputError, IntegrationError
from ..expr import Inputs, evaluate_all
from ..groups import Group, SpecialEuclidean, SpecialOrthogonal
from ..integrators import RKMK, Method, ZeroOrderHold, integrate
from ..integrators.ambient import Ambient
from ..integrators.tableaus import RK4
from .discretize import check_whole
from .result import TrajectoryResult, largest_by_name

if TYPE_CHECKING:
    from .problem import Problem

__all__ = ["Replay", "replay"]


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


def replay(
    result: TrajectoryResult, method: Any = None, steps: int | None = None, *, rtol: float = 1e-10, atol: float = 1e-10
) -> Replay:
    """Roll out the controls of a result from its first node, each held over its interval.

    Args:
        result: what `Problem.solve` gave.
        method: an RKMK method, RK4 if left out; or a diffrax solver, which integrates the same system as a plain ODE in
            quaternions with adaptive steps.
        steps: samples an interval, and for an RKMK method its steps there; 20 if left out.
        rtol, atol: tolerances of a diffrax solver.
    Raises:
        TrajectoryError: steps is no positive whole number.
        InputError: method is neither.
        IntegrationError: the rollout did not reach its end.
    """
    steps = 20 if steps is None else steps
    check_whole("steps", steps)
    method = RKMK(RK4) if method is None else method
    with jax.enable_x64(True):
        if isinstance(method, Method):
            xs = _rollout_on_group(result, method, steps)
        else:
            xs = _rollout_ambient(result, method, steps, rtol, atol)
        return _judged(result, xs, steps)


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
    vectors = {name: _difference(g, planned[name], end[name]) for name, g in problem.dynamics.group.factors.items()}
    return Replay(
        ts=ts,
        xs=xs,
        us={name: values[holds] for name, values in result.us.items()},
        misses={
            name: _miss(group, planned[name], end[name], vectors[name])
            for name, group in problem.dynamics.group.factors.items()
        },
        vectors=vectors,
        violations=_path_violations(result, ts, xs, steps),
        final=_final_violations(problem, result.final_time, end),
    )


def _difference(group: Group, planned: Array, reached: Array) -> Array:
    return np.asarray(jax.jit(group.difference)(planned, reached))


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
    params = {name: jnp.asarray(value) for name, value in problem.params.items()}

    @jax.jit
    def largest(ts: Any, xs: Any, us: Any) -> jax.Array:
        at = jax.vmap(problem.transcription.path_values, in_axes=(0, 0, None, None))
        values = jax.vmap(at, in_axes=(0, 0, 0, None))(ts, xs, us, params)
        sizes = jnp.where(rows.equality[None, None, :], jnp.abs(values), jnp.maximum(values, 0.0))
        return jnp.max(sizes, axis=(0, 1))

    points = {name: values[window] for name, values in xs.items()}
    worst = np.asarray(largest(ts[window], points, dict(result.us)))
    return largest_by_name(rows.names, worst)


def _final_violations(problem: Problem, t: float, end: dict[str, Array]) -> dict[str, float]:
    rows = problem.final_rows
    if not rows.names:
        return {}

    @jax.jit
    def residuals(t: jax.Array, x: Any, params: Any) -> jax.Array:
        inputs = Inputs(t, x, {}, params, t.dtype)
        return jnp.concatenate([v.reshape(-1) for v in evaluate_all(rows.residuals, lambda leaf: leaf.read(inputs))])

    params = {name: jnp.asarray(value) for name, value in problem.params.items()}
    values = np.asarray(residuals(jnp.asarray(t), end, params))
    equality = np.arange(len(values)) >= len(values) - rows.equalities
    return largest_by_name(rows.names, np.where(equality, np.abs(values), np.maximum(values, 0.0)))
