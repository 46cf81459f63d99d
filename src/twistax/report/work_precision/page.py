"""The page of error against run time: its tables, its figures, and what its template is told."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ...scenes import Scene
from ..origin import ABSENT, KERNELS, Origin
from ..pages.drawing import as_svg, panels
from ..pages.page import Table, bar_table, duration
from ..rows import Row, plain
from . import words
from .contenders import ONE_CALL, OURS, SHIPPED
from .findings import TARGETS, Findings
from .measure import Refusal

__all__ = ["context", "draw"]


def context(
    findings: Findings,
    scenes: Mapping[str, Scene],
    bars: Sequence[Row],
    refused: Sequence[Refusal],
    origin: Origin,
    empty_call: float,
) -> dict[str, Any]:
    """What the template needs.

    Args:
        scenes: by name.
        bars: judged.
        refused: methods that cannot run a scene.
        origin: of the rows.
        empty_call: what a call of a compiled function costs that does nothing, s.
    """
    names = {name: scenes[name].title for name in findings.scenes}
    sides = [side for side in (OURS, SHIPPED, ONE_CALL) if any(line.side == side for line in findings.lines)]
    return {
        "scene_count": _count(findings.scenes, "scene"),
        "method_count": _count(findings.lines, "method"),
        "effort": origin.effort,
        "advice": [words.advice(findings, names), *words.advice_if_stiff(findings, names)]
        + [*words.winners(findings, names), words.digits(findings)],
        "on_tolerance": words.on_tolerance(findings),
        "sides": "; ".join(f"**{side.name}**, {side.what}" for side in sides),
        "comparisons": [words.on_quaternions(findings, names), *words.on_diffrax(findings, names)],
        "fastest": _fastest(findings, names),
        "bars": bar_table(bars),
        "missed": sum(bar.holds is False for bar in bars),
        "bar_count": len(bars),
        "scenes": [_scene(findings, scenes[name]) for name in findings.scenes],
        "kernels": KERNELS if origin.versions.get(KERNELS, ABSENT) != ABSENT else "",
        "empty_call": duration(empty_call),
        "refusals": _refusals(refused),
        "apart": [names[scene] for scene in findings.scenes if findings.sittings(scene) > 1],
        "doubts": "; ".join(doubt.sentence for doubt in findings.doubts),
        "methods": (
            ["method", "how", "written"],
            [[line.title, line.side.what, f"`{line.code}`"] for line in findings.lines],
            3,
        ),
    }


def _count(things: Sequence[object], word: str) -> str:
    return f"{len(things)} {word}{'' if len(things) == 1 else 's'}"


def _fastest(findings: Findings, names: Mapping[str, str]) -> Table:
    rows = []
    for scene in findings.scenes:
        for error in TARGETS:
            best = [findings.best(scene, error, side) for side in (OURS, ONE_CALL, SHIPPED)]
            shown = [f"{each.line.title}: {duration(each.seconds)}" if each else "-" for each in best]
            ratios = [f"{best[0].seconds / other.seconds:.2f}" if best[0] and other else "-" for other in best[1:]]
            rows.append([names[scene], plain(error), *shown, *ratios])
    sides = [side.name for side in (OURS, ONE_CALL, SHIPPED)]
    return ["scene", "error", *sides, "ours / one call", "ours / shipped"], rows, 5


def _scene(findings: Findings, scene: Scene) -> dict[str, Any]:
    """Name, title, text and table: times are read between runs; evaluations and steps are those of the next better."""
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
    errors = [plain(error) for error in TARGETS]
    head = [f"{what}, {error}" for what in ("time", "evaluations", "steps (rejected)") for error in errors]
    title, about = scene.title[:1].upper() + scene.title[1:], f"{scene.summary} Source: {scene.source}."
    return {"name": scene.name, "title": title, "about": about, "table": (["method", *head, "compile"], rows, 1)}


def _refusals(refused: Sequence[Refusal]) -> list[str]:
    """A sentence for each method and reason."""
    scenes: dict[tuple[str, str], list[str]] = {}
    for each in refused:
        scenes.setdefault((each.method, each.reason), []).append(each.scene)
    return [
        f"{method} does not run {', '.join(names)}: {reason.removesuffix('.')}."
        for (method, reason), names in scenes.items()
    ]


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
