"""Run a scene by several methods and time them in turn."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Sequence
from datetime import datetime

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import Scene
from ..rows import Row, Store
from ..timing import Tell, Timed, keep, quiet, seconds_of
from .contenders import Contender, Effort

#: What is measured of a scene.
WHAT = "one call"


def measure_scene(
    scene: Scene, contenders: Sequence[Contender], effort: Effort, store: Store, tell: Tell = quiet
) -> dict[str, str]:
    """Run what is not in the store yet, time it in turn, and keep the rows.

    Returns:
        the methods that cannot run the scene, and why.
    """
    refused: dict[str, str] = {}
    runs: list[tuple[Row, Timed | None]] = []
    sitting = datetime.now().isoformat(timespec="seconds")
    for number, contender in enumerate(contenders):
        tell(f"compiling {contender.name}", 0.5 * number / len(contenders))
        try:
            runs += _climb(scene, contender, effort, store, sitting)
        except tx.TwistaxError as error:
            refused[contender.name] = str(error).splitlines()[0]
    keep(runs, effort.repeats, store, tell)
    return refused


def _climb(
    scene: Scene, contender: Contender, effort: Effort, store: Store, sitting: str
) -> Iterator[tuple[Row, Timed | None]]:
    """From coarse to fine, one run each, except for rows that are there."""
    unit, enough = ("steps", effort.enough) if contender.equal else ("tolerance", 0.0)
    launch: _Launch | None = None
    for setting in effort.steps if contender.equal else effort.tolerances:
        named = f"{unit} {setting:g}"
        row = store.get(scene.name, WHAT, contender.name, named)
        if row is None:
            launch = launch or _Launch(contender, scene)
            row = Row(scene.name, WHAT, contender.name, named, unit="s", sitting=sitting, numbers={"setting": setting})
            row, timed = launch.first(row)
            yield row, timed
            seconds = timed.rough if timed else 0.0
        else:
            seconds = row.value
        if seconds > effort.longest or row.numbers.get("error", math.nan) < enough:
            return


class _Launch:
    """A program jitted, and how long it took to compile."""

    def __init__(self, contender: Contender, scene: Scene) -> None:
        self._scene, self._program, self._equal = scene, contender.build(scene), contender.equal
        self._run = jax.jit(self._program.solve, static_argnums=1 if self._equal else ())
        self._compile_seconds = math.nan

    def first(self, row: Row) -> tuple[Row, Timed | None]:
        """The row of the first run with a setting, and what is timed."""
        setting = row.numbers["setting"]
        arguments = self._program.start, setting if self._equal else jnp.asarray(setting)
        try:
            if self._equal or math.isnan(self._compile_seconds):
                self._compile_seconds = seconds_of(lambda: self._run.lower(*arguments).compile())
            timed = Timed(functools.partial(self._run, *arguments))
            end, counts = timed.result()
            timed.look()
        except (RuntimeError, ValueError) as error:  # diffrax raises where it gives up, from a callback
            if isinstance(error, ValueError) and "callback" not in str(error):
                raise
            lines = str(error).strip().splitlines()
            said = [line for line in lines if "RuntimeError" in line] or lines
            return dataclasses.replace(row, note=said[0].strip()[:80]), None
        good = bool(counts.good)
        state = {name: np.asarray(value) for name, value in self._program.state(end).items()}
        numbers = {"error": float(self._scene.error(state)) if good else math.nan}
        numbers |= {"compile_seconds": self._compile_seconds}
        numbers |= {name: float(getattr(counts, name)) for name in ("evaluations", "accepted", "rejected")}
        note = row.note if good else "did not reach the end"
        return dataclasses.replace(row, note=note, numbers={**row.numbers, **numbers}), timed
