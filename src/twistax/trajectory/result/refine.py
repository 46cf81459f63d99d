"""Mesh refinement: intervals with a large integration error are split, and those in which controls change most.

After a solve, each interval is integrated again from its planned start, by a method of higher order with smaller steps.
The distance of its end from the planned one, in scales of the states, is its error. Intervals with too large an error
are split, and also those whose controls change most, because these contribute most to the error of the objective. If
the objective converges before the errors do, the number of substeps is doubled. The refinement ends when all errors are
within the tolerance, and the objective has changed by less than the tolerance since the previous mesh. In a problem of
several phases, each phase is marked separately.
Source of the marking: Dorfler, SIAM J. Numer. Anal. 33 (1996), here applied to squared changes of controls.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from ..strategy.status import Status
from ..strategy.warm import WarmStart
from ..transcription.iterate import Iterate
from ..transcription.mesh import Mesh, Remeshed
from ..transcription.row_layout import RowLayout
from ..transcription.shooting import PhaseSegment
from .trajectory import Trajectory, trajectory_at

if TYPE_CHECKING:
    from ..problem.stated_phase import StatedPhase

#: The maximal numbers of meshes, nodes and substeps; the minimal fractions of all squared changes of controls, and of
#: all intervals, that are split.
_MESHES, _NODES, _SUBSTEPS, _SHARE, _LEAST = 12, 1000, 8, 0.9, 0.5


@dataclasses.dataclass(frozen=True)
class Meshed:
    """One mesh of a mesh refinement, and the solve on it.

    Attributes:
        nodes, substeps: the nodes of all phases, and the largest number of substeps of an interval.
        error: the largest integration error of an interval, in scales of the states.
        cost: the objective as stated.
        status: of its solve.
        seconds: wall time, including compile time.
    """

    nodes: int
    substeps: int
    error: float
    cost: float
    status: Status
    seconds: float


def refined(first: Any, tolerance: float, solve: Callable[..., Any]) -> Any:
    """The result on sufficiently fine meshes, or the last one with status COARSE; its `meshes` list all meshes.

    Args:
        first: the result on the original mesh; it is returned unless its status is SOLVED or COARSE.
        solve: solves another problem from a warm start.
    """
    result, meshes, change = first, [], np.inf
    while True:
        accuracy = result.accuracy
        largest = np.nan if accuracy is None else accuracy.error
        seconds = result.compile_seconds + result.solve_seconds
        parts = result.problem.parts
        count = sum(part.nodes for part in parts), max(part.transcription.substeps for part in parts)
        meshes.append(Meshed(*count, largest, result.cost, result.status, seconds))
        if result.status not in (Status.SOLVED, Status.COARSE):
            message = f"{result.message} refine= went no further: it goes on from SOLVED and COARSE alone."
            return dataclasses.replace(result, message=message, meshes=tuple(meshes))
        size = max(abs(result.cost), 1e-6 * (0.0 if accuracy is None else accuracy.size))
        is_settled = change <= tolerance * size
        if is_settled and largest <= tolerance:
            return dataclasses.replace(result, meshes=tuple(meshes))
        finer = _finer(result, accuracy.intervals, tolerance, is_settled)
        if finer is None or len(meshes) >= _MESHES:
            message = f"{Status.COARSE}. {_unrefined(result, meshes, tolerance, change / size)}"
            return dataclasses.replace(result, status=Status.COARSE, message=message, meshes=tuple(meshes))
        before = result.cost
        result = solve(*finer)
        change = abs(result.cost - before)


def _unrefined(result: Any, meshes: Sequence[Meshed], tolerance: float, change: float) -> str:
    """The message of a failed mesh refinement: the reason, the error that was reached, and a remedy."""
    last, accuracy = meshes[-1], result.accuracy
    limit = f"at most {_MESHES} meshes" if len(meshes) >= _MESHES else f"a finer mesh has more than {_NODES:,} nodes"
    moved = f", and the objective still changes by {change:.1g} of itself" if np.isfinite(change) else ""
    return (
        f"It could not be refined to {tolerance:g}: {limit}. On {last.nodes} nodes with {last.substeps} substeps the "
        f"interval {accuracy.place} misses its end by {accuracy.error:.2g} in scales of the states{moved}. "
        "A control that jumps between nodes needs nodes=tx.trajectory.Mesh(n, free=True), stiff rates "
        "Collocation(tx.tableaus.RADAU_IIA5); a larger refine= takes fewer nodes."
    )


def _trajectories(result: Any) -> list[Trajectory]:
    problem, point = result.problem, result.warm.point
    pairs = zip(problem.parts, problem.shooting.segments, strict=True)
    return [Trajectory(**trajectory_at(part, segment.of(point), result.params)) for part, segment in pairs]


def _states(trajectory: Trajectory) -> dict[str, Array]:
    """All states at the nodes, including those that bridges introduced."""
    return trajectory.xs | trajectory.added


def _finer(result: Any, errors: Sequence[Array], tolerance: float, is_settled: bool) -> tuple[Any, WarmStart] | None:
    """The problem on finer meshes, with a warm start; None if these would be too large."""
    problem, segments = result.problem, result.problem.shooting.segments
    meshes, splits = [], []
    for trajectory, segment, interval_errors in zip(_trajectories(result), segments, errors):
        part = trajectory.problem
        transcription, mesh = part.transcription, part.mesh
        wrong = ~(interval_errors <= tolerance)
        split = np.zeros(len(interval_errors), bool)
        if is_settled and wrong.any() and transcription.substeps < _SUBSTEPS:
            transcription = dataclasses.replace(transcription, substeps=2 * transcription.substeps)
        elif not is_settled or wrong.any():
            split = wrong | _marked(trajectory, segment.of(result.warm.point))
        middles = (mesh.shares[:-1] + 0.5 * mesh.widths)[split]
        shares = np.sort(np.concatenate([mesh.shares, middles]))
        numbers = np.arange(part.nodes) + np.append(0, np.cumsum(split))
        meshes.append(Remeshed(Mesh(shares, free=mesh.free or False), transcription, numbers))
        splits.append(split)
    if sum(interval_errors.mesh.nodes for interval_errors in meshes) > _NODES:
        return None
    again = problem.on(meshes)
    return again, _start(again, result, splits)


def _changes(part: StatedPhase, us: Array, ts: Array) -> Array:
    """(intervals,) the squared change of the controls about an interval, in their scales, times its length.

    For a continuous control, the k-th derivative is piecewise constant; its change is multiplied by the k-th power of
    the length.
    """
    lengths = np.diff(ts) / (ts[-1] - ts[0])
    changes = np.zeros(len(us))
    for name, place in part.shooting.local.controls.slices.items():
        if name == part.continuous.pace:
            continue
        jumps = np.pad(np.abs(np.diff(us[:, place], axis=0)), ((1, 1), (0, 0)))
        change = np.maximum(jumps[:-1], jumps[1:]) * lengths[:, None] ** part.continuous.rates.get(name, 0)
        most = change.max(axis=0)
        changes += ((change / np.where(most > 0.0, most, 1.0)) ** 2).sum(axis=1) * lengths
    return changes


def _marked(trajectory: Trajectory, point: Iterate) -> Array:
    """The smallest set of intervals that contains a given fraction of all changes, at least half of all intervals.

    The set is empty for a phase without controls.
    """
    changes = _changes(trajectory.problem, np.asarray(point.us), trajectory.ts)
    order, marked = np.argsort(-changes), np.zeros(len(changes), bool)
    if trajectory.problem.shooting.m:
        total = np.cumsum(changes[order])
        count = int(np.searchsorted(total, _SHARE * total[-1])) + 1
        marked[order[: max(count, int(np.ceil(_LEAST * len(changes))))]] = True
    return marked


def _start(problem: Any, result: Any, splits: Sequence[Array]) -> WarmStart:
    """A warm start on finer meshes: both halves of an interval have its controls, and half of its multipliers each."""
    warm, scales = result.warm, result.warm.scales
    old, new = result.problem.shooting, problem.shooting
    split = np.zeros(old.intervals, bool)
    xs, rows, sizes = [], [], []
    pairs = zip(old.segments, new.segments, _trajectories(result), result.accuracy.middles, splits, strict=True)
    for before, after, trajectory, middle, split_here in pairs:
        split[before.stages] = split_here
        states = _states(trajectory)
        if split_here.any():
            at = np.flatnonzero(split_here)
            states = {name: np.insert(a, at + 1, middle[name][at], axis=0) for name, a in states.items()}
        xs.append(states)
        moved = _Moved(before, after, split_here)
        rows.append(moved.of(old.rows_of(before, np.asarray(warm.rows)), 0.5))
        sizes.append(moved.of(old.rows_of(before, np.asarray(scales.rows))))
    parent = np.repeat(np.arange(old.intervals), 1 + split)
    row_scales = new.rows_of_all(sizes)
    alone = old.segments[0].alone
    return WarmStart(
        problem,
        Iterate(xs[0] if alone else tuple(xs), np.asarray(warm.point.us)[parent], np.asarray(warm.point.border)),
        _costates(warm.dynamics, split),
        new.rows_of_all(rows),
        scales._replace(
            d=np.asarray(scales.d)[np.append(0, parent + 1)],
            u=np.asarray(scales.u)[parent],
            rows=np.where(row_scales > 0.0, row_scales, 1.0),
        ),
        warm.params,
    )


def _costates(dynamics: Array, split: Array) -> Array:
    """Multipliers of the dynamics on the finer mesh, interpolated between nodes by their mean."""
    at = np.flatnonzero(split)
    before = dynamics[np.maximum(at - 1, 0)]
    return np.insert(dynamics, at, 0.5 * (before + dynamics[at]), axis=0)


class _Moved:
    """Maps values for the rows of a phase to its next mesh."""

    def __init__(self, old: PhaseSegment, new: PhaseSegment, split: Array) -> None:
        self._old, self._split = old.shooting, split
        self._parent = np.repeat(np.arange(self._old.intervals), 1 + split)
        layouts = self._old.layout, new.shooting.layout
        self._source, self._same = _columns(*layouts, self._old.substeps, new.shooting.substeps)

    def of(self, rows: Array, share: float | None = None) -> Array:
        """Each half of an interval gets a fraction of the interval's value; points without such a row before get zero.

        Without a fraction, each gets the value of the interval, or of the row before it.
        """
        inner, end = np.split(rows, [self._old.intervals * self._old.rows_per_interval])
        moved = inner.reshape(self._old.intervals, -1)[self._parent][:, self._source]
        if share is not None:
            moved = moved * np.where(self._same, np.where(self._split[self._parent], share, 1.0)[:, None], 0.0)
        return np.concatenate([moved.ravel(), end])


def _columns(old: RowLayout, new: RowLayout, substeps: int, finer: int) -> tuple[Array, Array]:
    """For each row of an interval on the next mesh: the row at its place or before it, and whether that is at its
    place.
    """
    points, row = np.divmod(new.path_indices, new.path_rows)
    place = points * substeps / finer
    where = {index: k for k, index in enumerate(old.path_indices)}
    source = [where.get(int(p) * new.path_rows + r, 0) for p, r in zip(place, row)]
    conditions = len(old.path_indices) + np.arange(new.at_nodes)
    same = np.concatenate([place == np.floor(place), np.ones(new.at_nodes, bool)])
    return np.concatenate([np.array(source, int), conditions]), same
