"""`python -m twistax report`: what is run, what its rows say (agreement, the time at an error, bars), and its page."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from statistics import geometric_mean, median
from typing import Any

import numpy as np

from ...scenes import SCENES
from ..checks import Report, at_most, judged
from ..page import Table, as_svg, duration, panels
from ..rows import ABSENT, KERNELS, Row, plain
from ..timing import Tell, empty_call_seconds
from .contenders import CONTENDERS, FULL, ONE_CALL, OURS, QUICK, SHIPPED, Contender, Side, measure_scene

#: Errors at which methods are compared.
TARGETS = (1e-6, 1e-9)
#: A method agrees with the truth if one of its runs comes this close.
_AGREED = 1e-6
#: Or if its finest run comes within so many of its tolerances: then it was only not run finer.
_TOLERANCES = 100.0
#: Errors below this are round-off, and have a logarithm.
_ROUND_OFF = 1e-16


def _error(row: Row) -> float:
    return row.numbers.get("error", math.nan)


# ---- agreement, asked before any times are compared -----------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Doubt:
    """A method that did not come close to the truth of a scene."""

    scene: str
    method: str
    best: float  # its smallest error; infinite where no run ended with a finite one
    excuse: str  # why that need not mean that it disagrees; empty where there is none

    @property
    def sentence(self) -> str:
        best = f"smallest error {self.best:.1e}, " if math.isfinite(self.best) else ""
        return f"{self.method} on {self.scene}: {best}{self.excuse or 'and does not fall: IT DISAGREES'}"


def doubts(rows: Iterable[Row]) -> list[Doubt]:
    """Methods whose errors do not get small."""
    runs: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        runs.setdefault((row.group, row.by), []).append(row)
    found = []
    for (scene, method), own in runs.items():
        # Numbers of steps grow, tolerances fall.
        sign = {row.key: 1.0 if row.setting.startswith("steps") else -1.0 for row in own}
        done = sorted((row for row in own if row.done), key=lambda row: sign[row.key] * row.numbers["setting"])
        best = min(filter(math.isfinite, map(_error, done)), default=math.inf)
        if best > _AGREED:
            found.append(Doubt(scene, method, best, _excuse(done)))
    return found


def _excuse(done: list[Row]) -> str:
    if not done:
        return "none of its runs reached the end"
    last = done[-1]
    if len(done) > 1 and _error(last) < 0.5 * _error(done[-2]):
        return "still falling where it was stopped"
    if last.setting.startswith("tolerance") and _error(last) <= _TOLERANCES * last.numbers["setting"]:
        return "as close as its tolerance asks where it was stopped"
    return ""


# ---- the time at an error -------------------------------------------------------------------------------------------


class Curve(tuple[Row, ...]):
    """The best runs of a line, from the fastest to the most accurate: each is slower and better than the one before."""

    @classmethod
    def of(cls, rows: Iterable[Row]) -> Curve:
        """The front of some rows; those without a time or an error are left out."""
        timed = [row for row in rows if row.done and math.isfinite(_error(row)) and math.isfinite(row.value)]
        front: list[Row] = []
        for row in sorted(timed, key=lambda row: (row.value, _error(row))):
            if not front or _error(row) < _error(front[-1]):
                front.append(row)
        return cls(front)

    def row_at(self, error: float) -> Row | None:
        """The fastest run that is accurate enough."""
        return next((row for row in self if _error(row) <= error), None)

    def time_at(self, error: float) -> float:
        """Seconds for an error, on straight lines between the runs in logarithms of both.

        Of an error that the fastest run undercuts it is the time of that run. NaN where no run is accurate enough:
        nothing is extrapolated.
        """
        *errors, at = (-math.log(max(value, _ROUND_OFF)) for value in (*map(_error, self), error))
        times = [math.log(row.value) for row in self]
        return math.exp(np.interp(at, errors, times, right=math.nan)) if self else math.nan


class Findings:
    """Rows put together by scene and line, without methods that disagree with the truth of a scene.

    The order of the contenders is that of tables.
    """

    def __init__(self, rows: Iterable[Row], contenders: Mapping[str, Contender] = CONTENDERS) -> None:
        self.rows = [row for row in rows if row.by in contenders]
        present = {row.by for row in self.rows}
        there = [contender for name, contender in contenders.items() if name in present]
        self.contenders = {each.name: each for each in there}
        self.doubts: list[Doubt] = doubts(self.rows)
        self.scenes: list[str] = list(dict.fromkeys(row.group for row in self.rows))
        #: The first contender of each line.
        self.lines = [each for i, each in enumerate(there) if each.title not in {other.title for other in there[:i]}]

    @property
    def agreed(self) -> bool:
        """Whether every method that was run far enough finds the same answers; one of ours must reach an end."""
        return not any(
            not doubt.excuse or (math.isinf(doubt.best) and self.contenders[doubt.method].side == OURS)
            for doubt in self.doubts
        )

    @functools.cache  # noqa: B019  lives as long as the report
    def curve(self, scene: str, line: Contender) -> Curve:
        """Of a line's runs of a scene, without methods that disagree."""
        out = {doubt.method for doubt in self.doubts if doubt.scene == scene and not doubt.excuse}
        own = [row for row in self.rows if row.group == scene and row.by not in out]
        return Curve.of(row for row in own if self.contenders[row.by].title == line.title)

    def time(self, scene: str, line: Contender, error: float) -> float:
        """Seconds for an error; NaN where the line does not get there."""
        return self.curve(scene, line).time_at(error)

    def ranking(self, scene: str, error: float, lines: Iterable[Contender]) -> list[tuple[float, Contender]]:
        """Seconds and line of those that reach an error, the fastest first."""
        times = [(self.time(scene, line, error), line) for line in lines]
        return sorted((each for each in times if math.isfinite(each[0])), key=lambda each: each[0])

    def best(self, scene: str, error: float, side: Side) -> tuple[float, Contender] | None:
        """The fastest line of a side."""
        return next(iter(self.ranking(scene, error, [line for line in self.lines if line.side == side])), None)

    def drawn(self, scene: str) -> list[Contender]:
        """The lines of the scene's figure: those meant to be drawn, or all there are if none of them was run."""
        there = [line for line in self.lines if self.curve(scene, line)]
        return [line for line in there if line.drawn] or there

    # ---- for somebody who must choose

    def advice(self, scenes: Iterable[str]) -> tuple[Contender, float, str, float] | None:
        """The line whose worst ratio to the fastest is the best, of those to be had by calling a library; and where."""
        lines, found = [line for line in self.lines if line.side.ready], []
        best = {(s, e): ranking[0][0] for s in scenes for e in TARGETS if (ranking := self.ranking(s, e, lines))}
        for line in lines if best else ():
            ratios = [(self.time(scene, line, error) / least, scene, error) for (scene, error), least in best.items()]
            if all(math.isfinite(ratio) for ratio, _, _ in ratios):
                found.append((line, *max(ratios)))
        return min(found, key=lambda each: each[1], default=None)

    def winners(self, error: float) -> list[tuple[str, list[str]]]:
        """Which line was the fastest on which scenes, the most successful first."""
        firsts: dict[str, list[str]] = {}
        for scene in self.scenes:
            for _, line in self.ranking(scene, error, self.lines)[:1]:
                firsts.setdefault(line.title, []).append(SCENES[scene].title)
        return sorted(firsts.items(), key=lambda item: -len(item[1]))

    def digits(self) -> list[tuple[str, float]]:
        """By what one more digit multiplies the time."""
        costs = {}
        for line in (line for line in self.lines if line.side == OURS and line.drawn):
            ratios = [self.time(s, line, TARGETS[1]) / self.time(s, line, TARGETS[0]) for s in self.scenes]
            if known := [ratio for ratio in ratios if math.isfinite(ratio)]:
                costs[line.title] = median(known) ** (1.0 / math.log10(TARGETS[0] / TARGETS[1]))
        return sorted(costs.items(), key=lambda item: -item[1])

    def ended_with(self, name: str, setting: float) -> list[float]:
        """The errors of a method with one tolerance."""
        rows = [row for row in self.rows if row.by == name and row.numbers["setting"] == setting and row.done]
        return [_error(row) for row in rows]

    def over(self, one: Contender, other: Contender) -> dict[str, float]:
        """The time of a line over that of another by scene: the mean over both errors."""
        ratios = {}
        for scene in self.scenes:
            both = [self.time(scene, one, error) / self.time(scene, other, error) for error in TARGETS]
            if known := [ratio for ratio in both if math.isfinite(ratio)]:
                ratios[SCENES[scene].title] = geometric_mean(known)
        return ratios

    def beside(self, side: Side) -> tuple[list[float], dict[float, list[str]]]:
        """Our time over that of a side wherever it gets, and where it is faster, by error."""
        ratios: list[float] = []
        faster: dict[float, list[str]] = {}
        for error, scene in itertools.product(TARGETS, self.scenes):
            if theirs := self.best(scene, error, side):
                ours = self.best(scene, error, OURS)
                ratios.append(ours[0] / theirs[0] if ours else math.inf)
                share = f"{1.0 / ratios[-1]:.2f} of our time" if ours else "none of ours got there"
                if ratios[-1] > 1.0:
                    faster.setdefault(error, []).append(f"{SCENES[scene].title} ({share})")
        return ratios, faster


# ---- bars: what we want to be true, said beforehand -----------------------------------------------------------------

#: Of a scene and a method, how diffrax is run ("-call": in one call), and the ratio allowed.
_BARS = json.loads(Path(__file__).with_name("bars.json").read_text())


def bar_rows(findings: Findings, scene: str) -> list[Row]:
    """Times over the better of diffrax's Tsit5 and Dopri8, of the methods that were run, at every error."""
    found = []
    for place, method, how, limit in _BARS if scene in findings.scenes else ():
        if place != scene or method not in findings.contenders:
            continue
        line, rivals = CONTENDERS[method], [CONTENDERS[f"diffrax-{solver}{how}"] for solver in ("tsit5", "dopri8")]
        for error in TARGETS:
            theirs = min((seconds for seconds, _ in findings.ranking(scene, error, rivals)), default=math.nan)
            ratio, what = findings.time(scene, line, error) / theirs, f"{SCENES[scene].title}, error {plain(error)}"
            found.append(judged(Row("bars", what, line.title, f"over {rivals[0].side.name}", ratio), at_most(limit)))
    return found


#: Scenes with a part so fast that it has died out: for implicit methods alone, as explicit ones cannot take a step.
STIFF = ("stiff-attitude", "actuator-lag", "stiff-joint")
_IMPLICIT = ("radau5", "radau5-quaternion", "diffrax-kvaerno5-pi")

#: Scenes so long that a run takes up to seconds: for a few methods of high order.
LONG = ("long-heavy-top", "spinning-satellite")
_HIGH_ORDER = ("dop853", "dop853-quaternion", "dopri8", "diffrax-dopri8-call-pi", "diffrax-dopri8-pi")

#: Those of the quick run.
_PLAIN = ("tsit5", "dop853", "dop853-quaternion", "diffrax-tsit5-call", "diffrax-dopri8-call-pi", "diffrax-tsit5")
IN_QUICK = (*_PLAIN, "radau5", "diffrax-kvaerno5-pi")
#: Scenes of the full run only: they take long to compile or to run.
TOO_LONG_FOR_QUICK = ("spring-bodies", "actuator-lag", "stiff-joint", *LONG)


def suited(contenders: Iterable[str], scene: str) -> list[str]:
    """Which of the methods, by name, are worth running a scene with, where nobody asked for others."""
    if scene in LONG:
        return [name for name in contenders if name in _HIGH_ORDER]
    return [name for name in contenders if (name in _IMPLICIT) == (scene in STIFF)]


class WorkPrecision(Report):
    name, template, title = "report", "work_precision", "Which integrator, and what does a digit cost?"

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self._asked = arguments.method
        chosen = arguments.method or (IN_QUICK if arguments.quick else CONTENDERS)
        self._contenders = {name: CONTENDERS[name] for name in CONTENDERS if name in chosen}
        left_out = TOO_LONG_FOR_QUICK if arguments.quick else ()
        self.parts = [name for name in SCENES if name in (arguments.scene or SCENES.keys() - left_out)]
        #: The scenes that a method cannot run, by method and reason.
        self._refused: dict[tuple[str, str], list[str]] = {}

    def measure(self, part: str, tell: Tell) -> None:
        chosen = [self._contenders[name] for name in self._asked or suited(self._contenders, part)]
        for refusal in measure_scene(SCENES[part], chosen, self._effort, self.store, tell).items():
            self._refused.setdefault(refusal, []).append(part)

    def _findings(self) -> Findings:
        return Findings(super().rows(), self._contenders)

    def rows(self) -> list[Row]:
        return self._findings().rows

    def bars(self, part: str) -> list[Row]:
        return bar_rows(self._findings(), part)

    def problems(self) -> list[str]:
        findings = self._findings()
        return [] if findings.agreed else [doubt.sentence for doubt in findings.doubts]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        findings = self._findings()
        return {name: functools.partial(draw, findings, name) for name in findings.scenes if findings.drawn(name)}

    def context(self) -> dict[str, Any]:
        kernels = self.store.origin.versions[KERNELS] != ABSENT
        more = {"refused": self._refused, "kernels": kernels, "empty_call": empty_call_seconds()}
        return context(self._findings()) | more


def context(findings: Findings) -> dict[str, Any]:
    """What the template says of the findings."""
    plainly = [name for name in findings.scenes if name not in (*STIFF, *LONG)]
    stiff = [name for name in findings.scenes if name in STIFF]
    sittings = {name: {row.sitting for row in findings.rows if row.group == name} for name in findings.scenes}
    return {
        "findings": findings,
        "targets": TARGETS,
        "names": {name: scene.title for name, scene in SCENES.items()},
        "advice": {"in doubt": findings.advice(plainly), "the system is stiff": findings.advice(stiff)},
        "contenders": CONTENDERS,
        "sides": [side for side in (OURS, SHIPPED, ONE_CALL) if any(line.side == side for line in findings.lines)],
        "rivals": (ONE_CALL, SHIPPED),
        "fastest": _fastest(findings),
        "scenes": {SCENES[name]: _times(findings, name) for name in findings.scenes},
        "apart": [SCENES[scene].title for scene, found in sittings.items() if len(found) > 1],
    }


def _fastest(findings: Findings) -> Table:
    rows, sides = [], (OURS, ONE_CALL, SHIPPED)
    for scene in findings.scenes:
        for error in TARGETS:
            best = [findings.best(scene, error, side) for side in sides]
            shown = [f"{each[1].title}: {duration(each[0])}" if each else "-" for each in best]
            ratios = [f"{best[0][0] / other[0]:.2f}" if best[0] and other else "-" for other in best[1:]]
            rows.append([SCENES[scene].title, plain(error), *shown, *ratios])
    return ["scene", "error", *(side.name for side in sides), "ours / one call", "ours / shipped"], rows, 5


def _times(findings: Findings, scene: str) -> Table:
    """Times are read between runs; evaluations and steps are those of the next better."""
    rows = []
    for line in findings.lines:
        curve = findings.curve(scene, line)
        if not curve:
            continue
        at = [row.numbers if row else {} for row in map(curve.row_at, TARGETS)]
        cells = [duration(curve.time_at(error)) for error in TARGETS]
        cells += [f"{n['evaluations']:.0f}" if n.get("evaluations") else "-" for n in at]
        cells += [f"{n['accepted'] + n['rejected']:.0f} ({n['rejected']:.0f})" if n else "-" for n in at]
        compiling = [s for row in curve if math.isfinite(s := row.numbers["compile_seconds"])]
        rows.append([line.title, *cells, f"{min(compiling):.2g} s" if compiling else "-"])
    rows.sort(key=lambda row: row[1] == "-")
    heads = [f"{what}, {plain(e)}" for what in ("time", "evaluations", "steps (rejected)") for e in TARGETS]
    return ["method", *heads, "compile"], rows, 1


def draw(findings: Findings, scene: str) -> bytes:
    """The figure of a scene as SVG: the best runs of each line that is drawn, connected."""
    labels = ("error at the end (to the right: more accurate)", "time of one call, ms (lower: faster)")
    figure = panels(SCENES[scene].title, labels, size=(7.0, 5.6))
    axes = figure.axes[0]
    for line in findings.drawn(scene):
        points = [(row.numbers["error"], 1e3 * row.value) for row in findings.curve(scene, line)]
        colour, dash, marker = line.style
        good = [(error, time) for error, time in points if error > 0.0] or [(math.nan, math.nan)]
        axes.loglog(*zip(*good, strict=True), color=colour, ls=dash, marker=marker, ms=4.5, lw=1.5, label=line.title)
    for target in TARGETS:
        axes.axvline(target, color="0.6", lw=0.8, ls="--", zorder=0)
    axes.set_xlim(1e-1, 1e-13)
    return as_svg(figure)
