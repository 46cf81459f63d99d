"""The time at an error of methods beside the best of diffrax, on one long-known top and one stiff body."""

from __future__ import annotations

import dataclasses
import functools
import math
import tempfile
from pathlib import Path
from typing import Any

import twistax as tx

from ...scenes import SCENES, heavy_top
from ..checks import Check, Expected, Section, at_most, between
from ..rows import Origin, Store, plain
from ..timing import empty_call_seconds
from ..work_precision.contenders import CONTENDERS, FULL, OURS, Contender, Line, equal_steps, ours, tolerances
from ..work_precision.findings import Curve
from ..work_precision.measure import measure_scene

#: A finer ladder than that of the report: an order of 8 falls far between its rungs.
_EFFORT = dataclasses.replace(FULL, tolerances=tolerances(-2, -12, 4), steps=equal_steps(100, 1.25), enough=1e-11)
_LINE = Line("", "", OURS, ("tab:blue", "-", "o"))


@functools.cache
def _contenders(scene: str) -> list[Contender]:
    """Ours first. Every run on the top is one small call: diffrax does not offer that, but is faster for it."""
    if scene == "stiff-attitude":
        tableaus = (tx.tableaus.RADAU_IIA5, tx.tableaus.RADAU_IIA9)
        radau = [ours(tableau.name, _LINE, tx.ImplicitRKMK(tableau)) for tableau in tableaus]
        return [*radau, CONTENDERS["diffrax-kvaerno5-pi"]]
    body = tx.FreeBody("R", "w", inertia=heavy_top.INERTIA)
    compositions = (tx.compositions.KAHAN_LI6, tx.compositions.KAHAN_LI8)
    splittings = [ours(each.name, _LINE, tx.Splitting(each, body), equal=True) for each in compositions]
    names = (f"diffrax-{solver}-call{gains}" for solver in ("tsit5", "dopri8") for gains in ("", "-pi"))
    return [*splittings, *(CONTENDERS[name] for name in names)]


@functools.cache
def race(scene: str) -> dict[str, Curve]:
    """The curve of each method, by name, all timed in turn; what a call costs that does nothing is taken off."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "rows.json", Origin.now({}))
        measure_scene(SCENES[scene], _contenders(scene), _EFFORT, store)
    empty = empty_call_seconds()
    rows = [dataclasses.replace(row, value=row.value - empty) for row in store]
    return {each.name: Curve.of(row for row in rows if row.by == each.name) for each in _contenders(scene)}


def _ratio(scene: str, method: str, error: float) -> float:
    """The time of a method at an error over that of the best of diffrax; NaN where it does not get there."""
    times = {name: curve.time_at(error) for name, curve in race(scene).items()}
    best = min(time for name, time in times.items() if name.startswith("diffrax") and math.isfinite(time))
    return times[method] / best


def _stiff(tableau: Any, error: float, expected: Expected) -> Check:
    measure = functools.partial(_ratio, "stiff-attitude", tableau.name, error)
    return Check(f"stiff attitude hold, error {plain(error)}", tableau.name, measure, expected, slow=True)


_KAHAN_LI8, _RADAU5, _RADAU9 = tx.compositions.KAHAN_LI8.name, tx.tableaus.RADAU_IIA5, tx.tableaus.RADAU_IIA9

RACES = Section(
    "races",
    [
        Check(
            "heavy top, error 1e-9", _KAHAN_LI8, lambda: _ratio("heavy-top", _KAHAN_LI8, 1e-9), at_most(0.5), slow=True
        ),
        _stiff(_RADAU5, 1e-6, at_most(0.15)),
        _stiff(_RADAU9, 1e-6, at_most(0.15)),
        _stiff(_RADAU5, 1e-9, between()),
        _stiff(_RADAU9, 1e-9, at_most(0.05)),
    ],
)
