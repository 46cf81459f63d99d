"""Integration of successive phases: systems that are connected where events or times end them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...checks import listed, number, short
from ...errors import InputError, IntegrationError, ModelError, in_phase
from ...jax_inside import is_traced, is_tracing
from ...progress import watching
from ...system import free_name
from ...system.dynamics import Dynamics, need_compiled
from ...system.inputs import precision
from ...units import same_unit, seconds
from ..events.conditions import Event
from ..integrate import integrated
from ..loop.outcome import Result
from ..loop.progress_callback import ProgressCallback, callback_of
from ..loop.rollout import ended_well
from ..loop.unreached import nan_unless
from ..options import FlightOptions, Options, StepOptions, with_options
from ..results.solution import Solution
from ..times import check_saves
from .links import Link, check_link, linked
from .phased_solution import PhasedSolution


@dataclasses.dataclass(frozen=True, eq=False)
class Phase(StepOptions):
    """One phase of a flight: `tx.integrate_phases([tx.Phase(...), tx.Phase(...)], x0, ...)`.

    Phases with the same system and equal options compile once, for all parameters, durations and initial states.

    Args:
        dynamics: a compiled system.
        duration: duration of the phase, s; with an event, the longest duration.
        t1: the end time, or with an event the latest end time, s, in place of `duration`.
        event: a `tx.Event`, or a list of them, whose first root ends the phase. Without an event the phase ends by
            time. A phase whose event does not occur fails.
        params: values of parameters in this phase, which override those passed to `integrate_phases`.
        u: the controls of this phase, in place of those passed to `integrate_phases`; tables use the time since the
            start of the first phase.
        jumps, dt, steps, rtol, atol, method, control: as for `tx.integrate`, in place of those passed to
            `integrate_phases`.
        name: its name in results and messages; "phase 0", "phase 1", ... by default.

    Raises:
        InputError, ModelError: invalid arguments, raised by `integrate_phases` with the name of the phase.
    """

    dynamics: Dynamics
    _: dataclasses.KW_ONLY
    duration: Any = None
    t1: Any = None
    event: Any = None
    params: Mapping[str, Any] | None = None
    u: Any = None
    jumps: Any = None
    name: str | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class PhasesOptions(FlightOptions):
    """The options of `tx.integrate_phases`."""

    links: Sequence[Link] | None = None


@with_options(PhasesOptions)
def integrate_phases(phases: Sequence[Phase], x0: Mapping[str, Any], options: PhasesOptions) -> PhasedSolution:
    """Integrate successive phases: a stage separates, a ball bounces, a parachute opens.

    Time continues from phase to phase. States of the same name and kind continue too, except for those in `links`.
    Derivatives take the transitions into account: the time of an event depends on the inputs, and so does the start of
    the next phase.

    Args:
        phases: one or more `tx.Phase`, with the same or with different systems.
        x0: the initial state of the first phase, a dict by state name.
        links: one for each transition, one fewer than phases: a dict from states of the next phase to numbers or to
            expressions of the last states of the previous phase, of its parameters and of time; or a traceable function
            f(t, x, params) that returns such a dict; or None. Values on a group are elements of it.
        t0: the start of the first phase in s.
        dt, steps, rtol, atol, method, control, between, dense: as for `tx.integrate`, for every phase.
        u: the controls of every phase: a dict from which each phase uses its own controls, or a function of t.
        params: parameter values of all phases and links, by name.
        save_at: sorted times, s. Times before the start raise an error, times after the end are ignored. By default the
            ends of phases are saved.
        throw: whether to raise an error if a phase fails or its event does not occur. Otherwise the phases before the
            failure are returned, with `result`.
        progress: as for `tx.integrate`; each phase counts as an equal fraction.

    Returns:
        `PhasedSolution`: a `Solution` for each phase, and their common states as one solution. If arguments are traced,
            states that were not reached are NaN.

    Raises:
        InputError, ModelError: the errors of `tx.integrate`, with the name of the phase; a parameter that no phase has.
        IntegrationError: a phase failed, or its event did not occur. The message names the phase, by number and name.
    """
    return _Flight(phases, options).flown(x0)


class _Flight:
    """A checked integration of phases."""

    def __init__(self, phases: Sequence[Phase], options: PhasesOptions) -> None:
        self.phases, self.options = phases, options
        self.names, self.labels = _named(phases)
        self.params = dict(options.params or {})
        self.joins = _checked(phases, self.labels, options.links, self.params, options.u)
        self.callback = None if options.progress is None else callback_of(options.progress)
        # Which rows a phase has is known only where its times are.
        self.on_grid = options.save_at is not None and is_tracing()

    @watching("integrate")
    def flown(self, x0: Mapping[str, Any]) -> PhasedSolution:
        options, phases, save_at = self.options, self.phases, self.options.save_at
        dtype = precision(x0, self.params)
        same_unit("t0", options.t0, seconds)
        if save_at is not None:
            known = not is_traced((options.t0, save_at))
            first = float(number("t0", options.t0, "a finite time in s")) if known else 0.0
            check_saves(save_at, (first, max(first, float(np.max(save_at, initial=first)))) if known else None)
        t, x = options.t0, x0
        solutions: list[Solution] = []
        begins: list[tuple[Any, Mapping[str, Any]]] = []
        code: Any = Result.SUCCESS.value
        for index, label in enumerate(self.labels):
            with in_phase(label):
                solution = self._one(index, t, x, dtype)
            begins, solutions = [*begins, (t, x)], [*solutions, solution]
            good = ended_well(solution.code)
            code = solution.code if not index else jnp.where(ended_well(code), solution.code, code)
            if not is_traced(solution.code) and not good:
                break
            if index < len(phases) - 1:
                with in_phase(label):
                    t, x = self._next(index, solution, good)
        if self.callback is not None and not is_traced(solutions[-1].ts):
            self.callback(float(solutions[-1].ts[-1]), 1.0)
        dtype = solutions[0].ts.dtype
        t_starts = tuple(jnp.asarray(t, dtype) for t, _ in begins)
        starts = tuple({name: jnp.asarray(value) for name, value in x.items()} for _, x in begins)
        save_at = None if save_at is None else jnp.asarray(save_at, dtype)
        names = tuple(self.names[: len(solutions)])
        return PhasedSolution(tuple(solutions), starts, t_starts, code, save_at, names, self.on_grid)

    def _one(self, index: int, t: Any, x: Mapping[str, Any], dtype: Any) -> Solution:
        phase, options = self.phases[index], self.options
        limit, save_at, progress = _limit(phase, t), options.save_at, options.progress
        known = {leaf.name for leaf in phase.dynamics.parameters} | set(phase.params or {})
        names = {leaf.name for leaf in phase.dynamics.controls}
        u = options.u
        if isinstance(u, Mapping):
            u = {name: value for name, value in u.items() if name in names}
        if save_at is not None:
            save_at = _saved_times(save_at, t, limit, dtype, self.on_grid, _by_event(phase))
        if self.callback is not None:
            progress = _phase_progress(self.callback, index, len(self.phases))
        phase_options = Options(
            t0=t,
            t1=limit,
            **phase.over(options),
            jumps=phase.jumps,
            u=u if phase.u is None else phase.u,
            params={name: value for name, value in self._params(phase).items() if name in known},
            save_at=save_at,
            between=options.between,
            dense=options.dense,
            event=phase.event,
            throw=options.throw,
            progress=progress,
        )
        solution = integrated(phase.dynamics, x, phase_options)
        return _checked_end(solution, limit, options.throw) if _by_event(phase) else solution

    def _params(self, phase: Phase) -> dict[str, Any]:
        return self.params | dict(phase.params or {})

    def _next(self, index: int, solution: Solution, good: Any) -> tuple[Any, dict[str, Any]]:
        t: Any = solution.ts[-1]
        end = {name: value[-1] for name, value in solution.xs.items()}
        if is_traced(solution.code):
            t, end = nan_unless(good, (t, end))
        else:
            t = t if is_traced(t) else np.asarray(t)
        before, after = self.phases[index], self.phases[index + 1]
        params = self._params(before)
        x = linked(f"links[{index}]", self.joins[index], before.dynamics, after.dynamics, t, end, params)
        return t, x


def _phase_progress(callback: ProgressCallback, index: int, count: int) -> ProgressCallback:
    """The progress callback of one phase, which counts as an equal share of all."""
    return lambda t, share: callback(t, (index + share) / count)


def _named(phases: Any) -> tuple[list[str], list[str]]:
    """The names of phases, and their names in messages."""
    if not isinstance(phases, (list, tuple)) or not phases:
        raise InputError(f"integrate_phases expects a list of tx.Phase(...), got {short(phases)}")
    names: list[str] = []
    labels: list[str] = []
    for index, phase in enumerate(phases):
        if not isinstance(phase, Phase):
            raise InputError(f"integrate_phases expects a list of tx.Phase(...); number {index} is {short(phase)}")
        if not isinstance(phase.name, str | None):
            raise InputError(f"phase {index}: name must be a text, got {short(phase.name)}")
        names.append(free_name(phase.name or f"phase {index}", names))
        labels.append(f"phase {index}, {phase.name!r}" if phase.name else f"phase {index}")
    return names, labels


def _checked(
    phases: Sequence[Phase], labels: list[str], links: Any, params: Mapping[str, Any], controls: Any
) -> list[Link]:
    """The link of every join, after all checks that are possible before an integration."""
    count = len(phases) - 1
    if links is not None and (not isinstance(links, (list, tuple)) or len(links) != count):
        raise ModelError(
            f"links expects a list of length {count}, one entry for each transition between phases, got {short(links)}"
        )
    joins: list[Link] = list(links or [None] * count)
    for phase, label in zip(phases, labels, strict=True):
        with in_phase(label):
            need_compiled("Phase", phase.dynamics)
            if (phase.duration is None) == (phase.t1 is None):
                what = "neither" if phase.t1 is None else "both"
                raise InputError(
                    f"a phase expects duration or t1, got {what}.\n  fix: with an event, pass the longest duration"
                )
            for what, values in (("duration", phase.duration), ("t1", phase.t1)):
                same_unit(what, values, seconds)
                if values is not None:
                    number(what, values, "a finite time in s" if what == "t1" else "a finite length of time in s")
            if not isinstance(phase.params, Mapping | None):
                raise InputError(f"params expects a dict by name, got {short(phase.params)}")
    known = {leaf.name for phase in phases for leaf in phase.dynamics.parameters}
    for index, link in enumerate(joins):
        known |= check_link(f"links[{index}]", link, phases[index].dynamics, phases[index + 1].dynamics)
    wanted = {leaf.name for phase in phases for leaf in phase.dynamics.controls}
    by_name = controls if isinstance(controls, Mapping) else {}
    for what, values, there in (("params", params, known), ("u", by_name, wanted)):
        unknown = [name for name in values if name not in there]
        # What a function reads is not known.
        if unknown and not (what == "params" and any(map(callable, joins))):
            raise InputError(f"unknown key {unknown[0]!r} in {what}; all phases have: {listed(there, unknown[0])}")
    return joins


def _by_event(phase: Phase) -> bool:
    events = phase.event if isinstance(phase.event, (list, tuple)) else [phase.event]
    return any(isinstance(event, Event) and event.terminal for event in events)


def _limit(phase: Phase, t: Any) -> Any:
    """The latest end of the phase. Raises InputError for an end before its start; NaN for a traced one."""
    if is_traced((t, phase.t1, phase.duration)):
        t = jnp.asarray(t)
        end = t + jnp.asarray(phase.duration, t.dtype) if phase.t1 is None else jnp.asarray(phase.t1, t.dtype)
        return jnp.where(end < t, jnp.nan, end)
    end = float(t) + float(phase.duration) if phase.t1 is None else phase.t1
    if float(end) < float(t):
        raise InputError(
            f"the phase ends at {float(end):g}, before its start at {float(t):g}.\n"
            "  fix: phases must go forward in time; only tx.integrate can go backward"
        )
    return end


def _saved_times(save_at: Any, t: Any, limit: Any, dtype: Any, on_grid: bool, by_event: bool) -> Any:
    """The saved times of a phase: its start, those within, and its end, which an event adds itself.

    On a grid every phase has rows for all times; those that it does not cover lie on its start or its end.
    """
    array: Any = jnp if on_grid else np
    start, end, times = (array.asarray(value, dtype) for value in (t, limit, save_at))
    times = array.clip(times, start, end) if on_grid else times[(times > start) & (times < end)]
    return array.concatenate([start[None], times, *([] if by_event else [end[None]])])


def _checked_end(solution: Solution, limit: Any, throw: bool) -> Solution:
    """The solution, marked as failed if the phase ended without its event. Raises IntegrationError."""
    missed = solution.code == Result.SUCCESS.value
    if is_traced(solution.code):
        return dataclasses.replace(solution, code=jnp.where(missed, Result.NO_EVENT.value, solution.code))
    if not missed:
        return solution
    if throw:
        sizes = ", ".join(f"|{k}| = {np.abs(np.asarray(v[-1])).max(initial=0.0):.3g}" for k, v in solution.xs.items())
        raise IntegrationError(
            f"no event occurred before the latest end of the phase, t = {float(limit):.6g} s.\n"
            "  likely cause: the condition keeps its sign, or crosses zero in the other direction\n"
            f"  last state: {sizes} (largest entries)\n"
            "  fix: use a longer duration, or check the event; throw=False returns the solution up to this time"
        )
    return dataclasses.replace(solution, code=Result.NO_EVENT.value)
