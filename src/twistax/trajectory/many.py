"""Many cases of one problem at once: lanes that step together, each taking the next case when its own has ended."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..precision import in_double
from . import scaling
from .iterate import Scales
from .iterate import State as Iterate
from .solver import Outcome, Solver, jitted, unweighed
from .transcribed import Derivatives, Given, Point
from .watch import Status, Watch

#: The most lanes that step together.
LANES = 16
#: What happens to a lane next: its scales are measured, it begins at its point in its scales, goes into its scales,
#: steps, or rests.
_MEASURE, _BEGIN, _RESCALE, _STEP, _REST = range(5)


class _Lane:
    """What a lane is working on."""

    def __init__(self) -> None:
        self.case: int | None = None
        self.next = _REST

    def take(self, case: int) -> None:
        """The next case; first its scales are measured."""
        self.case, self.next = case, _MEASURE
        self.watch: Watch | None = None  # none until then
        self.renewed = False  # whether its scales were renewed since the last step
        self.probed: Outcome | None = None  # the solution whose bends are looked at


class Lanes:
    """Solves cases side by side, with the rules of `Solver.run`.

    Cases that need what is rare (a search for feasible points, another after a saddle) are left to that.
    """

    def __init__(self, solver: Solver, width: int) -> None:
        self._solver, self.width = solver, width
        method = solver.method
        self._unit = scaling.unit_scales(solver.shooting)

        def look(states: Iterate, givens: Given) -> tuple[Derivatives, Iterate]:
            """One after the other: what one needs stays in the processor's caches."""
            found: tuple[Derivatives, Iterate] = jax.lax.map(lambda own: method.looked_at(*own), (states, givens))
            return found

        def advance(
            state: Iterate,
            slopes: Derivatives,
            point: Point,
            given: Given,
            scales: Scales,
            what: jax.Array,
            probes: jax.Array,
        ) -> Iterate:
            probed = state._replace(damping=jnp.where(probes, solver.probe, state.damping))
            begun = method.start(point, given, scales)
            ways = [
                unweighed(begun),
                begun,
                method.rescaled(state, scales),
                method.step(probed, slopes, given),
                state,
            ]
            return jax.tree.map(lambda *own: jnp.stack(own)[what], *ways)

        self._look = jitted(look)
        self._advance = jitted(jax.vmap(advance))
        self._start = jitted(jax.vmap(method.start))

    def run(
        self, points: Point, givens: Given, cases: Callable[[], int | None], most: int
    ) -> dict[int, Outcome | None]:
        """The outcomes of the cases that `cases` hands out, until it gives None; None of those left to others.

        Args:
            points, givens: of all cases, arrays with a leading axis.
            most: iterations a case may take.
        """
        found: dict[int, Outcome | None] = {}
        lanes = [_Lane() for _ in range(self.width)]
        own = lambda tree: jax.tree.map(lambda a: np.array(np.broadcast_to(a[:1], (self.width, *a.shape[1:]))), tree)  # noqa: E731
        point, given = own(points), own(givens)
        scales = jax.tree.map(lambda a: np.array(np.broadcast_to(a, (self.width, *np.shape(a)))), self._unit)
        states = self._start(point, given, scales)
        slopes, measured, before = None, states, None
        while True:
            for k, lane in enumerate(lanes):
                if lane.case is None:
                    case = cases()
                    if case is None:
                        continue
                    lane.take(case)
                    _put(point, k, points, case)
                    _put(given, k, givens, case)
                    _put(scales, k, jax.tree.map(lambda a: np.asarray(a)[None], self._unit), 0)
            if all(lane.case is None for lane in lanes):
                return found
            if slopes is None:
                slopes, measured = self._look(states, given)
            probes = np.array([lane.case is not None and lane.probed is not None for lane in lanes])
            what = np.array([_REST if lane.case is None else lane.next for lane in lanes])
            states = self._advance(measured, slopes, point, given, scales, what, probes)
            before = np.asarray(states.barrier)
            slopes, measured = self._look(states, given)
            views = jax.tree.map(np.asarray, (measured, slopes))
            for k, lane in enumerate(lanes):
                if lane.case is not None:
                    self._decide(k, lane, lane.case, views, float(before[k]), scales, found, most)

    def _decide(
        self,
        k: int,
        lane: _Lane,
        case: int,
        views: tuple[Iterate, Derivatives],
        before: float,
        scales: Scales,
        found: dict[int, Outcome | None],
        most: int,
    ) -> None:
        """What the lane of a case does next, after it was looked at."""
        solver = self._solver
        state, slopes = jax.tree.map(lambda a: a[k], views)

        def end(outcome: Outcome | None) -> None:
            found[case] = outcome
            lane.case, lane.next = None, _REST

        if lane.watch is None:
            own, seen = solver.scales_of(state.point, slopes, self._unit)
            lane.watch, lane.next = solver.watch(seen, most), _BEGIN
            _put(scales, k, jax.tree.map(lambda a: np.asarray(a)[None], own), 0)
            return
        watch = lane.watch
        if lane.probed is not None and lane.next == _RESCALE:
            lane.next = _STEP
            return
        if lane.probed is not None:
            end(None if float(state.raised) > solver.bent else lane.probed)
            return
        if lane.next == _STEP and bool(state.stuck):
            end(None)
            return
        status = watch.at_once(state) if watch.count == 0 else None
        fresh = None if lane.renewed or status is not None else watch.renewed(state, slopes, before)
        if fresh is not None and watch.misled(state, fresh):
            end(None)
            return
        if fresh is not None:
            lane.next, lane.renewed = _RESCALE, True
            _put(scales, k, jax.tree.map(lambda a: np.asarray(a)[None], fresh), 0)
            return
        status = status or watch.ended(state)
        if status is None and watch.astray(state):
            end(None)
            return
        outcome = None if status is None else solver.outcome(jax.tree.map(np.array, state), status, watch.count)
        if status is not None and status is not Status.SOLVED:
            end(outcome)
            return
        lane.next, lane.renewed, lane.probed = _STEP, False, outcome
        watch.count += outcome is None
        levels = None if outcome is None else solver.levels(state.scales)
        if levels is not None:
            lane.next = _RESCALE
            _put(scales, k, jax.tree.map(lambda a: np.asarray(a)[None], levels), 0)


def _put(target: Any, k: int, source: Any, case: int) -> None:
    """Copy the entry of a case into a lane, in place."""

    def copy(a: Array, b: Array) -> None:
        a[k] = b[case]

    jax.tree.map(copy, target, source)


def solve_all(solver: Solver, lanes: Lanes, points: Point, givens: Given, most: int) -> list[Outcome]:
    """The outcomes of all cases, arrays with a leading axis, on all processors."""
    count = len(points.us)
    waiting = deque(range(count))

    def next_case() -> int | None:
        try:
            return waiting.popleft()
        except IndexError:
            return None

    def work(_: int) -> dict[int, Outcome | None]:
        with in_double():
            return lanes.run(points, givens, next_case, most)

    found: dict[int, Outcome | None] = {}
    threads = max(1, min(os.cpu_count() or 1, count // lanes.width))
    with ThreadPoolExecutor(threads) as pool:
        for own in pool.map(work, range(threads)):
            found |= own

    def alone(case: int) -> Outcome:
        point, given = jax.tree.map(lambda a: jnp.asarray(a[case]), (points, givens))
        return solver.run(point, given, most)

    return [found[case] or alone(case) for case in range(count)]
