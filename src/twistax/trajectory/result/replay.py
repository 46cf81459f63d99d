"""Dense rollouts of the controls of a trajectory by any method, with their errors and constraint violations."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...errors import InputError, IntegrationError, TrajectoryError
from ...groups import Group
from ...integrators import Method, ZeroOrderHold, integrate
from ...integrators.ambient import AmbientSystem
from ...progress import watching
from ..problem.statement import largest_by_name, violations
from ..strategy.integration import CoreRollout
from ..transcription.iterate import Iterate


@dataclasses.dataclass(frozen=True)
class Replay:
    """A dense rollout of the controls of a solution.

    Attributes:
        ts: (n,) times in s, equally spaced within each interval.
        xs: states by name, leading axis n.
        us: controls by name, leading axis n; at a node the control that begins there.
        misses: state name -> distance of the end of the rollout from the planned final node: `position` and `angle`
            (rad) of a pose, `angle` of a rotation, `distance` of a state without a group.
        vectors: state name -> the same difference as a tangent vector: planned (+) vector = end of the rollout.
        violations: name of a path constraint or bound -> its largest violation along the rollout in its own unit, 0 if
            it holds; each interval is evaluated with its own control, both ends included.
        integrals: `Integral(...)` -> its value from the start until each time, leading axis n.
        extremes: `Maximum(...)`, `Minimum(...)` -> its value along the rollout.
        final: name of a condition at a node -> its violation there, along the rollout.
    """

    ts: Array
    xs: dict[str, Array]
    us: dict[str, Array]
    misses: dict[str, dict[str, float]]
    vectors: dict[str, Array]
    violations: dict[str, float]
    integrals: dict[str, Array]
    extremes: dict[str, float]
    final: dict[str, float]

    def __repr__(self) -> str:
        sizes = self.violations | self.final
        worst = sorted((name for name in sizes if sizes[name] > 0.0), key=sizes.__getitem__, reverse=True)
        parts = [f"{name!r} by {sizes[name]:.2g}" for name in worst[:3]] + ["..."] * (len(worst) > 3)
        misses = ", ".join(f"{k} of {name!r} {v:.2g}" for name, of in self.misses.items() for k, v in of.items())
        limits = f"violated: {', '.join(parts)}" if worst else "no limit is violated"
        return f"Replay({len(self.ts)} times until {self.ts[-1]:.6g} s; misses the planned end: {misses}; {limits})"


@watching("replay")
def replayed(result: Any, method: Any, steps: int, rtol: float, atol: float) -> Replay:
    """The rollout of a trajectory; see `Trajectory.replay`. By default the solver's core performs it if it can."""
    _need_finite(result)
    back = np.flatnonzero(np.diff(result.ts) < 0.0)
    if back.size:
        raise TrajectoryError(
            f"replay: the times of nodes must increase, but node {back[0] + 1} at "
            f"{result.ts[back[0] + 1]:g} s is before node {back[0]}.\n"
            "  fix: solve until the limits of free node times are satisfied"
        )
    if method is None and result.solve is not None:
        xs = _by_the_core(result, steps)
        if all(np.isfinite(values).all() for values in xs.values()):
            return _judged(result, xs, steps)
    method = result.problem.transcription.replaying if method is None else method
    if isinstance(method, Method):
        return _judged(result, rolled_out(result, method, steps), steps)
    return _judged(result, _rollout_ambient(result, method, steps, rtol, atol), steps)


def _need_finite(result: Any) -> None:
    """Raise TrajectoryError unless all of its states, controls and times are finite."""
    for name, values in {**result.xs, **result.added, **result.us, "the time": result.ts}.items():
        wrong = np.flatnonzero(~np.isfinite(np.reshape(values, (len(values), -1))).all(axis=1))
        if wrong.size:
            raise TrajectoryError(
                f"{name!r} is not finite at node {wrong[0]}, so there is no rollout from it.\n"
                "  fix: limit states to values at which the rates are defined, or use another guess"
            )


def rolled_out(result: Any, method: Method, steps: int) -> dict[str, Array]:
    """The rollout by an integration method: one integration if all intervals are equal, else one for each interval."""
    problem = result.problem
    params = {p.name: result.params[p.name] for p in problem.dynamics.parameters if p.name in result.params}
    ts, count, x = times_along(result, steps), problem.nodes - 1, _start(result)
    us = held_of(result)
    parts = [{name: values[None] for name, values in x.items()}]
    together = count if problem.mesh.is_even else 1
    for k in range(0, count, together):
        window = slice(k * steps, (k + together) * steps + 1)
        solution = integrate(
            problem.dynamics,
            x,
            t0=float(ts[window][0]),
            t1=float(ts[window][-1]),
            steps=together * steps,
            method=method,
            u={n: ZeroOrderHold(result.ts[k : k + together], a[k : k + together]) for n, a in us.items()},
            params=params,
            save_at=ts[window][1:],
        )
        parts.append({name: np.asarray(values) for name, values in solution.xs.items()})
        x = {name: values[-1] for name, values in parts[-1].items()}
    return {name: np.concatenate([part[name] for part in parts]) for name in x}


def _by_the_core(result: Any, steps: int) -> dict[str, Array]:
    """The rollout by the solver's core, which does not recompile for other numbers."""
    problem, us, (solved, border) = result.problem, lifted(result).us, result.solve
    columns = [np.reshape(us[name], (problem.nodes - 1, -1)) for name in problem.shooting.local.controls.slices]
    fixed = {name: value for name, value in result.params.items() if name not in problem.border.params(border)}
    started = solved.started(params=fixed)
    staged = solved.core(1e-6, started.point, started.instance).staged
    start, planned = _start(result), result.xs | result.added
    xs = {name: np.concatenate([first[None], planned[name][1:]]) for name, first in start.items()}
    point = Iterate(xs, np.concatenate([np.zeros((problem.nodes - 1, 0)), *columns], axis=1), border)
    data = staged.numbers.vector(started.instance)
    rolling = problem.transcription.rolling(steps)
    return CoreRollout(staged.parts[0], rolling, staged.numbers, data).states(point)


def _start(result: Any) -> dict[str, Array]:
    """All states at the first node."""
    return {name: np.asarray(values[0]) for name, values in lifted(result).xs.items()}


def _rollout_ambient(result: Any, solver: Any, steps: int, rtol: float, atol: float) -> dict[str, Array]:
    import diffrax

    if not isinstance(solver, diffrax.AbstractSolver):
        raise InputError(f"method must be a method like tx.RKMK(tx.tableaus.RK4) or a diffrax solver, got {solver!r}")
    problem = result.problem
    ambient = AmbientSystem(problem.dynamics)
    params = {name: jnp.asarray(value) for name, value in result.params.items()}
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
        states = jax.tree.map(lambda a, b: jnp.concatenate([a.reshape(-1, *a.shape[2:]), b[None]]), parts, end)
        return jax.vmap(ambient.from_ambient)(states), good

    start = ambient.to_ambient(_start(result))
    xs, good = rollout(start, jnp.asarray(result.ts), jax.tree.map(jnp.asarray, held_of(result)))
    if not bool(good.all()):
        number = int(np.argmin(np.asarray(good)))
        raise IntegrationError(f"the solver failed between nodes {number} and {number + 1} of the replay")
    return {name: np.asarray(values) for name, values in xs.items()}


def lifted(result: Any) -> Any:
    """States and piecewise constant controls of the reformulated system, which is integrated; bounds of norms are
    tight.
    """
    return result.problem.lifted(result.ts, result.xs | result.added, result.us, result.params)


def held_of(result: Any) -> dict[str, Array]:
    """The piecewise constant controls of the reformulated system, which is integrated."""
    controls = result.problem.dynamics.controls
    lifted_us = lifted(result).us
    return {c.name: lifted_us[c.name] for c in controls}


def times_along(result: Any, steps: int) -> Array:
    """(intervals * steps + 1,), equally spaced within each interval."""
    inner = np.linspace(result.ts[:-1], result.ts[1:], steps, endpoint=False, axis=1)
    return np.append(inner.ravel(), result.ts[-1])


def _judged(result: Any, xs: dict[str, Array], steps: int) -> Replay:
    problem, ts = result.problem, times_along(result, steps)
    intervals = problem.nodes - 1
    holds = np.minimum(np.arange(len(ts)) // steps, intervals - 1)
    end = {name: np.asarray(values[-1]) for name, values in xs.items()}
    planned = {name: np.asarray(values[-1]) for name, values in (result.xs | result.added).items()}
    unseen = problem.continuous.hidden | problem.functionals.loose
    factors = [(n, group) for n, group in problem.dynamics.group.factors.items() if n not in unseen]
    vectors = {name: _difference(g, planned[name], end[name]) for name, g in factors}
    path, rows = problem.path, _shown_along(result, ts, xs, steps)
    extremes = problem.functionals.extremes_of(rows, path.shown, result.params)
    return Replay(
        ts=ts,
        xs={name: xs[name] for name in result.xs},
        us=problem.seen(xs, {name: values[holds] for name, values in held_of(result).items()})[1],
        misses={name: _miss(g, planned[name], end[name], vectors[name]) for name, g in factors},
        vectors=vectors,
        violations=largest_by_name(path.shown, violations(rows, path.shown_equality).max(axis=0)),
        integrals={name: xs[name] for name in problem.functionals.integrals},
        extremes={leaf.name: float(extremes[name]) for leaf, name in problem.functionals.extremes.values()},
        final=_node_violations(result, ts, xs, steps),
    )


def _difference(group: Group, a: Array, b: Array) -> Array:
    """The tangent from one group element to another."""
    return np.ravel(b - a) if group.flat else np.asarray(_curved_difference(group, a, b))


@functools.partial(jax.jit, static_argnums=0)
def _curved_difference(group: Group, a: jax.Array, b: jax.Array) -> jax.Array:
    return group.difference(a, b)


def _miss(group: Group, planned: Array, reached: Array, vector: Array) -> dict[str, float]:
    misses = {}
    for part in group.parts:
        difference = reached[part.place] - planned[part.place] if part.sized else vector[list(part.entries)]
        misses["angle" if part.unit == "rad" else part.name] = float(np.linalg.norm(difference))
    return misses


def _shown_along(result: Any, ts: Array, xs: dict[str, Array], steps: int) -> Array:
    """The path rows as users wrote them, along a rollout."""
    problem = result.problem
    if not problem.path.shown:
        return np.zeros((1, 0))
    window = steps * np.arange(problem.nodes - 1)[:, None] + np.arange(steps + 1)
    # Each interval is evaluated with its own control, both ends included.
    points = {name: values[window.ravel()] for name, values in xs.items()}
    controls = {name: np.repeat(values, steps + 1, axis=0) for name, values in lifted(result).us.items()}
    return np.asarray(problem.shown_rows(ts[window.ravel()], points, controls, result.params))


def _node_violations(result: Any, ts: Array, xs: dict[str, Array], steps: int) -> dict[str, float]:
    problem, largest = result.problem, dict[str, float]()
    for k, rows in (*problem.node_rows.items(), (problem.nodes - 1, problem.final_rows)):
        here = {name: values[k * steps] for name, values in xs.items()}
        params = {**result.params, **problem.node_slacks.without}
        values = np.asarray(jax.jit(rows.values)(jnp.asarray(ts[k * steps]), here, params))
        largest |= largest_by_name(rows.names, violations(values, rows.equality))
    return largest
