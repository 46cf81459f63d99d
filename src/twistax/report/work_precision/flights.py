"""The flights of one scene: compiled, compared with the truth, then timed in turn."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import Scene
from ..turns import SHORT, Tell, seconds_of, time_in_turn
from .contender import Contender, Counts, Program
from .effort import Effort
from .row import Row
from .store import Store

__all__ = ["Refused", "empty_call_seconds", "measure_scene"]


@dataclasses.dataclass(frozen=True)
class Refused:
    """A method that cannot fly a scene, and why."""

    scene: str
    method: str
    reason: str


@dataclasses.dataclass
class _Flight:
    """A flight that was flown once, and its samples of time, s."""

    row: Row
    call: Callable[[], Any]
    rough: float
    samples: list[float] = dataclasses.field(default_factory=list)

    def timed(self) -> Row:
        if not self.samples:
            return self.row
        samples = self.samples
        return dataclasses.replace(self.row, seconds=median(samples), fastest=min(samples), repeats=len(samples))


def measure_scene(
    scene: Scene, contenders: Iterable[Contender], effort: Effort, store: Store[Row], tell: Tell
) -> list[Refused]:
    """Fly what is not in the store yet, time it in turn, and keep the rows.

    Competing flights take turns, so that whatever else the machine does falls on all alike.

    Returns:
        the methods that cannot fly the scene.
    """
    refused: list[Refused] = []
    flights: list[_Flight] = []
    sitting = datetime.now().isoformat(timespec="seconds")
    methods = list(contenders)
    for number, contender in enumerate(methods):
        tell(f"compiling {contender.name}", 0.5 * number / len(methods))
        try:
            flights += _climb(scene, contender, effort, store, sitting)
        except tx.TwistaxError as error:
            refused.append(Refused(scene.name, contender.name, str(error).splitlines()[0]))
    time_in_turn([flight for flight in flights if flight.row.done], effort, tell)
    store.add(flight.timed() for flight in flights)
    return refused


def _climb(scene: Scene, contender: Contender, effort: Effort, store: Store[Row], sitting: str) -> Iterator[_Flight]:
    """Flights from coarse to fine, one each, except for rows that are there."""
    ladder = contender.ladder(effort)
    setting: float | None = ladder.first
    launch: _Launch | None = None
    while setting is not None:
        row = store.get(scene.name, contender.name, setting)
        if row is None:
            launch = launch or _Launch(contender.build(scene))
            flight = _first_flight(scene, contender, launch, setting, ladder.unit, sitting)
            yield flight
            error, seconds = flight.row.error, flight.rough
        else:
            error, seconds = row.error, row.seconds
        setting = None if seconds > effort.longest else ladder.after(setting, error)


class _Launch:
    """A program jitted, and how long it took to compile."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.compile_seconds = math.nan
        self._run = jax.jit(program.fly, static_argnums=() if program.one_for_all else 1)

    def call(self, setting: float) -> Callable[[], tuple[Any, Counts]]:
        """The compiled function with its arguments ready; compiles if need be."""
        run, start = self._run, self.program.start
        argument = jnp.asarray(setting) if self.program.one_for_all else setting
        begin = time.perf_counter()
        jax.block_until_ready(run(start, argument))
        first = time.perf_counter() - begin
        if not self.program.one_for_all or math.isnan(self.compile_seconds):
            self.compile_seconds = first - seconds_of(lambda: run(start, argument))
        return lambda: run(start, argument)


def _first_flight(
    scene: Scene, contender: Contender, launch: _Launch, setting: float, unit: str, sitting: str
) -> _Flight:
    row = Row(
        scene.name, contender.name, unit, setting, math.nan, math.nan, math.nan, 0, math.nan, 0, 0, 0, "failed", sitting
    )
    try:
        call = launch.call(setting)
        end, counts = call()
        rough = seconds_of(call)
        if rough < SHORT:
            rough = min(rough, seconds_of(call))
    except (RuntimeError, ValueError) as error:  # diffrax raises where it gives up, from a callback
        said = [line for line in str(error).splitlines() if "RuntimeError" in line] or str(error).strip().splitlines()
        if isinstance(error, ValueError) and "callback" not in str(error):
            raise
        return _Flight(dataclasses.replace(row, result=said[0].strip()[:80]), lambda: None, 0.0)
    good = bool(counts.good)
    state = {name: np.asarray(value) for name, value in launch.program.state(end).items()}
    row = dataclasses.replace(
        row,
        error=scene.error(state) if good else math.nan,
        compile_seconds=launch.compile_seconds,
        evaluations=int(counts.evaluations),
        accepted=int(counts.accepted),
        rejected=int(counts.rejected),
        result="done" if good else "did not reach the end",
    )
    return _Flight(row, call, rough)


def empty_call_seconds() -> float:
    """What calling a compiled function costs that does nothing: part of every time."""
    call = jax.jit(lambda x, setting: (x, setting))
    x, setting = {"R": jnp.eye(3), "w": jnp.ones(3)}, jnp.asarray(1.0)
    jax.block_until_ready(call(x, setting))
    return median(seconds_of(lambda: call(x, setting)) for _ in range(201))
