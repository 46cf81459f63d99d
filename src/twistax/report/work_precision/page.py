"""`python -m twistax report`: what is run, and what its page is told."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from ...scenes import SCENES, Scene
from ..page import Table, as_svg, duration, panels
from ..report import Report
from ..rows import ABSENT, KERNELS, Row, plain
from ..timing import Tell, empty_call_seconds
from .contenders import CONTENDERS, FULL, ONE_CALL, OURS, QUICK, SHIPPED, Line, Side
from .findings import TARGETS, Findings, bar_rows
from .measure import measure_scene

#: Times closer than this count as the same.
_SAME = 1.05

#: Scenes with a part so fast that it has died out: for implicit methods alone, as explicit ones cannot take a step.
STIFF = ("stiff-attitude", "actuator-lag", "stiff-joint")
_IMPLICIT = ("radau5", "radau5-quaternion", "diffrax-kvaerno5-pi")

#: Scenes so long that a run takes up to seconds: for a few methods of high order.
LONG = ("long-heavy-top", "spinning-satellite")
_HIGH_ORDER = ("dop853", "dop853-quaternion", "dopri8", "diffrax-dopri8-call-pi", "diffrax-dopri8-pi")

#: Those of the quick run.
IN_QUICK = (
    *("tsit5", "dop853", "dop853-quaternion", "diffrax-tsit5-call", "diffrax-dopri8-call-pi", "diffrax-tsit5"),
    *("radau5", "diffrax-kvaerno5-pi"),
)
#: Scenes of the full run only: they take long to compile or to run.
TOO_LONG_FOR_QUICK = ("spring-bodies", "actuator-lag", "stiff-joint", *LONG)


def suited(contenders: Iterable[str], scene: str) -> list[str]:
    """Which of the methods, by name, are worth running a scene with, where nobody asked for others."""
    if scene in STIFF:
        return [name for name in contenders if name in _IMPLICIT]
    if scene in LONG:
        return [name for name in contenders if name in _HIGH_ORDER]
    return [name for name in contenders if name not in _IMPLICIT]


class WorkPrecision(Report):
    name, template, title = "report", "work_precision", "Which integrator, and what does a digit cost?"

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self._asked = arguments.method
        chosen = arguments.method or (IN_QUICK if arguments.quick else list(CONTENDERS))
        self._contenders = {name: CONTENDERS[name] for name in CONTENDERS if name in chosen}
        left_out = TOO_LONG_FOR_QUICK if arguments.quick else ()
        self._scenes = {
            name: scene for name, scene in SCENES.items() if name in (arguments.scene or SCENES.keys() - left_out)
        }
        self.parts = list(self._scenes)
        #: The scenes that a method cannot run, by method and reason.
        self._refused: dict[tuple[str, str], list[str]] = {}

    def measure(self, part: str, tell: Tell) -> None:
        chosen = [self._contenders[name] for name in self._asked or suited(self._contenders, part)]
        for refusal in measure_scene(self._scenes[part], chosen, self._effort, self.store, tell).items():
            self._refused.setdefault(refusal, []).append(part)

    def _findings(self) -> Findings:
        return Findings(super().rows(), self._contenders)

    def rows(self) -> list[Row]:
        return self._findings().rows

    def bars(self, part: str) -> list[Row]:
        return bar_rows(self._findings(), part, self._scenes[part].title)

    def problems(self) -> list[str]:
        findings = self._findings()
        return [] if findings.agreed else [doubt.sentence for doubt in findings.doubts]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        findings = self._findings()
        drawn = [name for name in findings.scenes if findings.drawn(name)]
        return {name: functools.partial(draw, findings, name, self._scenes[name].title) for name in drawn}

    def context(self) -> dict[str, Any]:
        kernels = self.store.origin.versions[KERNELS] != ABSENT
        more = {"refused": self._refused, "kernels": kernels, "empty_call": empty_call_seconds()}
        return context(self._findings(), self._scenes) | more


report = WorkPrecision


def context(findings: Findings, scenes: Mapping[str, Scene]) -> dict[str, Any]:
    """What the template says of the findings."""
    names = {name: scenes[name].title for name in findings.scenes}
    sides = [side for side in (OURS, SHIPPED, ONE_CALL) if any(line.side == side for line in findings.lines)]
    plainly = [name for name in findings.scenes if name not in (*STIFF, *LONG)]
    stiff = [name for name in findings.scenes if name in STIFF]
    sittings = {name: {row.sitting for row in findings.rows if row.group == name} for name in findings.scenes}
    return {
        "names": names,
        "lines": findings.lines,
        "same": _SAME,
        "targets": TARGETS,
        "advice": {"in doubt": _advice(findings, plainly), "the system is stiff": _advice(findings, stiff)},
        "winners": {error: _winners(findings, names, error) for error in TARGETS},
        "digits": _digits(findings),
        "tolerance": _on_tolerance(findings),
        "methods": [[line.title, line.side.what, f"`{line.code}`"] for line in findings.lines],
        "sides": sides,
        "quaternions": _on_quaternions(findings, names),
        "rivals": [_on_diffrax(findings, names, side) for side in (ONE_CALL, SHIPPED)],
        "fastest": _fastest(findings, names),
        "scenes": [_scene(findings, scenes[name]) for name in findings.scenes],
        "apart": [names[scene] for scene, found in sittings.items() if len(found) > 1],
        "doubts": [doubt.sentence for doubt in findings.doubts],
    }


# ---- for somebody who must choose -----------------------------------------------------------------------------------


def _advice(findings: Findings, scenes: Sequence[str]) -> tuple[Line, float, str, float] | None:
    """The line whose worst ratio to the fastest is the best, of those to be had by calling a library; and where."""
    lines, found = [line for line in findings.lines if line.side.ready], {}
    for line in lines:
        ratios = [
            (findings.time(scene, line, error) / ranking[0][0], scene, error)
            for scene in scenes
            for error in TARGETS
            if (ranking := findings.ranking(scene, error, lines))
        ]
        if ratios and all(math.isfinite(ratio) for ratio, _, _ in ratios):
            found[line] = max(ratios)
    if not found:
        return None
    best = min(found, key=lambda line: found[line][0])
    return (best, *found[best])


def _winners(findings: Findings, names: Mapping[str, str], error: float) -> list[tuple[str, list[str]]]:
    """Which method was the fastest where."""
    firsts: dict[str, list[str]] = {}
    for scene in findings.scenes:
        for _, line in findings.ranking(scene, error)[:1]:
            firsts.setdefault(line.title, []).append(names[scene])
    return sorted(firsts.items(), key=lambda item: -len(item[1]))


def _digits(findings: Findings) -> list[tuple[str, float]]:
    """By what one more digit multiplies the time."""
    costs = {}
    for line in (line for line in findings.lines if line.side == OURS and line.drawn):
        ratios = [findings.time(s, line, TARGETS[1]) / findings.time(s, line, TARGETS[0]) for s in findings.scenes]
        if known := [ratio for ratio in ratios if math.isfinite(ratio)]:
            costs[line.title] = median(known) ** (1.0 / math.log10(TARGETS[0] / TARGETS[1]))
    return sorted(costs.items(), key=lambda item: -item[1])


def _on_tolerance(findings: Findings) -> dict[str, Any]:
    """The errors that one tolerance ended with."""
    name, setting = "dop853", 1e-9
    rows = [row for row in findings.rows if row.by == name and row.numbers["setting"] == setting and row.done]
    errors = [row.numbers["error"] for row in rows]
    return {"title": CONTENDERS[name].line.title, "setting": setting, "errors": errors}


def _on_quaternions(findings: Findings, names: Mapping[str, str]) -> dict[str, Any]:
    """Their times over those of exponential coordinates with the same tableau: the mean over both errors."""
    quaternion, curved = CONTENDERS["dop853-quaternion"].line, CONTENDERS["dop853"].line
    ratios = {}
    for scene in findings.scenes:
        both = [findings.time(scene, quaternion, e) / findings.time(scene, curved, e) for e in TARGETS]
        if known := [math.log(ratio) for ratio in both if math.isfinite(ratio)]:
            ratios[names[scene]] = math.exp(sum(known) / len(known))
    kinds: dict[str, list[str]] = {"faster": [], "slower": [], "as fast": []}
    for scene, ratio in ratios.items():
        kinds["faster" if ratio * _SAME < 1.0 else "slower" if ratio > _SAME else "as fast"].append(scene)
    return {"quaternion": quaternion, "curved": curved, "ratios": ratios, "kinds": kinds}


def _on_diffrax(findings: Findings, names: Mapping[str, str], side: Side) -> dict[str, Any]:
    """Our time over that of a side wherever it gets, and where it is faster, by error."""
    ratios: list[float] = []
    faster: dict[float, list[str]] = {}
    for error in TARGETS:
        for scene in findings.scenes:
            ours, theirs = findings.best(scene, error, OURS), findings.best(scene, error, side)
            if theirs is not None:
                ratios.append(ours[0] / theirs[0] if ours else math.inf)
                share = f"{1.0 / ratios[-1]:.2f} of our time" if ours else "none of ours got there"
                if ratios[-1] > 1.0:
                    faster.setdefault(error, []).append(f"{names[scene]} ({share})")
    return {"side": side, "ratios": ratios, "faster": faster}


# ---- tables and figures ---------------------------------------------------------------------------------------------


def _fastest(findings: Findings, names: Mapping[str, str]) -> Table:
    rows, sides = [], (OURS, ONE_CALL, SHIPPED)
    for scene in findings.scenes:
        for error in TARGETS:
            best = [findings.best(scene, error, side) for side in sides]
            shown = [f"{each[1].title}: {duration(each[0])}" if each else "-" for each in best]
            ratios = [f"{best[0][0] / other[0]:.2f}" if best[0] and other else "-" for other in best[1:]]
            rows.append([names[scene], plain(error), *shown, *ratios])
    return ["scene", "error", *(side.name for side in sides), "ours / one call", "ours / shipped"], rows, 5


def _scene(findings: Findings, scene: Scene) -> dict[str, Any]:
    """The scene and its table: times are read between runs; evaluations and steps are those of the next better."""
    rows = []
    for line in findings.lines:
        curve = findings.curve(scene.name, line)
        if not curve.rows:
            continue
        at = [row.numbers if row else {} for row in map(curve.row_at, TARGETS)]
        cells = [duration(curve.time_at(error)) for error in TARGETS]
        cells += [f"{n['evaluations']:.0f}" if n.get("evaluations") else "-" for n in at]
        cells += [f"{n['accepted'] + n['rejected']:.0f} ({n['rejected']:.0f})" if n else "-" for n in at]
        compiling = [s for row in curve.rows if math.isfinite(s := row.numbers["compile_seconds"])]
        rows.append([line.title, *cells, f"{min(compiling):.2g} s" if compiling else "-"])
    rows.sort(key=lambda row: row[1] == "-")
    heads = [f"{what}, {plain(e)}" for what in ("time", "evaluations", "steps (rejected)") for e in TARGETS]
    return {"scene": scene, "table": (["method", *heads, "compile"], rows, 1)}


def draw(findings: Findings, scene: str, title: str) -> bytes:
    """The figure of a scene as SVG: the best runs of each line that is drawn, connected.

    Raises:
        ImportError: matplotlib is not installed.
    """
    labels = ("error at the end (to the right: more accurate)", "time of one call, ms (lower: faster)")
    figure = panels(title, labels, size=(7.0, 5.6))
    axes = figure.axes[0]
    for line in findings.drawn(scene):
        points = [(row.numbers["error"], 1e3 * row.value) for row in findings.curve(scene, line).rows]
        colour, dash, marker = line.style
        good = [(error, time) for error, time in points if error > 0.0] or [(math.nan, math.nan)]
        axes.loglog(*zip(*good, strict=True), color=colour, ls=dash, marker=marker, ms=4.5, lw=1.5, label=line.title)
    for target in TARGETS:
        axes.axvline(target, color="0.6", lw=0.8, ls="--", zorder=0)
    axes.set_xlim(1e-1, 1e-13)
    return as_svg(figure)
