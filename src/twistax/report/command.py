"""`python -m twistax report`: measure what is missing, print results, and write the page, figures and tables."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import jax

from ..progress import Progress
from .harness.page import PageFigure, Table, render, renew, table_of
from .harness.report import Report
from .harness.rows import ReportRow
from .harness.store import Origin, Store, save_csv
from .harness.timing import ProgressCallback, quiet, within

#: Where each report is made of the options, by the name of its files. Loaded where it is run: each brings much of the
#: package with it.
_REPORTS = {
    "foreign": (".foreign", "foreign"),
    "report": (".work_precision.page", "WorkPrecision"),
    "speed": (".speed.page", "Speed"),
    "stability": (".registry", "stability"),
    "figures": (".registry", "figures"),
    "optimal": (".registry", "optimal_control"),
}
#: What leaves rows out of tables, and what leaves out whole tables.
_PARTIAL = ("quick", "scene", "method", "case")


def run(arguments: argparse.Namespace) -> int:
    """Run the report that the options select, as `add_options` declares them.

    Returns the exit status: 0 done; 1 something disagrees, or a measurement is not what was asked for; 2 the folder
    cannot be written, --renew would write partial tables, --only names a section of another report, or jinja2 or,
    with --foreign, casadi is missing.
    """
    if getattr(arguments, "gpu", False):
        return int(importlib.import_module(".gpu.command", __package__).run(arguments))
    if importlib.util.find_spec("jinja2") is None:
        return _refuse("the report needs jinja2, which is not installed; fix: pip install 'twistax[report]'")
    partial = [f"--{name}" for name in _PARTIAL if getattr(arguments, name)]
    if arguments.renew and partial:
        return _refuse(f"--renew writes whole tables; leave out {', '.join(partial)}")
    if getattr(arguments, "foreign", False):
        if not arguments.optimal:
            return _refuse("--foreign goes with --optimal")
        if importlib.util.find_spec("casadi") is None:
            return _refuse("--foreign needs casadi, which is not installed; fix: pip install 'twistax[casadi]'")
    kind = next((name for name in _REPORTS if getattr(arguments, name, False)), "report")
    module, name = _REPORTS[kind]
    if arguments.only:
        known = getattr(importlib.import_module(module, __package__), kind.upper(), {})
        if strangers := [name for name in arguments.only if name not in known]:
            there = f"--{kind} has {', '.join(known)}" if known else "it goes with --stability, --figures or --optimal"
            return _refuse(f"--only {strangers[0]}: {there}")
    return run_report(getattr(importlib.import_module(module, __package__), name)(arguments), arguments)


def _refuse(why: str) -> int:
    print(f"twistax report: {why}", file=sys.stderr)
    return 2


def run_report(report: Report, arguments: argparse.Namespace) -> int:
    """Run a report: measure, print, save and update documents. Returns the exit status; see `run`."""
    begin = time.perf_counter()
    folder: Path = arguments.out
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return _refuse(f"cannot write to --out {folder}: {error.strerror}")
    if report.one_thread:
        jax.config.update("jax_cpu_enable_async_dispatch", False)
    report.store = Store(folder / f"{report.name}.json", Origin.now(report.effort, report.versions))
    _say("machine", report.store.origin.machine)
    for name, why in report.missing.items():
        _say("absent", f"{name}: {why}")
    if report.store.dropped:
        _say("rows", f"{report.store.dropped} of other versions, code, machine or effort dropped")
    _measure(report, arguments)
    for line in (problems := report.problems()):
        _say("doubt", line)
    complete = not (arguments.only or any(getattr(arguments, name) for name in _PARTIAL))
    _save(report, arguments, complete)
    if arguments.renew:
        names = renew(arguments.renew, _tables(folder, report.name, complete))
        _say("renewed", f"{arguments.renew}: {', '.join(names) or 'no table of this report is marked there'}")
    _say("time", f"{time.perf_counter() - begin:.1f} s in all")
    return 1 if problems else 0


def _measure(report: Report, arguments: argparse.Namespace) -> None:
    """Measure part by part, and print the rows of each."""
    line = Progress("report")
    shown = sys.stderr.isatty() and not arguments.no_progress
    progress: ProgressCallback = (lambda what, share: line.done(share, f"all, {what}"[:90])) if shown else quiet
    for number, part in enumerate(report.parts):
        if arguments.again:
            report.store.forget(part)
        lap, before = time.perf_counter(), len(report.store)
        report.measure(part, within(progress, number, len(report.parts), f"{part}: "))
        if shown:
            line.close()
        print(f"{part:<18} {len(report.store) - before:4d} rows in {time.perf_counter() - lap:5.1f} s", flush=True)
        for row in report.bars(part):
            what = f"{row.what}, {row.by} {row.setting}".rstrip()
            print(f"  {what:<72} {row.came[:60]:<16} {row.bar[:60]:<20} {row.verdict}".rstrip(), flush=True)


def _say(word: str, line: str) -> None:
    print(f"{word:<9} {line}", flush=True)


def _save(report: Report, arguments: argparse.Namespace, complete: bool) -> None:
    """Write tables, figures and pages into the folder."""
    folder, name = arguments.out, report.name
    bars = [row for part in report.parts for row in report.bars(part)]
    report.store.save(bars, complete)
    save_csv(folder / f"{name}.csv", report.rows())
    pictures = _draw(report, folder)
    if pictures is None:
        _say("files", "no figures: they need matplotlib; get it with pip install 'twistax[plot]'")
    context = {"report": report, "command": _command(arguments), "origin": report.store.origin}
    context |= {"pictures": pictures or {}, "drawn": pictures is not None}
    context |= {"title": report.title, "bars": bars, "missed": sum(row.holds is False for row in bars)}
    for kind, text in zip(("md", "html"), render(report.template, context | report.context()), strict=True):
        (folder / f"{name}.{kind}").write_text(text)
    for file in (*(f"{name}.{kind}" for kind in ("csv", "json", "md", "html")), "figures"):
        _say("files", str(folder / file))


def _draw(report: Report, folder: Path) -> Mapping[str, PageFigure] | None:
    """Draw the figures into the folder; gives them by name, None without matplotlib."""
    pictures = {}
    try:
        for stem, draw in report.drawings().items():
            path = f"figures/{stem}.svg"
            (folder / path).write_bytes(svg := draw())
            pictures[stem] = PageFigure(path, svg)
    except ImportError:
        return None
    return pictures


def _tables(folder: Path, name: str, complete: bool) -> dict[str, Table]:
    """The tables of this run's bars by name; after a complete run those of other complete runs in the folder, too."""
    groups: dict[str, list[ReportRow]] = {}
    for report in _REPORTS if complete else [name]:
        path = folder / f"{report}.json"
        document = json.loads(path.read_text()) if path.exists() else {}
        for record in document["bars"] if report == name or document.get("whole") else ():
            row = ReportRow.of(record)
            groups.setdefault(f"{report}: {row.group}", []).append(row)
    tables = {name: table_of(rows, wide=False) for name, rows in groups.items()}
    return tables | {f"{name}, wide": table_of(rows, wide=True) for name, rows in groups.items()}


def _command(arguments: argparse.Namespace) -> str:
    words = ["python -m twistax report"]
    words += [f"--{name}" for name in (*_REPORTS, "quick") if getattr(arguments, name, False)]
    for name in ("scene", "method", "case", "only"):
        words += [f"--{name} {value}" for value in getattr(arguments, name) or ()]
    return " ".join([*words, f"--out {arguments.out}"])
