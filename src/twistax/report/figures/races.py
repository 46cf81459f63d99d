"""The time at an error of methods beside the best of diffrax, on one long-known top and one stiff body."""

from __future__ import annotations

import dataclasses
import functools
import math
import tempfile
from pathlib import Path

import twistax as tx

from ...scenes import SCENES, heavy_top
from ..checks import Between, Check, Section, at_most
from ..origin import origin_of
from ..progress import quiet
from ..store import Store
from ..timing import empty_call_seconds
from ..work_precision.contender import FULL, Contender, Line, Side, equal_steps, tolerances
from ..work_precision.contenders import CONTENDERS
from ..work_precision.findings import Curve
from ..work_precision.measure import measure_scene
from ..work_precision.own import Adaptive, EqualSteps

__all__ = ["SECTION", "race"]

#: A finer ladder than that of the report: an order of 8 falls far between its rungs.
_EFFORT = dataclasses.replace(FULL, tolerances=tolerances(-2, -12, 4), steps=equal_steps(100, 1.25, enough=1e-11))
_OWN = Line("", "", Side("twistax", ""), ("tab:blue", "-", "o"))


@functools.cache
def _contenders(scene: str) -> tuple[Contender, ...]:
    """Ours first. Every run on the top is one small call: diffrax does not offer that, but is faster for it."""
    if scene == "stiff-attitude":
        ours: list[Contender] = [
            Adaptive(tableau.name, _OWN, tx.ImplicitRKMK(tableau))
            for tableau in (tx.tableaus.RADAU_IIA5, tx.tableaus.RADAU_IIA9)
        ]
        return (*ours, CONTENDERS["diffrax-kvaerno5-pi"])
    body = tx.FreeBody("R", "w", inertia=heavy_top.INERTIA)
    splittings = (tx.compositions.KAHAN_LI6, tx.compositions.KAHAN_LI8)
    ours = [EqualSteps(each.name, _OWN, tx.Splitting(each, body)) for each in splittings]
    names = (f"diffrax-{solver}-call{gains}" for solver in ("tsit5", "dopri8") for gains in ("", "-pi"))
    return (*ours, *(CONTENDERS[name] for name in names))


@functools.cache
def race(scene: str) -> dict[str, Curve]:
    """The curve of each method, by name, all timed in turn; what a call costs that does nothing is taken off."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "rows.json", origin_of({}))
        measure_scene(SCENES[scene], _contenders(scene), _EFFORT, store, quiet)
    empty = empty_call_seconds()
    rows = [dataclasses.replace(row, value=row.value - empty) for row in store]
    return {each.name: Curve.of(row for row in rows if row.by == each.name) for each in _contenders(scene)}


def _ratio(scene: str, method: str, error: float) -> float:
    """The time of a method at an error over that of the best of diffrax; NaN where it does not get there."""
    times = {name: curve.time_at(error) for name, curve in race(scene).items()}
    best = min(time for name, time in times.items() if name.startswith("diffrax") and math.isfinite(time))
    return times[method] / best


def _check(scene: str, method: str, what: str, error: float, expected: Between) -> Check:
    return Check(what, method, functools.partial(_ratio, scene, method, error), expected, slow=True)


_KAHAN_LI8, _RADAU5, _RADAU9 = tx.compositions.KAHAN_LI8, tx.tableaus.RADAU_IIA5, tx.tableaus.RADAU_IIA9

SECTION = Section(
    "races",
    "The time at an error",
    "Over that of the best of diffrax: on the scene heavy-top, 20 s, of Tsit5 and Dopri8 in one small call; on the "
    "scene stiff-attitude, rate 1e5, of Kvaerno5 with PI control. All are timed in turn.",
    {
        "": [
            _check("heavy-top", _KAHAN_LI8.name, "heavy top, error 1e-9", 1e-9, at_most(0.5)),
            _check("stiff-attitude", _RADAU5.name, "stiff attitude hold, error 1e-6", 1e-6, at_most(0.15)),
            _check("stiff-attitude", _RADAU9.name, "stiff attitude hold, error 1e-6", 1e-6, at_most(0.15)),
            _check("stiff-attitude", _RADAU5.name, "stiff attitude hold, error 1e-9", 1e-9, Between()),
            _check("stiff-attitude", _RADAU9.name, "stiff attitude hold, error 1e-9", 1e-9, at_most(0.05)),
        ]
    },
)
