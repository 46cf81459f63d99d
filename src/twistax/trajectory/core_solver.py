"""The solver's core on a transcribed problem: units, a solve, and what came out in the terms of this package."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..solver.core import Solution, solve
from ..solver.core import Status as CoreStatus
from ..solver.options import Options
from .iterate import Errors, Scales
from .outcome import Outcome
from .sizes import Sizes, measured_sizes
from .staged import Staged
from .transcribed import Given, Point, Values
from .watch import Status

#: The core's tolerance over that of a solve: limits that are squares of small numbers need it.
_CLOSER = 1e-2
#: The core's unit of the objective over what moves of all unknowns by their sizes change of it: the barrier parameter
#: begins at 0.1 of that unit.
_COST = 0.1
#: The largest turn of a step, rad; and the largest move of anything else, in its sizes.
_TURN, _FARTHEST = 1.5, 30.0

_POINTER = ctypes.c_void_p

#: What the core says, in the words of this package.
_STATUS = {
    CoreStatus.SOLVED: Status.SOLVED,
    CoreStatus.MAX_ITERATIONS: Status.MAX_ITERATIONS,
    CoreStatus.INFEASIBLE: Status.INFEASIBLE,
    CoreStatus.NON_FINITE: Status.NON_FINITE,
    CoreStatus.STOPPED: Status.OUT_OF_TIME,
}


class Evaluated:
    """Values and derivatives of a problem in stages at a point, by its functions."""

    def __init__(self, staged: Staged, z: Array) -> None:
        transcription = staged.transcription
        stages, functions = transcription.stages, transcription.functions
        self.stages = stages
        self.cost, self.c = np.zeros(1), np.zeros(sum(stages.after))
        self.h, self.e = np.zeros(sum(stages.inequalities)), np.zeros(sum(stages.equalities))
        self.gradient = np.zeros(stages.variables)
        counts = (stages.after, stages.inequalities, stages.equalities)
        self.F, self.Jh, self.Je = (np.zeros(stages.block_sizes(rows)) for rows in counts)
        self.H = np.zeros(stages.block_sizes(stages.columns))
        self._z, self._functions = np.ascontiguousarray(z), functions
        self._failed = self._call("values", self.cost, self.c, self.h, self.e)
        transcription.check()

    def _call(self, name: str, *arrays: Any) -> int:
        kinds = [ctypes.c_double if isinstance(a, float) else _POINTER for a in arrays]
        function = ctypes.CFUNCTYPE(ctypes.c_int32, _POINTER, _POINTER, *kinds)(getattr(self._functions, name))
        pointers = [a if isinstance(a, float) else a.ctypes.data for a in arrays]
        return int(function(self._functions.user, self._z.ctypes.data, *pointers))

    def differentiate(self) -> bool:
        """First derivatives, and the second ones of the cost; whether there are such."""
        zeros = [np.zeros_like(a) for a in (self.c, self.h, self.e)]
        failed = self._failed or self._call("jacobians", self.gradient, self.F, self.Jh, self.Je)
        return not (failed or self._call("hessians", 1.0, *zeros, self.H))

    def bends(self, y: Array, ye: Array) -> Array:
        """Second derivatives of y . h + ye . e."""
        H = np.zeros_like(self.H)
        self._call("hessians", 0.0, np.zeros_like(self.c), y, ye, H)
        return H

    def blocks(self, flat: Array, rows: Any) -> list[Array]:
        """The matrices (rows, columns) of all stages."""
        sizes = [r * n for r, n in zip(rows, self.stages.columns)]
        parts = np.split(flat, np.cumsum(sizes)[:-1])
        return [a.reshape(n, r).T for a, r, n in zip(parts, rows, self.stages.columns)]


class Units:
    """Units for the core at a start.

    Attributes:
        parts: sizes of states, controls and shared unknowns, of each phase.
        v: of all variables.
        rows, equalities, cost: of the rows and the objective.
    """

    def __init__(self, staged: Staged, point: Point) -> None:
        at = Evaluated(staged, staged.flat(point))
        good, stages = at.differentiate(), at.stages
        blocks = at.blocks(at.F, stages.after)
        self.parts = self._measured(staged, point, blocks if good else [np.zeros_like(b) for b in blocks])
        self.border = np.max([sizes.border for sizes in self.parts], axis=0)
        by_stage = self._by_stage(staged)
        self.v = np.concatenate([*by_stage, self.border])
        columns = [np.concatenate([own, self.border]) for own in by_stage]
        slopes = [at.blocks(flat, rows) for flat, rows in ((at.Jh, stages.inequalities), (at.Je, stages.equalities))]
        changes = [np.concatenate([np.zeros(0), *(np.abs(b) @ c for b, c in zip(own, columns))]) for own in slopes]
        for places in staged.places_alone():
            weights = [np.zeros(len(change)) for change in changes]
            for weight, at_place in zip(weights, places):
                weight[at_place] = 1.0
            bends = [c @ np.abs(H) @ c for c, H in zip(columns, at.blocks(at.bends(*weights), stages.columns))]
            for change, own, at_place in zip(changes, staged.stages_of_rows, places):
                change[at_place] += 0.5 * np.array(bends)[own[at_place]]
        self.rows, self.equalities = staged.levelled_rows(*changes)
        bends = sum(c @ np.abs(H) @ c for c, H in zip(columns, at.blocks(at.H, stages.columns)))
        moves = np.abs(at.gradient) @ self.v + 0.5 * bends
        self.cost = float(moves) if np.isfinite(moves) and moves > 0.0 else 1.0

    @staticmethod
    def _measured(staged: Staged, point: Point, blocks: list[Array]) -> list[Sizes]:
        found, sizes_of = list[Sizes](), dict[str, Array]()
        for part, segment in zip(staged.parts, staged.transcribed.segments):
            own, first = part.shooting, part.stages.start
            moved = np.stack(blocks[first : first + own.intervals])
            moved = np.where(np.isfinite(moved).all(), moved, 0.0)
            sizes = measured_sizes(own, segment.of(point), moved)
            for name, other in own.alike.items():  # an extreme counts as what it is one of, in all phases alike
                slices = own.dynamics.group.slices
                sizes_of.setdefault(name, sizes.d[slices.get(other, slices[name])])
                sizes.d[slices[name]] = sizes_of[name]
            found.append(sizes)
        return found

    def _by_stage(self, staged: Staged) -> list[Array]:
        """Of the unknowns of each stage."""
        found = list[Array]()
        for number, (part, sizes) in enumerate(zip(staged.parts, self.parts)):
            found += [np.concatenate([sizes.d, sizes.u])] * part.shooting.intervals
            join = part.phase.join
            free = np.zeros(0) if join is None else self.parts[number + 1].d[join.free]
            found.append(np.concatenate([sizes.d, free]))
        return found


class CoreSolver:
    """Solves a transcribed problem by the core; what it needs compiles once.

    Args:
        problem: of one phase or of several.
        given: what it is solved for, for shapes.
        tolerance: of the first-order conditions, scaled.
    """

    def __init__(self, problem: Any, given: Given, tolerance: float) -> None:
        self.transcribed, self.tolerance = problem.shooting, tolerance
        self.staged = Staged(problem.shooting, problem.parts, given)

    def run(self, start: Point, given: Given, max_iterations: int, **options: float) -> Outcome:
        """Solve from a start."""
        staged, point = self.staged, Point(*(_arrays(a) for a in start))
        staged.transcription.set_data(staged.numbers.vector(given))
        units = Units(staged, point)
        chosen = {"tolerance": _CLOSER * self.tolerance, "iterations": max_iterations, "row_relaxation": 0.0, **options}
        result = solve(
            staged.transcription.stages,
            staged.transcription.functions,
            *staged.limits(point, given),
            staged.flat(point),
            staged.coordinates(point),
            size=units.v,
            row_size=units.rows,
            equality_size=units.equalities,
            cost_size=_COST * units.cost,
            largest_step=np.where(staged.turning, _TURN, _FARTHEST * units.v),
            options=Options(**chosen),
        )
        self.result = result
        return self.outcome(result, units, given)

    def outcome(self, result: Solution, units: Units, given: Given) -> Outcome:
        """What came out."""
        staged, own = self.staged, self.transcribed
        at = Evaluated(staged, result.z)
        point = staged.point(result.z)
        lower, upper = staged.limits(point, given)

        def of_bounds(below: Array, above: Array) -> Callable[[int], Array]:
            def chosen(number: int) -> Array:
                places = staged.bound_places[number]
                return np.where(staged.parts[number].bounds.upper, above[places], below[places])

            return chosen

        rows = staged.rows(at.h, at.e, of_bounds(lower - result.v, result.v - upper))
        w = staged.rows(result.y, result.ye, of_bounds(result.zl, result.zu))
        sizes = staged.rows(units.rows, units.equalities, of_bounds(units.v, units.v))
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        inequality = own.exists & ~own.equality
        slack = np.where(inequality, np.maximum(-rows, 0.0), 1.0)
        scales = self._scales(units, sizes)
        defects, dynamics = (self._padded(a) for a in (at.c, result.lam))
        violated = np.where(own.equality, np.abs(rows), np.maximum(rows, 0.0)) / sizes
        violated = np.where(own.exists | own.decided, violated, 0.0)
        gap = (np.abs(w) * np.where(inequality, slack, np.abs(rows)))[own.exists].sum()
        gap += np.abs(dynamics * defects).sum()
        numbers = result.statistics
        ratio = _COST  # of the core's unit of the cost to this one
        return Outcome(
            point=point,
            values=Values(at.cost[0], defects, rows),
            errors=Errors(
                numbers["stationarity"] * ratio,
                numbers["violation"],
                numbers["complementarity"] * ratio,
                gap / units.cost,
            ),
            dynamics=dynamics,
            rows=w,
            scaled_rows=w * sizes / units.cost,
            slack=slack,
            violations=np.concatenate([(np.abs(defects) / scales.d[1:]).ravel(), violated]),
            scales=scales,
            status=_STATUS.get(result.status, Status.STALLED),
            iterations=max(int(numbers["iterations"]), 1),
        )

    def _padded(self, flat: Array) -> Array:
        """Numbers of all defects as (intervals, n)."""
        own = self.transcribed
        found, at = np.zeros((own.intervals, own.n)), 0
        for stage, count in enumerate(self.staged.transcription.stages.after[:-1]):
            found[stage, :count] = flat[at : at + count]
            at += count
        return found

    def _scales(self, units: Units, rows: Array) -> Scales:
        own = self.transcribed
        d, u = np.ones((own.nodes, own.n)), np.ones((own.intervals, own.m))
        for number, (part, sizes) in enumerate(zip(self.staged.parts, units.parts)):
            first, shooting = part.stages.start, part.shooting
            d[part.stages, : shooting.n] = sizes.d
            u[first : first + shooting.intervals, : shooting.m] = sizes.u
            if part.phase.join is not None:
                free = part.phase.join.free
                u[first + shooting.intervals, : len(free)] = units.parts[number + 1].d[free]
        return Scales(d, u, units.border, rows, np.asarray(units.cost))


def _arrays(tree: Any) -> Any:
    if isinstance(tree, tuple):
        return tuple(map(_arrays, tree))
    return {name: np.asarray(a) for name, a in tree.items()} if isinstance(tree, dict) else np.asarray(tree)
