"""A mesh made finer until it does not matter: intervals are split where they miss, and where controls bend.

After a solve each interval is integrated again from its planned start, by a method of higher order in finer steps. How
far its end is from the planned one, in scales of the states, is its error. Intervals with too large an error are split,
and those whose controls change most, as these cost most. Where the objective has come to rest before the errors have,
substeps are doubled. It ends when all errors are within the tolerance, and the objective moved by less than that since
the mesh before.
Source of the marking: Dorfler, SIAM J. Numer. Anal. 33 (1996), here for squared changes of controls.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..integrators.method import VectorField
from ..precision import in_double
from .layout import Layout
from .mesh import Mesh
from .replay import held_of
from .transcribed import Point
from .warm import WarmStart
from .watch import Status

if TYPE_CHECKING:
    from .problem import Problem
    from .result import Trajectory, TrajectoryResult

#: The most meshes, nodes and substeps; what is split at least of all squared changes of controls, and of all intervals.
_MESHES, _NODES, _SUBSTEPS, _SHARE, _LEAST = 12, 1000, 8, 0.9, 0.5


@dataclasses.dataclass(frozen=True)
class Meshed:
    """One mesh of a refinement.

    Attributes:
        nodes, substeps: how many; substeps are those of an interval.
        error: the largest error of an interval, in scales of the states.
        cost: the objective as stated.
        status: of its solve.
        seconds: wall time, with compiling.
    """

    nodes: int
    substeps: int
    error: float
    cost: float
    status: Status
    seconds: float


def refined(first: TrajectoryResult, tolerance: float, solve: Callable[..., TrajectoryResult]) -> TrajectoryResult:
    """The result on a mesh that is fine enough, or the last one with status COARSE; its `meshes` tell the history.

    Args:
        first: the result on the mesh as stated; the refinement ends with it unless it is SOLVED.
        solve: solves another problem from a warm start.
    """
    result, meshes, change = first, [], np.inf
    while True:
        errors = interval_errors(result)
        largest = float(errors.max())
        seconds = result.compile_seconds + result.solve_seconds
        problem = result.problem
        count = problem.nodes, problem.transcription.substeps
        meshes.append(Meshed(*count, largest, result.cost, result.status, seconds))
        if result.status is not Status.SOLVED:
            return dataclasses.replace(result, meshes=tuple(meshes))
        size = max(abs(result.cost), 1e-6 * float(result.warm.scales.cost))
        rests = change <= tolerance * size
        if rests and largest <= tolerance:
            return dataclasses.replace(result, meshes=tuple(meshes))
        finer = _finer(result, errors, tolerance, rests)
        if finer is None or len(meshes) >= _MESHES:
            message = f"{Status.COARSE}."
            return dataclasses.replace(result, status=Status.COARSE, message=message, meshes=tuple(meshes))
        before = result.cost
        result = solve(*finer)
        change = abs(result.cost - before)


def interval_errors(result: TrajectoryResult) -> Array:
    """(intervals,) how far each interval, integrated closely from its planned start, ends from its planned end.

    In scales of the states, the largest over the tangents.
    """
    problem = result.problem
    ends = _ends(result, result.warm.point.xs)
    group = problem.dynamics.group
    with in_double():
        planned = {name: np.asarray(a)[1:] for name, a in result.warm.point.xs.items()}
        gaps = np.asarray(jax.jit(jax.vmap(group.difference))(planned, ends))
    return np.asarray(np.abs(gaps / result.warm.scales.d[1:]).max(axis=1, initial=0.0))


def _ends(result: Trajectory, xs: dict[str, Array], share: float = 1.0) -> dict[str, Array]:
    """The states a share of each interval after its start, by a close integration."""
    problem = result.problem
    dynamics, method = problem.dynamics, problem.transcription.closer
    steps = 2 * problem.transcription.substeps
    params = {p.name: jnp.asarray(result.params[p.name]) for p in dynamics.parameters if p.name in result.params}
    stored = method.stored(dynamics, params)

    def one(interval: Any) -> Any:
        x, u, t, h = interval
        field = VectorField(dynamics, lambda _: u, params)
        advance = lambda i, y: method.advance(field, t + i * h, y, h)  # noqa: E731
        return stored.value(jax.lax.fori_loop(0, steps, advance, stored.enter(x)))

    with in_double():
        starts = {name: jnp.asarray(a)[:-1] for name, a in xs.items()}
        lengths = share * np.diff(result.ts) / steps
        held = jax.tree.map(jnp.asarray, held_of(result))
        found = jax.jit(lambda *own: jax.lax.map(one, own))(starts, held, jnp.asarray(result.ts[:-1]), lengths)
    return {name: np.asarray(a) for name, a in found.items()}


def _finer(result: TrajectoryResult, errors: Array, tolerance: float, rests: bool) -> tuple[Problem, WarmStart] | None:
    """The problem on the next mesh with a start for it; None where that would be too large."""
    problem, none = result.problem, np.zeros(len(errors), bool)
    transcription, mesh = problem.transcription, problem.mesh
    if rests and transcription.substeps < _SUBSTEPS:
        finer = dataclasses.replace(transcription, substeps=2 * transcription.substeps)
        again = problem.on(mesh, finer, np.arange(problem.nodes))
        return again, _start(again, result, none)
    split = ~(errors <= tolerance) | _marked(_changes(result))
    if problem.nodes + split.sum() > _NODES:
        return None
    middles = (mesh.shares[:-1] + 0.5 * mesh.widths)[split]
    finer_mesh = Mesh(np.sort(np.concatenate([mesh.shares, middles])), free=mesh.free or False)
    again = problem.on(finer_mesh, transcription, np.arange(problem.nodes) + np.append(0, np.cumsum(split)))
    return again, _start(again, result, split)


def _changes(result: TrajectoryResult) -> Array:
    """(intervals,) by how much, squared, controls change about an interval, in their scales, times its length.

    Of linear controls their rates are held; these count times the length once more.
    """
    problem, us = result.problem, np.asarray(result.warm.point.us)
    lengths = np.diff(result.ts) / (result.ts[-1] - result.ts[0])
    found = np.zeros(len(us))
    for name, part in problem.shooting.local.controls.slices.items():
        if name == problem.restated.pace:
            continue
        jumps = np.pad(np.abs(np.diff(us[:, part], axis=0)), ((1, 1), (0, 0)))
        change = np.maximum(jumps[:-1], jumps[1:])
        if name in problem.restated.rates:
            change = change * lengths[:, None]
        most = change.max(axis=0)
        found += ((change / np.where(most > 0.0, most, 1.0)) ** 2).sum(axis=1) * lengths
    return found


def _marked(changes: Array) -> Array:
    """The fewest intervals that have a share of all changes, and no less than half of all intervals."""
    order, found = np.argsort(-changes), np.zeros(len(changes), bool)
    total = np.cumsum(changes[order])
    count = int(np.searchsorted(total, _SHARE * total[-1])) + 1
    found[order[: max(count, int(np.ceil(_LEAST * len(changes))))]] = True
    return found


def _start(problem: Problem, result: TrajectoryResult, split: Array) -> WarmStart:
    """What was found as a start on the next mesh: half of an interval has its controls, and half of its multipliers."""
    warm = result.warm
    old, new = result.problem.shooting, problem.shooting
    parent = np.repeat(np.arange(old.intervals), 1 + split)
    xs = {name: np.asarray(a) for name, a in warm.point.xs.items()}
    if split.any():
        middle, at = _ends(result, xs, 0.5), np.flatnonzero(split)
        xs = {name: np.insert(a, at + 1, middle[name][at], axis=0) for name, a in xs.items()}
    before, own = (np.asarray(a)[: old.intervals * old.rows_per_interval] for a in (warm.rows, warm.scales.rows))
    source, same = _columns(old.layout, new.layout, old.substeps, new.substeps)
    halves = np.where(split[parent], 0.5, 1.0)[:, None]
    rows = before.reshape(old.intervals, -1)[parent][:, source] * np.where(same, halves, 0.0)
    sizes = own.reshape(old.intervals, -1)[parent][:, source]
    scales = warm.scales
    return WarmStart(
        problem,
        Point(xs, np.asarray(warm.point.us)[parent], np.asarray(warm.point.border)),
        _costates(warm.dynamics, split),
        np.concatenate([rows.ravel(), warm.rows[before.size :]]),
        scales._replace(
            d=np.asarray(scales.d)[np.append(0, parent + 1)],
            u=np.asarray(scales.u)[parent],
            rows=np.concatenate([sizes.ravel(), np.asarray(scales.rows)[before.size :]]),
        ),
        warm.params,
    )


def _costates(dynamics: Array, split: Array) -> Array:
    """Multipliers of the dynamics: those of the nodes, and between two of them their mean."""
    at = np.flatnonzero(split)
    before = dynamics[np.maximum(at - 1, 0)]
    return np.insert(dynamics, at, 0.5 * (before + dynamics[at]), axis=0)


def _columns(old: Layout, new: Layout, substeps: int, finer: int) -> tuple[Array, Array]:
    """Which of the old rows of an interval are at the place of each new one, or before it, and whether at it."""
    points, row = np.divmod(new.asked, new.path_rows)
    place = points * substeps / finer
    where = {index: k for k, index in enumerate(old.asked)}
    source = [where.get(int(p) * new.path_rows + r, 0) for p, r in zip(place, row)]
    conditions = len(old.asked) + np.arange(new.at_nodes)
    same = np.concatenate([place == np.floor(place), np.ones(new.at_nodes, bool)])
    return np.concatenate([np.array(source, int), conditions]), same
