"""Evaluation of the rows of scenes: which methods agree with the exact solution, the time at an error, advice, and
bars.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import geometric_mean, median

import numpy as np

from ...scenes import SCENES
from ..harness.expected import at_most, judged
from ..harness.rows import ReportRow, plain
from .integrators import INTEGRATORS, OURS, Integrator, Provider

#: Errors at which methods are compared.
TARGETS = (1e-6, 1e-9)
#: A method agrees with the truth if one of its runs comes this close.
_AGREED = 1e-6
#: Or if its finest run comes within so many of its tolerances: then it was only not run finer.
_TOLERANCES = 100.0
#: Errors below this are round-off, and have a logarithm.
_ROUND_OFF = 1e-16


def _error(row: ReportRow) -> float:
    return row.numbers.get("error", math.nan)


# ---- agreement, checked before any times are compared ---------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Doubt:
    """A method that does not converge to the exact solution of a scene."""

    scene: str
    method: str
    best: float  # its smallest error; infinite where no run ended with a finite one
    excuse: str  # why that need not mean that it disagrees; empty where there is none

    @property
    def sentence(self) -> str:
        best = f"smallest error {self.best:.1e}, " if math.isfinite(self.best) else ""
        return f"{self.method} on {self.scene}: {best}{self.excuse or 'and does not fall: IT DISAGREES'}"


def doubts(rows: Iterable[ReportRow]) -> list[Doubt]:
    """The methods whose errors do not become small on a scene."""
    runs: dict[tuple[str, str], list[ReportRow]] = {}
    for row in rows:
        runs.setdefault((row.group, row.by), []).append(row)
    result = []
    for (scene, method), of_method in runs.items():
        # Numbers of steps grow, tolerances fall.
        sign = {row.key: 1.0 if row.setting.startswith("steps") else -1.0 for row in of_method}
        done = sorted((row for row in of_method if row.done), key=lambda row: sign[row.key] * row.numbers["setting"])
        best = min(filter(math.isfinite, map(_error, done)), default=math.inf)
        if best > _AGREED:
            result.append(Doubt(scene, method, best, _excuse(done)))
    return result


def _excuse(done: list[ReportRow]) -> str:
    if not done:
        return "none of its runs reached the end"
    last = done[-1]
    if len(done) > 1 and _error(last) < 0.5 * _error(done[-2]):
        return "still falling where it was stopped"
    if last.setting.startswith("tolerance") and _error(last) <= _TOLERANCES * last.numbers["setting"]:
        return "as close as its tolerance asks where it was stopped"
    return ""


# ---- the time at an error -------------------------------------------------------------------------------------------


class Curve(tuple[ReportRow, ...]):
    """The best runs of a line, from the fastest to the most accurate: each is slower and better than the one before."""

    @classmethod
    def of(cls, rows: Iterable[ReportRow]) -> Curve:
        """The front of some rows; those without a time or an error are left out."""
        timed = [row for row in rows if row.done and math.isfinite(_error(row)) and math.isfinite(row.value)]
        front: list[ReportRow] = []
        for row in sorted(timed, key=lambda row: (row.value, _error(row))):
            if not front or _error(row) < _error(front[-1]):
                front.append(row)
        return cls(front)

    def row_at(self, error: float) -> ReportRow | None:
        """The fastest run that is accurate enough."""
        return next((row for row in self if _error(row) <= error), None)

    def time_at(self, error: float) -> float:
        """The run time for an error, interpolated linearly between runs in the logarithms of both.

        Of an error that the fastest run undercuts it is the time of that run. NaN where no run is accurate enough:
        nothing is extrapolated.
        """
        *errors, at = (-math.log(max(value, _ROUND_OFF)) for value in (*map(_error, self), error))
        times = [math.log(row.value) for row in self]
        return math.exp(np.interp(at, errors, times, right=math.nan)) if self else math.nan


class Findings:
    """Rows put together by scene and line, without methods that disagree with the truth of a scene.

    Integrators stand in the order of the tables.
    """

    def __init__(self, rows: Iterable[ReportRow], integrators: Mapping[str, Integrator] = INTEGRATORS) -> None:
        self.rows = [row for row in rows if row.by in integrators]
        present = {row.by for row in self.rows}
        ran = [it for name, it in integrators.items() if name in present]
        self.integrators = {it.name: it for it in ran}
        self.doubts: list[Doubt] = doubts(self.rows)
        self.scenes: list[str] = list(dict.fromkeys(row.group for row in self.rows))
        #: The first integrator of each line.
        self.lines = [it for i, it in enumerate(ran) if it.title not in {before.title for before in ran[:i]}]

    @property
    def agreed(self) -> bool:
        """Whether every method that was run far enough finds the same answers; one of ours must reach an end."""
        return not any(
            not doubt.excuse or (math.isinf(doubt.best) and self.integrators[doubt.method].provider == OURS)
            for doubt in self.doubts
        )

    @functools.cache  # noqa: B019  lives as long as the report
    def curve(self, scene: str, line: Integrator) -> Curve:
        """Of a line's runs of a scene, without methods that disagree."""
        out = {doubt.method for doubt in self.doubts if doubt.scene == scene and not doubt.excuse}
        rows = [row for row in self.rows if row.group == scene and row.by not in out]
        return Curve.of(row for row in rows if self.integrators[row.by].title == line.title)

    def time(self, scene: str, line: Integrator, error: float) -> float:
        """Seconds for an error; NaN where the line does not get there."""
        return self.curve(scene, line).time_at(error)

    def ranking(self, scene: str, error: float, lines: Iterable[Integrator]) -> list[tuple[float, Integrator]]:
        """Run time and name of each method that reaches an error, the fastest first."""
        times = [(self.time(scene, line, error), line) for line in lines]
        return sorted((pair for pair in times if math.isfinite(pair[0])), key=lambda pair: pair[0])

    def best(self, scene: str, error: float, provider: Provider) -> tuple[float, Integrator] | None:
        """Seconds and line of a provider's fastest."""
        return next(iter(self.ranking(scene, error, [line for line in self.lines if line.provider == provider])), None)

    def drawn(self, scene: str) -> list[Integrator]:
        """The lines of the scene's figure: those meant to be drawn, or all there are if none of them was run."""
        ran = [line for line in self.lines if self.curve(scene, line)]
        return [line for line in ran if line.drawn] or ran

    # ---- for somebody who must choose

    def advice(self, scenes: Iterable[str]) -> tuple[Integrator, float, str, float] | None:
        """The line whose worst ratio to the fastest is the best, of those to be had by calling a library; and where."""
        lines, worst = [line for line in self.lines if line.provider.ready], []
        best = {(s, e): ranking[0][0] for s in scenes for e in TARGETS if (ranking := self.ranking(s, e, lines))}
        for line in lines if best else ():
            ratios = [(self.time(scene, line, error) / least, scene, error) for (scene, error), least in best.items()]
            if all(math.isfinite(ratio) for ratio, _, _ in ratios):
                worst.append((line, *max(ratios)))
        return min(worst, key=lambda candidate: candidate[1], default=None)

    def winners(self, error: float) -> list[tuple[str, list[str]]]:
        """Which line was the fastest on which scenes, the most successful first."""
        firsts: dict[str, list[str]] = {}
        for scene in self.scenes:
            for _, line in self.ranking(scene, error, self.lines)[:1]:
                firsts.setdefault(line.title, []).append(SCENES[scene].title)
        return sorted(firsts.items(), key=lambda item: -len(item[1]))

    def digits(self) -> list[tuple[str, float]]:
        """The factor by which one more digit multiplies the time, by line."""
        costs = {}
        for line in (line for line in self.lines if line.provider == OURS and line.drawn):
            ratios = [self.time(s, line, TARGETS[1]) / self.time(s, line, TARGETS[0]) for s in self.scenes]
            if known := [ratio for ratio in ratios if math.isfinite(ratio)]:
                costs[line.title] = median(known) ** (1.0 / math.log10(TARGETS[0] / TARGETS[1]))
        return sorted(costs.items(), key=lambda item: -item[1])

    def ended_with(self, name: str, setting: float) -> list[float]:
        """The errors that a method ended with at one tolerance."""
        rows = [row for row in self.rows if row.by == name and row.numbers["setting"] == setting and row.done]
        return [_error(row) for row in rows]

    def over(self, one: Integrator, base: Integrator) -> dict[str, float]:
        """The time of a line over that of another by scene: the mean over both errors."""
        ratios = {}
        for scene in self.scenes:
            both = [self.time(scene, one, error) / self.time(scene, base, error) for error in TARGETS]
            if known := [ratio for ratio in both if math.isfinite(ratio)]:
                ratios[SCENES[scene].title] = geometric_mean(known)
        return ratios

    def compared_with(self, provider: Provider) -> tuple[list[float], dict[float, list[str]]]:
        """Our time over that of a provider wherever it gets, and where it is faster, by error."""
        ratios: list[float] = []
        faster: dict[float, list[str]] = {}
        for error, scene in itertools.product(TARGETS, self.scenes):
            if theirs := self.best(scene, error, provider):
                ours = self.best(scene, error, OURS)
                ratios.append(ours[0] / theirs[0] if ours else math.inf)
                share = f"{1.0 / ratios[-1]:.2f} of our time" if ours else "none of ours got there"
                if ratios[-1] > 1.0:
                    faster.setdefault(error, []).append(f"{SCENES[scene].title} ({share})")
        return ratios, faster


# ---- bars: the claims, stated before the measurement -----------------------------------------------------------------

#: Of a scene and a method, how diffrax is run ("-call": in one call), and the ratio allowed.
_BARS = json.loads(Path(__file__).with_name("bars.json").read_text())


def bar_rows(findings: Findings, scene: str) -> list[ReportRow]:
    """Times over the better of diffrax's Tsit5 and Dopri8, of the methods that were run, at every error."""
    result = []
    for place, method, how, limit in _BARS if scene in findings.scenes else ():
        if place != scene or method not in findings.integrators:
            continue
        line, rivals = INTEGRATORS[method], [INTEGRATORS[f"diffrax-{solver}{how}"] for solver in ("tsit5", "dopri8")]
        for error in TARGETS:
            theirs = min((seconds for seconds, _ in findings.ranking(scene, error, rivals)), default=math.nan)
            ratio, what = findings.time(scene, line, error) / theirs, f"{SCENES[scene].title}, error {plain(error)}"
            result.append(
                judged(ReportRow("bars", what, line.title, f"over {rivals[0].provider.name}", ratio), at_most(limit))
            )
    return result
