"""Run a scene by several methods and time them in turn."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import Scene
from ..progress import Tell
from ..rows import Row
from ..store import Store
from ..timing import Timed, in_turn, seconds_of
from .contender import Contender, Counts, Effort, Program

__all__ = ["WHAT", "Refusal", "measure_scene"]

#: What is measured of a scene.
WHAT = "one call"


@dataclasses.dataclass(frozen=True)
class Refusal:
    """A method that cannot run a scene, and why."""

    scene: str
    method: str
    reason: str


def measure_scene(
    scene: Scene, contenders: Iterable[Contender], effort: Effort, store: Store, tell: Tell
) -> list[Refusal]:
    """Run what is not in the store yet, time it in turn, and keep the rows.

    Returns:
        the methods that cannot run the scene.
    """
    refused: list[Refusal] = []
    runs: list[tuple[Row, Timed]] = []
    sitting = datetime.now().isoformat(timespec="seconds")
    methods = list(contenders)
    for number, contender in enumerate(methods):
        tell(f"compiling {contender.name}", 0.5 * number / len(methods))
        try:
            runs += _climb(scene, contender, effort, store, sitting)
        except tx.TwistaxError as error:
            refused.append(Refusal(scene.name, contender.name, str(error).splitlines()[0]))
    in_turn([timed for row, timed in runs if row.done], effort.repeats, tell)
    store.add([_with_times(row, timed) for row, timed in runs])
    return refused


def _with_times(row: Row, timed: Timed) -> Row:
    if not timed.samples:
        return row
    numbers = {**row.numbers, "fastest": timed.fastest, "repeats": float(len(timed.samples))}
    return dataclasses.replace(row, value=timed.seconds, numbers=numbers)


def _climb(
    scene: Scene, contender: Contender, effort: Effort, store: Store, sitting: str
) -> Iterator[tuple[Row, Timed]]:
    """From coarse to fine, one run each, except for rows that are there."""
    ladder = contender.ladder(effort)
    launch: _Launch | None = None
    for setting in ladder.rungs:
        named = f"{ladder.unit} {setting:g}"
        row = store.get(scene.name, WHAT, contender.name, named)
        if row is None:
            launch = launch or _Launch(contender.build(scene))
            numbers = {"setting": setting}
            row = Row(scene.name, WHAT, contender.name, named, unit="s", sitting=sitting, numbers=numbers)
            row, timed = launch.first(scene, row)
            yield row, timed
            seconds = timed.rough
        else:
            seconds = row.value
        if seconds > effort.longest or row.numbers.get("error", math.nan) < ladder.enough:
            return


class _Launch:
    """A program jitted, and how long it took to compile."""

    def __init__(self, program: Program) -> None:
        self._program, self._compile_seconds = program, math.nan
        self._run = jax.jit(program.solve, static_argnums=() if program.one_for_all else 1)

    def first(self, scene: Scene, row: Row) -> tuple[Row, Timed]:
        """The row of the first run with a setting, and what is timed."""
        try:
            timed = Timed(self._call(row.numbers["setting"]))
            end, counts = timed.result()
            timed.look()
        except (RuntimeError, ValueError) as error:  # diffrax raises where it gives up, from a callback
            if isinstance(error, ValueError) and "callback" not in str(error):
                raise
            lines = str(error).strip().splitlines()
            said = [line for line in lines if "RuntimeError" in line] or lines
            return dataclasses.replace(row, note=said[0].strip()[:80]), Timed(lambda: None, rough=0.0)
        good = bool(counts.good)
        state = {name: np.asarray(value) for name, value in self._program.state(end).items()}
        counted = {name: float(getattr(counts, name)) for name in ("evaluations", "accepted", "rejected")}
        numbers = {"error": float(scene.error(state)) if good else math.nan, "compile_seconds": self._compile_seconds}
        note = row.note if good else "did not reach the end"
        return dataclasses.replace(row, note=note, numbers={**row.numbers, **numbers, **counted}), timed

    def _call(self, setting: float) -> Callable[[], tuple[Any, Counts]]:
        """The compiled function with its arguments ready; compiles if need be."""
        run, start, one = self._run, self._program.start, self._program.one_for_all
        argument = jnp.asarray(setting) if one else setting

        def call() -> tuple[Any, Counts]:
            return run(start, argument)

        first = seconds_of(call)
        if not one or math.isnan(self._compile_seconds):
            self._compile_seconds = first - seconds_of(call)
        return call
