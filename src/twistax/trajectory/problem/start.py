"""The start and the data of a solve, from the arguments of `Problem.solve`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...checks import listed, short
from ...errors import InputError, ModelError
from ...expr import State
from ...system import name_of
from ..transcription.iterate import Instance, Iterate, PhaseEnds
from .conditions import Ends
from .guess import resample, with_stated


class Started(NamedTuple):
    """The start of a solve, its data, its parameters and the ends of its phases."""

    point: Iterate
    instance: Instance
    params: dict[str, Array]
    ends: list[Ends]


def started(
    problem: Any,
    guess: Mapping[Any, Any] | None = None,
    *,
    initial: Mapping[Any, Any] | None = None,
    final: Mapping[Any, Any] | None = None,
    params: Mapping[Any, Any] | None = None,
    final_time: Any = None,
    final_time_guess: Any = None,
    free: Mapping[Any, Any] | None = None,
    sizes: Sequence[Mapping[str, Array]] | None = None,
    begin: Iterate | None = None,
) -> Started:
    """The start and the data of a solve with these arguments, as NumPy arrays in double precision.

    Args:
        begin: the start of the solve, in place of guesses.
        sizes: typical sizes of the controls of each phase, by name, for the bounds of norms that are zero at the start.
    """
    arguments = {"guess": guess, "initial": initial, "final": final}
    arguments |= {"final_time": final_time, "final_time_guess": final_time_guess}
    of_phases = zip(*(by_phase(problem, f"solve: {what}", value) for what, value in arguments.items()))
    ends, times, guesses = [], [], []
    for part, name, of_phase in zip(problem.parts, problem.names, of_phases):
        with problem.errors_of(name):
            ends.append(part.other_ends(*of_phase[1:3]))
            times.append(part.other_times(*of_phase[3:]))
            guesses.append(part.checked_guess(of_phase[0]))
    if params is not None and not isinstance(params, Mapping):
        raise InputError(f"solve: params must be a dict from parameters to values, got {short(params)}")
    values = problem.params
    if params is not None:
        values = problem.values(problem.params | {name_of(key): value for key, value in params.items()})
    limits = problem.border.limited(np.array([limit for limit, _ in times]), free)
    if begin is None:
        durations = np.array([time for _, time in times])
        begin = _start(problem, values, ends, guesses, durations, limits, sizes or [{}] * len(problem.parts))
    initials, finals = (
        tuple(part.filled(getattr(side_ends, side)) for part, side_ends in zip(problem.parts, ends))
        for side in ("initial", "final")
    )
    fixed = finals[0] if problem.alone else PhaseEnds(initials, finals)
    margins = np.zeros(len(problem.shooting.exists))
    return Started(begin, Instance(dict(values), fixed, limits, margins), values, ends)


def by_phase(problem: Any, what: str, values: Any) -> list[Any]:
    """A value for each phase, or None, from a dict by names of phases.

    Raises:
        ModelError: not a dict; the name of no phase.
    """
    if problem.alone:
        return [values]
    if values is not None and not isinstance(values, Mapping):
        raise ModelError(f"{what} expects a dict from names of phases, got {short(values)}")
    for name in values or {}:
        if not isinstance(name, str) or name not in problem.names:
            raise ModelError(f"{what} names {name_of(name)!r}; the phases are: {listed(problem.names, name)}")
    return [(values or {}).get(name) for name in problem.names]


def axes(problem: Any) -> dict[str, Any]:
    """The number of axes of each argument of `started`, in dicts of the arguments' structure."""
    params = {name: value.ndim for name, value in problem.params.items()}
    if problem.alone:
        axes = problem.parts[0].axes()
        return axes | {"guess": params | axes["guess"], "params": params}
    every = {name: part.axes() for name, part in zip(problem.names, problem.parts)}
    whats = ("guess", "initial", "final", "final_time")
    return {what: {name: axes[what] for name, axes in every.items()} for what in whats} | {"params": params}


def _start(
    problem: Any,
    params: Mapping[str, Array],
    ends: Sequence[Ends],
    guesses: Sequence[dict[str, Array]],
    durations: Array,
    limits: Array,
    sizes: Sequence[Mapping[str, Array]],
) -> Any:
    """The guesses of all phases. States without a guess are interpolated between the values that are known at the ends
    of phases.
    """
    if problem.alone:
        return problem.parts[0].start(guesses[0], ends[0], params, durations, limits, sizes[0])
    guess = {name: value for phase_guess in guesses for name, value in phase_guess.items()}
    free = {box.name: guess[box.name] for box in problem.border.boxes if box.name in guess}
    us = np.zeros((problem.shooting.intervals, problem.shooting.m))
    known = [_with_stated(side, part.stated_values(params)) for side, part in zip(ends, problem.parts)]
    xs: list[Any] = []
    for index, part in enumerate(problem.parts):
        began = {name: np.asarray(xs[0][name][0]) for name in part.functionals.starts if index}
        guess = _between(problem, index, known, durations) | guesses[index] | free | began
        point = part.start(guess, ends[index], params, durations, limits, sizes[index])
        values = part.border.params(np.asarray(point.border))
        free |= {box.name: values[box.name] for box in part.bounds}
        segment = problem.shooting.segments[index]
        us[segment.stages, : segment.shooting.m] = point.us
        xs.append(point.xs)
    return Iterate(tuple(xs), us, point.border)


def _between(problem: Any, index: int, ends: Sequence[Ends], durations: Array) -> dict[str, Array]:
    """Values at both ends of a phase for states that continue across phases, interpolated between known values."""
    between, times = {}, np.concatenate([[0.0], np.cumsum(durations)])
    for state in problem.parts[index].dynamics.states:
        if state.guess is not None:
            continue
        known: dict[int, Array] = {}
        for step, side in ((-1, "initial"), (1, "final")):
            at = index
            while 0 <= at < len(problem.parts):
                values = getattr(ends[at], side).get(state.name)
                if values is not None and not np.isnan(values).any():
                    known[at + (side == "final")] = values
                    break
                at += step
                join = at if step < 0 else at - 1
                if not 0 <= at < len(problem.parts) or not _goes_on(problem, join, state):
                    break
        if len(known) == 2 and set(known) != {index, index + 1}:
            (first, a), (last, b) = sorted(known.items())
            share = (times[[index, index + 1]] - times[first]) / (times[last] - times[first])
            fine = resample(state.group, np.stack([a, b]), np.linspace(0.0, 1.0, 101))
            between[state.name] = fine[np.rint(100.0 * share).astype(int)]
        elif len(known) == 1:
            between[state.name] = np.stack([*known.values()] * 2)
    return between


def _goes_on(problem: Any, join: int, state: State) -> bool:
    """Whether a state is continuous at a transition between phases."""
    source = problem.sources[join].get(state.name)
    return isinstance(source, State) and source.key() == state.key()


def _with_stated(ends: Ends, end_values: tuple[dict[str, Array], dict[str, Array]]) -> Ends:
    """End values whose free entries are replaced by the values that conditions prescribe."""
    initial, final = (
        {name: with_stated(value, values.get(name)) for name, value in side.items()}
        for side, values in zip((ends.initial, ends.final), end_values)
    )
    return dataclasses.replace(ends, initial=initial, final=final)
