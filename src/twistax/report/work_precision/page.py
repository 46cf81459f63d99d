"""`python -m twistax report`: scenes by methods, and the content of the page."""

import argparse
import dataclasses
import functools
import math
from collections.abc import Callable, Iterable
from typing import Any

from ...scenes import SCENES
from ..harness.page import Table, as_svg, panels
from ..harness.report import Report
from ..harness.rows import ReportRow, duration, plain
from ..harness.store import ABSENT, KERNELS
from ..harness.timing import ProgressCallback, empty_call_seconds
from .findings import TARGETS, Findings, bar_rows
from .integrators import FULL, INTEGRATORS, ONE_CALL, OURS, QUICK, SHIPPED, measure_scene

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


def suited(integrators: Iterable[str], scene: str) -> list[str]:
    """Which of the methods, by name, are worth running a scene with, where nobody asked for others."""
    if scene in LONG:
        return [name for name in integrators if name in _HIGH_ORDER]
    return [name for name in integrators if (name in _IMPLICIT) == (scene in STIFF)]


class WorkPrecision(Report):
    name, template, title = "report", "work_precision", "Which integrator, and what does a digit cost?"

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self._asked = arguments.method
        chosen = arguments.method or (IN_QUICK if arguments.quick else INTEGRATORS)
        self._integrators = {name: INTEGRATORS[name] for name in INTEGRATORS if name in chosen}
        left_out = TOO_LONG_FOR_QUICK if arguments.quick else ()
        self.parts = [name for name in SCENES if name in (arguments.scene or SCENES.keys() - left_out)]
        #: The scenes that a method cannot run, by method and reason.
        self._refused: dict[tuple[str, str], list[str]] = {}

    def measure(self, part: str, progress: ProgressCallback) -> None:
        chosen = [self._integrators[name] for name in self._asked or suited(self._integrators, part)]
        for refusal in measure_scene(SCENES[part], chosen, self._effort, self.store, progress).items():
            self._refused.setdefault(refusal, []).append(part)

    def _findings(self) -> Findings:
        return Findings(super().rows(), self._integrators)

    def rows(self) -> list[ReportRow]:
        return self._findings().rows

    def bars(self, part: str) -> list[ReportRow]:
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
        "integrators": INTEGRATORS,
        "providers": [
            provider
            for provider in (OURS, SHIPPED, ONE_CALL)
            if any(line.provider == provider for line in findings.lines)
        ],
        "rivals": (ONE_CALL, SHIPPED),
        "fastest": _fastest(findings),
        "scenes": {SCENES[name]: _times(findings, name) for name in findings.scenes},
        "several_sittings": [SCENES[scene].title for scene, times in sittings.items() if len(times) > 1],
    }


def _fastest(findings: Findings) -> Table:
    rows, providers = [], (OURS, ONE_CALL, SHIPPED)
    for scene in findings.scenes:
        for error in TARGETS:
            best = [findings.best(scene, error, provider) for provider in providers]
            shown = [f"{pair[1].title}: {duration(pair[0])}" if pair else "-" for pair in best]
            ratios = [f"{best[0][0] / pair[0]:.2f}" if best[0] and pair else "-" for pair in best[1:]]
            rows.append([SCENES[scene].title, plain(error), *shown, *ratios])
    return ["scene", "error", *(provider.name for provider in providers), "ours / one call", "ours / shipped"], rows, 5


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
