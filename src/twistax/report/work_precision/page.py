"""The page of the report: what to use when first, then how we know."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ...scenes import Scene
from . import words
from .bars import Outcome
from .blocks import Block, Bullets, Details, Figure, Heading, Paragraph, Table
from .contender import Side
from .contenders import ONE_CALL, OURS, SHIPPED
from .findings import TARGETS, Findings
from .flights import Refused
from .origin import ABSENT, KERNELS, Origin

__all__ = ["TITLE", "page"]

TITLE = "Which integrator, and what does a digit cost?"


def page(
    findings: Findings,
    scenes: Mapping[str, Scene],
    outcomes: Sequence[Outcome],
    refused: Sequence[Refused],
    origin: Origin,
    empty_call: float,
    figures: Mapping[str, bytes],
    command: str,
) -> list[Block]:
    """All blocks.

    Args:
        scenes: by name.
        outcomes: of the bars.
        refused: methods that cannot fly a scene.
        origin: of the rows.
        empty_call: what a call of a compiled function costs that does nothing, s.
        figures: SVG by scene; empty without matplotlib.
        command: how to get this page again.
    """
    names = {name: scenes[name].title for name in findings.scenes}
    return [
        Heading(1, TITLE),
        Paragraph(
            f"{_count(findings.scenes, 'scene')} with a known answer, {_count(findings.lines, 'method')}. Error "
            "is how far a flight ends from the truth: rad for attitudes, the rest relative to its size (absolute "
            f"below 1). Time is one call of the compiled function. This is a {origin.effort['name']} run."
        ),
        Heading(2, "What to use when"),
        Bullets(
            [
                words.advice(findings, names),
                *words.advice_if_stiff(findings, names),
                *words.winners(findings, names),
                words.digits(findings),
            ]
        ),
        Bullets([words.on_tolerance(findings)]),
        Heading(3, "Where plain quaternions or diffrax are the better choice"),
        Paragraph(f"Compared are {'; '.join(f'**{side.name}**, {side.what}' for side in _sides(findings))}."),
        Bullets([words.on_quaternions(findings, names), *words.on_diffrax(findings, names)]),
        Heading(2, "The fastest at each error"),
        _fastest(findings, names),
        *_bars(outcomes, names, findings),
        Heading(2, "Scenes"),
        *(block for name in findings.scenes for block in _scene(findings, scenes[name], figures.get(name))),
        *([] if figures else [Paragraph("No figures: they need matplotlib, `pip install 'twistax[plot]'`.")]),
        Heading(2, "How it was measured"),
        *_how(findings, refused, origin, empty_call, command),
    ]


def _count(things: Sequence[object], word: str) -> str:
    return f"{len(things)} {word}{'' if len(things) == 1 else 's'}"


def _sides(findings: Findings) -> list[Side]:
    known = (OURS, SHIPPED, ONE_CALL)
    return [side for side in known if any(line.side == side for line in findings.lines)]


def _fastest(findings: Findings, names: Mapping[str, str]) -> Table:
    rows = []
    for scene in findings.scenes:
        for error in TARGETS:
            best = [findings.best(scene, error, side) for side in (OURS, ONE_CALL, SHIPPED)]
            shown = [f"{each.line.title}: {words.duration(each.seconds)}" if each else "-" for each in best]
            ratios = [f"{best[0].seconds / other.seconds:.2f}" if best[0] and other else "-" for other in best[1:]]
            rows.append([names[scene], words.power(error), *shown, *ratios])
    sides = [side.name for side in (OURS, ONE_CALL, SHIPPED)]
    return Table(["scene", "error", *sides, "ours / one call", "ours / shipped"], rows, words=5)


def _bars(outcomes: Sequence[Outcome], names: Mapping[str, str], findings: Findings) -> list[Block]:
    if not outcomes:
        return []
    rows = [
        [
            names[each.bar.scene],
            findings.contenders[each.bar.method].line.title,
            each.bar.against.name,
            words.power(each.error),
            _number(each.ratio),
            f"{each.bar.limit:g}",
            each.verdict,
        ]
        for each in outcomes
    ]
    missed = sum(each.verdict == "MISSED" for each in outcomes)
    said = f"{missed} of {len(outcomes)} are missed." if missed else f"All {len(outcomes)} hold."
    return [
        Heading(2, "Bars"),
        Paragraph(
            "Set before measuring: the time of a named method over that of the better of diffrax's Tsit5 and Dopri8, "
            f"as far as they were run. {said}"
        ),
        Details("The bars", [Table(["scene", "method", "against", "error", "ratio", "at most", ""], rows, words=4)]),
    ]


def _scene(findings: Findings, scene: Scene, figure: bytes | None) -> list[Block]:
    rows = []
    for line in findings.lines:
        curve = findings.curve(scene.name, line)
        if not curve.rows:
            continue
        cells = [words.duration(curve.time_at(error)) for error in TARGETS]
        at = [curve.row_at(error) for error in TARGETS]
        cells += [str(row.evaluations) if row and row.evaluations else "-" for row in at]
        cells += [f"{row.steps} ({row.rejected})" if row else "-" for row in at]
        compiling = [row.compile_seconds for row in curve.rows if math.isfinite(row.compile_seconds)]
        rows.append([line.title, *cells, f"{min(compiling):.2g} s" if compiling else "-"])
    rows.sort(key=lambda row: row[1] == "-")
    errors = [words.power(error) for error in TARGETS]
    head = ["method", *(f"time, {e}" for e in errors), *(f"evaluations, {e}" for e in errors)]
    head += [*(f"steps (rejected), {e}" for e in errors), "compile"]
    drawn = [Figure(f"figures/{scene.name}.svg", figure, f"error against run time: {scene.title}")] if figure else []
    return [
        Heading(3, scene.title[:1].upper() + scene.title[1:]),
        Paragraph(f"{scene.summary} Source: {scene.source}."),
        *drawn,
        Details(
            "Times, evaluations and steps",
            [
                Table(head, rows),
                Paragraph("Times are read between flights; evaluations and steps are those of the next better flight."),
            ],
        ),
    ]


def _how(
    findings: Findings, refused: Sequence[Refused], origin: Origin, empty_call: float, command: str
) -> list[Block]:
    effort = origin.effort
    versions = ", ".join(f"{name} {version}" for name, version in origin.versions.items())
    apart = [scene for scene in findings.scenes if findings.sittings(scene) > 1]
    kernels = (
        f"twistax runs flights without implicit methods in native kernels ({KERNELS}), which it does where "
        f"{KERNELS} is installed; XLA compiles the others, and all of diffrax."
    )
    if origin.versions.get(KERNELS, ABSENT) == ABSENT:
        kernels = f"{KERNELS} is not installed: XLA compiles the flights of twistax too, which then take longer."
    lines = [
        f"Machine: {origin.machine}. Double precision.",
        f"Versions: {versions}; code {origin.code}.",
        kernels,
        f"Run again: `{command}` ({effort['name']} run). All flights are in `report.csv` and `report.json`.",
        "Every flight is one call of a jitted function of the start, waited for. All flights of a scene take turns, up "
        f"to {effort['rounds']} rounds of 3 calls after one that does not count (long flights fewer, at least "
        f"{effort['least']}); the median counts. "
        f"Calling a compiled function that does nothing takes {words.duration(empty_call)}, part of every time here. "
        "Compiling is apart: once for all tolerances.",
        "Every call runs in the caller's thread (`jax_cpu_enable_async_dispatch` off). With JAX's default that holds "
        "for programs that XLA counts below 1000 operations, which is so for some methods and scenes and not for "
        "others; a call from Python of any other waits for another thread as well.",
        "Adaptive methods are run with rtol = atol from coarse to fine, equal steps with more and more of them. The "
        "best of a line's flights are connected; the time at an error is read there, on logarithmic scales. Nothing "
        "is extrapolated.",
        "diffrax solves the same system in quaternions (`tx.diffrax.ambient_term`), one flat vector, the first step "
        "its own, with its default I controller and with PI control (pcoeff 0.4, icoeff 0.3): the better of the two "
        "counts. Quaternions are normalised when read; `max_steps` is 1e7. In one call: without its error check, "
        "ForwardMode.",
        *_refusals(refused),
        *(f"Rows of {scene} come from several sittings; ratios between them are less sure." for scene in apart),
    ]
    agreed = "Every method was first seen to find the same end of every scene."
    doubts = [doubt.sentence for doubt in findings.doubts]
    if doubts:
        agreed = f"Not all methods were seen to find the same end: {'; '.join(doubts)}. What disagrees is left out."
    methods = [[line.title, line.side.what, f"`{line.code}`"] for line in findings.lines]
    table = Table(["method", "how", "written"], methods, words=3)
    return [Bullets([agreed, *lines]), Details("Methods", [table])]


def _refusals(refused: Sequence[Refused]) -> list[str]:
    """A sentence for each method and reason."""
    scenes: dict[tuple[str, str], list[str]] = {}
    for each in refused:
        scenes.setdefault((each.method, each.reason), []).append(each.scene)
    return [
        f"{method} does not fly {', '.join(names)}: {reason.removesuffix('.')}."
        for (method, reason), names in scenes.items()
    ]


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"
