"""Problems of several phases: each with a system of its own, one after another, joined at their ends."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..checks import listed, reals, short
from ..errors import InputError, ModelError, ShapeError, in_phase
from ..expr import Expr, Parameter, State, leaves_of, to_expr
from ..system import free_name, name_of
from ..system.dynamics import need_compiled
from .border import Border, boxes_of
from .by_node import only_once
from .cases import PhasedResults, phased_results
from .conditions import Ends
from .found import Tried
from .functionals import Initial
from .guess import resample
from .joined import Join, Joined, told_before
from .mesh import Remeshed
from .phase import Phase, as_dict, asked, names_read
from .phased_result import PhasedResult, best_of_phases
from .problem import Problem
from .reduction import InPhase, functionals_of
from .solving import Solvable, Started
from .statement import Objective, check_leaves
from .transcribed import Given, PhaseEnds, Point
from .warm import other_problem


class PhasedProblem(Solvable[PhasedResult, PhasedResults]):
    """Phases in order, with the sum of their objectives.

    States of the same name and kind go on unchanged from phase to phase. Time goes on, too. Parameters of the same name
    are the same in all phases.

    Args:
        phases: one or more `Phase`.
        links: for every join, one fewer than phases, a dict from states of the next phase to expressions of the last
            states of the phase before and of parameters, or None to leave a state free; None for a join without any.
        params: values of parameters; those left out take their own.
        free: parameters that the optimiser may move, as for a `Problem`; those that links read, too.

    Raises:
        ModelError, ShapeError, TrajectoryError, InputError: as for a `Problem`, with the phase's name in front.
    """

    shooting: Joined

    def __init__(
        self,
        phases: Sequence[Any],
        links: Sequence[Mapping[Any, Any] | None] | None = None,
        *,
        params: Mapping[Any, Any] | None = None,
        free: Any = None,
    ) -> None:
        strangers = [phase for phase in phases if not isinstance(phase, Phase)]
        if strangers or not phases:
            got = short(strangers[0]) if strangers else "none"
            raise ModelError(f"Problem expects a compiled system, or a list of tx.trajectory.Phase(...), got {got}")
        #: What it was stated with.
        self._phases, self._stated = list(phases), {"links": links, "params": params, "free": free}
        self.names: list[str] = []
        for index, phase in enumerate(phases):
            self.names.append(free_name(phase.name or f"phase {index}", self.names))
        count = len(phases) - 1
        if links is not None and (not isinstance(links, (list, tuple)) or len(links) != count):
            raise ModelError(f"links expects a list of {count}, one for each join of two phases, got {short(links)}")
        kinds = {type(phase.objective) for phase in phases if phase.objective is not None}
        if not kinds or len(kinds) > 1 or not all(issubclass(kind, Objective) for kind in kinds):
            raise ModelError(
                "phases expect tx.Minimize(...) in one of them at least and tx.Maximize(...) in none, or the other way "
                f"round, got {listed(sorted(kind.__name__ for kind in kinds))}"
            )
        self.none: Objective = kinds.pop()(0.0)
        given, free = {name_of(key): value for key, value in (params or {}).items()}, as_dict(free)
        carried = [[leaf for leaf in functionals_of(*asked(p)) if isinstance(leaf, Initial)] for p in phases]
        within = [
            InPhase(name, tuple(itertools.chain(*carried[index:])), first=index == 0)
            for index, name in enumerate(self.names)
        ]
        self._parts = [self._part(index, phase, given, free, within[index]) for index, phase in enumerate(phases)]
        self.sources = [self._linked(index, (links or [None] * count)[index]) for index in range(count)]
        self._share(given, free)
        self.build()

    def __repr__(self) -> str:
        named = [f"{name}: {part!r}" for name, part in zip(self.names, self.parts)]
        return f"{type(self).__name__}({', '.join(named)})"

    def _part(
        self, index: int, phase: Phase, params: Mapping[str, Any], free: Mapping[Any, Any], within: InPhase
    ) -> Problem:
        """The problem that a phase alone would be."""
        need_compiled("Phase", phase.dynamics)
        name, last = self.names[index], index == len(self.names) - 1
        initial, final = (
            list(end) if isinstance(end, (list, tuple)) else [] if end is None else [end]
            for end in (phase.initial, phase.final)
        )
        # What leaves declare themselves are the ends of the whole.
        none = dict.fromkeys((s.name for s in phase.dynamics.states), None)
        read = names_read(phase)
        with in_phase(name):
            return Problem(
                phase.dynamics,
                self.none if phase.objective is None else phase.objective,
                nodes=phase.nodes,
                final_time=phase.final_time,
                final_time_guess=phase.final_time_guess,
                initial=initial if index == 0 else [none, *initial],
                final=final if last else [none, *final],
                at=phase.at,
                params={key: value for key, value in params.items() if key in read},
                free={key: value for key, value in free.items() if name_of(key) in read},
                by_node=phase.by_node,
                controls=phase.controls,
                guess=phase.guess,
                transcription=phase.transcription,
                method=phase.method,
                substeps=phase.substeps,
                hessian=phase.hessian,
                _within=within,
            )

    def _linked(self, index: int, links: Mapping[Any, Any] | None) -> dict[str, Expr | None]:
        """State of the next phase -> what it begins as, in terms of the last states; None where that is free."""
        before, after = (self.parts[i].dynamics for i in (index, index + 1))
        place = f"links[{index}]"
        if links is not None and not isinstance(links, Mapping):
            raise ModelError(f"{place} expects a dict from states to expressions, got {short(links)}")
        known, last = {s.name: s for s in after.states}, {s.name: s for s in before.states}
        found: dict[str, Expr | None] = {}
        for name, state in known.items():
            same = name in last and last[name].key() == state.key()
            found[name] = last[name] if same else None
        found |= self.parts[index + 1].restated.at_join
        for key, value in (links or {}).items():
            name = name_of(key)
            if name not in known:
                raise ModelError(
                    f"{place} names {name!r}; the states of {self.names[index + 1]!r} are: {listed(known, name)}"
                )
            found[name] = None
            if value is not None:
                expr = to_expr(value)
                if expr.shape != known[name].shape:
                    raise ShapeError(f"{place}[{name!r}] expects shape {known[name].shape}, got {expr.shape}")
                check_leaves(before, f"{place}[{name!r}]", expr, controls=False)
                for leaf in leaves_of(expr):
                    leaf.check_in_system()
                found[name] = expr.canonicalize()
        return found

    def _share(self, params: Mapping[str, Any], free: Mapping[Any, Any]) -> None:
        """One set of parameters and of unknowns that all phases share."""
        links = [e for own in self.sources for e in own.values() if e is not None]
        leaves = {leaf.name: leaf for e in links for leaf in leaves_of(e) if isinstance(leaf, Parameter)}
        leaves |= {leaf.name: leaf for part in self.parts for leaf in part.readable}
        unknown = [name for name in params if name not in leaves]
        if unknown:
            raise InputError(f"unknown key {unknown[0]!r} in params; expected: {listed(leaves, unknown[0])}")
        baked = {name for part in self.parts for name in part.baked} - set(leaves)
        boxes = (*boxes_of(free, leaves.values(), baked), *(box for part in self.parts for box in part.bounds))
        limits = np.array([part.time_limits for part in self.parts])
        self.border = Border(tuple(f"duration of {name}" for name in self.names), limits, boxes)
        self.leaves = leaves
        only_once([part.by_node for part in self.parts])
        self.params = self._values(params)

    def _values(self, params: Mapping[str, Any]) -> dict[str, Array]:
        """All parameters, checked."""
        found: dict[str, Array] = {}
        for part, name in zip(self.parts, self.names):
            for key, value in part.params.items():
                if key in found and not np.array_equal(found[key], value) and key not in params:
                    raise ModelError(
                        f"the parameter {key!r} has another value in {name!r} than in a phase before.\n"
                        f"  fix: pass params={{{key!r}: ...}}, or give it another name"
                    )
                found.setdefault(key, value)
        middle = {box.name: np.clip(np.zeros(box.shape), box.min, box.max) for box in self.border.boxes}
        for name, leaf in self.leaves.items():
            value = params.get(name, found.get(name, leaf.value if leaf.value is not None else middle.get(name)))
            if value is None:
                raise InputError(
                    f"links read the parameter {name!r}, which has no value; pass params={{{name!r}: ...}}"
                )
            own = next((part.by_node for part in self.parts if name in part.by_node.leaves), None)
            if own is not None:
                found[name] = own.values(name, value)
                continue
            found[name] = reals(f"params[{name!r}]", value, InputError)
            if found[name].shape != leaf.shape:
                raise ShapeError(f"params[{name!r}] expects shape {leaf.shape}, got {found[name].shape}")
            if not np.isfinite(found[name]).all():
                raise InputError(f"params[{name!r}] expects finite numbers, got {short(value)}")
        return found

    def build(self) -> None:
        """What compiles."""
        for index, part in enumerate(self.parts):
            part.as_phase(index, self.border)
        joins = []
        for before, after, sources in zip(self.parts, self.parts[1:], self.sources):
            ends = after.ends
            joins.append(Join(before.shooting, after.shooting, sources, ends.initial, ends.initial_fixed))
            last = {s.name: s for s in before.dynamics.states}
            same = {name for name, source in sources.items() if source is last.get(name) and ends.initial[name] is None}
            told_before(before.shooting, after.shooting, same)
        self.shooting = Joined([part.shooting for part in self.parts], joins, self.names)
        self.built()

    def __getstate__(self) -> dict[str, Any]:
        """Without what compiles anew in another process."""
        return {k: v for k, v in self.__dict__.items() if k not in ("shooting", "_cores", "_implicit")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self.build()

    # ---- what a solve starts from, and what it gives ----------------------------------------------------------------

    def on(self, meshes: Sequence[Remeshed]) -> PhasedProblem:
        every = zip(self._phases, self.parts, meshes, strict=True)
        found = [dataclasses.replace(p, by_node=part.by_node, **own.stated(p.at)) for p, part, own in every]
        return PhasedProblem(found, **self._stated)

    def transcribed_by(self, transcription: Any) -> PhasedProblem:
        other = {"transcription": transcription, "method": None, "substeps": None}
        return PhasedProblem([dataclasses.replace(phase, **other) for phase in self._phases], **self._stated)

    @property
    def soft(self) -> set[str]:
        """The names of soft constraints, entry by entry."""
        return {f"{name}: {row}" for name, part in zip(self.names, self.parts) for row in part.soft}

    @property
    def parts(self) -> Sequence[Problem]:
        return self._parts

    @property
    def sign(self) -> float:
        return self.none.sign

    def started(
        self,
        guess: Mapping[Any, Any] | None = None,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        params: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        final_time_guess: Any = None,
        free: Mapping[Any, Any] | None = None,
        sizes: Sequence[Mapping[str, Array]] | None = None,
        begin: Point | None = None,
    ) -> Started:
        """What `solve` with these arguments starts from and is for; in double precision."""
        given = {"guess": guess, "initial": initial, "final": final}
        given |= {"final_time": final_time, "final_time_guess": final_time_guess}
        by_phase = {what: self._by_phase(what, own) for what, own in given.items()}
        ends, times, guesses = [], [], []
        for part, name in zip(self.parts, self.names):
            own = {what: of_phases.get(name) for what, of_phases in by_phase.items()}
            with in_phase(name):
                ends.append(part.other_ends(own["initial"], own["final"]))
                times.append(part.other_times(own["final_time"], own["final_time_guess"]))
                guesses.append(part.own_guess | part.checked_guess(own["guess"]))
        if params is not None and not isinstance(params, Mapping):
            raise InputError(f"solve: params must be a dict from parameters to values, got {short(params)}")
        unknown = [name for name in map(name_of, params or {}) if name not in self.leaves]
        if unknown:
            raise InputError(f"unknown key {unknown[0]!r} in params; expected: {listed(self.leaves, unknown[0])}")
        found = self.params
        if params is not None:
            found = self._values(self.params | {name_of(key): value for key, value in params.items()})
        limits = self.border.limited(np.array([limit for limit, _ in times]), free)
        durations, own_sizes = np.array([time for _, time in times]), sizes or [{} for _ in self.parts]
        point = self._start(found, ends, guesses, durations, limits, own_sizes) if begin is None else begin
        first, last = (
            tuple(part.filled(getattr(own, side)) for part, own in zip(self.parts, ends))
            for side in ("initial", "final")
        )
        margins = np.zeros(len(self.shooting.exists))
        return Started(point, Given(dict(found), PhaseEnds(first, last), limits, margins), found, ends)

    def _by_phase(self, what: str, given: Any) -> dict[str, Any]:
        """An argument by the name of the phase."""
        if given is not None and not isinstance(given, Mapping):
            raise ModelError(f"solve: {what} expects a dict from names of phases, got {short(given)}")
        for name in given or {}:
            if not isinstance(name, str) or name not in self.names:
                raise ModelError(f"solve: {what} names {name_of(name)!r}; the phases are: {listed(self.names, name)}")
        return dict(given or {})

    def at_ends(self, xs: Any, ends: Sequence[Ends]) -> Any:
        """States at the nodes with what ends fix in place.

        Raises:
            TrajectoryError: they are those of another problem.
        """
        if not isinstance(xs, tuple) or len(xs) != len(self.parts):
            raise other_problem()
        return tuple(part.at_ends(own, side) for part, own, side in zip(self.parts, xs, ends))

    def axes(self) -> dict[str, Any]:
        """How many axes each argument of `started` has."""
        found: dict[str, Any] = {
            what: {name: part.axes()[what] for name, part in zip(self.names, self.parts)}
            for what in ("guess", "initial", "final", "final_time")
        }
        return found | {"params": {name: value.ndim for name, value in self.params.items()}}

    def result(self, tried: Tried) -> PhasedResult:
        return best_of_phases(self, tried)

    def results(self, tried: Sequence[Tried]) -> PhasedResults:
        return phased_results(self, tried)

    def _start(
        self,
        params: Mapping[str, Array],
        ends: Sequence[Ends],
        guesses: Sequence[dict[str, Array]],
        durations: Array,
        limits: Array,
        sizes: Sequence[Mapping[str, Array]],
    ) -> Point:
        """The guesses of the phases; states without one go between what is known of them at the ends of phases."""
        guess = {name: value for own in guesses for name, value in own.items()}
        free = {box.name: guess[box.name] for box in self.border.boxes if box.name in guess}
        us = np.zeros((self.shooting.intervals, self.shooting.m))
        xs: list[Any] = []
        for index, part in enumerate(self.parts):
            began = {name: np.asarray(xs[0][name][0]) for name in part.reduced.starts if index}
            own = self._between(index, ends, durations) | guesses[index] | free | began
            point = part.start(own, ends[index], params, durations, limits, sizes[index])
            found = part.border.params(np.asarray(point.border))
            free |= {box.name: found[box.name] for box in part.bounds}
            segment = self.shooting.segments[index]
            us[segment.stages, : segment.shooting.m] = point.us
            xs.append(point.xs)
        return Point(tuple(xs), us, point.border)

    def _between(self, index: int, ends: Sequence[Ends], durations: Array) -> dict[str, Array]:
        """Values at both ends of a phase, of states that go on from others or into them, along geodesics."""
        found, times = {}, np.concatenate([[0.0], np.cumsum(durations)])
        for state in self.parts[index].dynamics.states:
            if state.guess is not None:
                continue
            known: dict[int, Array] = {}
            for step, side in ((-1, "initial"), (1, "final")):
                at = index
                while 0 <= at < len(self.parts):
                    values = getattr(ends[at], side).get(state.name)
                    if values is not None and not np.isnan(values).any():
                        known[at + (side == "final")] = values
                        break
                    at += step
                    join = at if step < 0 else at - 1
                    if not 0 <= at < len(self.parts) or not self._goes_on(join, state):
                        break
            if len(known) == 2 and set(known) != {index, index + 1}:
                (first, a), (last, b) = sorted(known.items())
                share = (times[[index, index + 1]] - times[first]) / (times[last] - times[first])
                fine = resample(state.group, np.stack([a, b]), np.linspace(0.0, 1.0, 101))
                found[state.name] = fine[np.rint(100.0 * share).astype(int)]
            elif len(known) == 1:
                found[state.name] = np.stack([*known.values()] * 2)
        return found

    def _goes_on(self, join: int, state: State) -> bool:
        """Whether a state is the same on both sides of a join."""
        source = self.sources[join].get(state.name)
        return isinstance(source, State) and source.key() == state.key()
