"""`python -m twistax report`: measure, say what it means, write page, figures and tables."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import jax

from ...scenes import SCENES
from .bars import Outcome, outcomes
from .blocks import as_html, as_markdown
from .contenders import CONTENDERS, IN_QUICK, TOO_LONG_FOR_QUICK, suited
from .effort import FULL, QUICK
from .figure import draw
from .findings import TARGETS, Findings
from .flights import Refused, empty_call_seconds, measure_scene
from .origin import Origin, origin_of
from .page import TITLE, page
from .progress import Progress
from .row import COLUMNS, Row
from .store import Store, save_csv, save_json

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Measure what is not there yet, and write everything.

    Args:
        arguments: what `add_options` declares.
    Returns:
        the exit status: 0 done, 1 methods disagree about the answer of a scene, 2 the folder cannot be written.
    """
    begin = time.perf_counter()
    folder: Path = arguments.out
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"twistax report: cannot write to --out {folder}: {error.strerror}", file=sys.stderr)
        return 2
    # A program that XLA takes for cheap runs in the caller's thread, any other is handed to another one, which may take
    # as long as a flight. The same for all, before the first array is made.
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    effort = QUICK if arguments.quick else FULL
    chosen = arguments.method or (IN_QUICK if arguments.quick else list(CONTENDERS))
    contenders = {name: CONTENDERS[name] for name in CONTENDERS if name in chosen}
    left_out = TOO_LONG_FOR_QUICK if arguments.quick else ()
    asked = arguments.scene or [name for name in SCENES if name not in left_out]
    scenes = {name: SCENES[name] for name in SCENES if name in asked}
    origin = origin_of(effort)
    store = Store(folder / "rows.jsonl", origin, Row.of)
    print(f"machine   {origin.machine}", flush=True)
    if store.dropped:
        print(f"rows      {store.dropped} of other versions, code, machine or effort dropped", flush=True)

    progress = Progress(sys.stderr, len(scenes), shown=not arguments.no_progress)
    refused: list[Refused] = []
    for scene in scenes.values():
        lap, before = time.perf_counter(), len(store)
        progress.start(scene.name)
        flown = arguments.method or suited(contenders, scene.name)
        refused += measure_scene(scene, [contenders[name] for name in flown], effort, store, progress.tell)
        progress.end()
        print(f"{scene.name:<18} {len(store) - before:4d} flights in {time.perf_counter() - lap:5.1f} s", flush=True)

    findings = Findings((row for name in scenes for row in store if row.scene == name), contenders)
    bars = outcomes(findings)
    _print_bars(bars)
    for doubt in findings.doubts:
        print(f"doubt     {doubt.sentence}")
    for line in _save(folder, findings, bars, refused, origin, _command(arguments)):
        print(f"files     {line}")
    print(f"time      {time.perf_counter() - begin:.1f} s in all")
    return 0 if findings.agreed else 1


def _print_bars(bars: list[Outcome]) -> None:
    for each in bars:
        print(
            f"bar       {each.bar.scene:<12} {each.bar.method:<18} / {each.bar.against.name:<20} at {each.error:.0e}: "
            f"{each.ratio:5.2f} of {each.bar.limit:g}  {each.verdict}"
        )


def _save(
    folder: Path, findings: Findings, bars: list[Outcome], refused: list[Refused], origin: Origin, command: str
) -> list[str]:
    """Tables, figures and pages; a line for each."""
    save_csv(folder / "report.csv", COLUMNS, findings.rows)
    save_json(folder / "report.json", _document(findings, bars, origin))
    figures: dict[str, bytes] = {}
    said = [str(folder / name) for name in ("report.csv", "report.json", "report.md", "report.html")]
    try:
        for scene in filter(findings.drawn, findings.scenes):
            figures[scene] = draw(findings, scene, SCENES[scene].title)
            (folder / "figures" / f"{scene}.svg").write_bytes(figures[scene])
        said.append(str(folder / "figures"))
    except ImportError:
        said.append("no figures: they need matplotlib; get it with pip install 'twistax[plot]'")
    blocks = page(findings, SCENES, bars, refused, origin, empty_call_seconds(), figures, command)
    (folder / "report.md").write_text(as_markdown(blocks))
    (folder / "report.html").write_text(as_html(TITLE, blocks))
    return said


def _document(findings: Findings, bars: list[Outcome], origin: Origin) -> dict[str, object]:
    """For programs: where it comes from, times at the errors, bars, all rows."""
    times = [
        {"scene": scene, "line": each.line.title, "error": error, "seconds": each.seconds}
        for scene in findings.scenes
        for error in TARGETS
        for each in findings.ranking(scene, error)
    ]
    ratios = [
        {
            "scene": each.bar.scene,
            "method": each.bar.method,
            "against": each.bar.against.name,
            "error": each.error,
            "ratio": each.ratio if each.ratio == each.ratio else None,
            "limit": each.bar.limit,
            "verdict": each.verdict,
        }
        for each in bars
    ]
    return {
        "machine": origin.machine,
        "versions": origin.versions,
        "code": origin.code,
        "effort": origin.effort,
        "times": times,
        "bars": ratios,
        "columns": list(COLUMNS),
        "rows": [list(row.record().values()) for row in findings.rows],
    }


def _command(arguments: argparse.Namespace) -> str:
    words = ["python -m twistax report"]
    words += [f"--scene {name}" for name in arguments.scene or ()]
    words += [f"--method {name}" for name in arguments.method or ()]
    words += ["--quick"] if arguments.quick else []
    return " ".join([*words, f"--out {arguments.out}"])
