"""`python -m twistax report`: measure what is not there yet, print what came, write page, figures and tables."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
from pathlib import Path

import jax

from .pages.page import MISSING, Picture, render, renew, section_table
from .progress import Progress
from .report import Report
from .rows import Row, save_csv

__all__ = ["run", "run_report"]

#: Reports whose bars a document may show.
_RENEWED = ("report", "speed", "stability", "figures")


def run(arguments: argparse.Namespace) -> int:
    """Run the report that the options ask for.

    Args:
        arguments: what `add_options` declares.
    Returns:
        the exit status: 0 done; 1 something disagrees, or a check is not what was asked for; 2 the folder cannot be
        written, or jinja2 is missing.
    """
    if importlib.util.find_spec("jinja2") is None:
        print(f"twistax report: {MISSING}", file=sys.stderr)
        return 2
    # Loaded where it is run: each brings much of the package with it.
    if arguments.stability:
        from .stability.sections import report as stability

        return run_report(stability(arguments), arguments)
    if arguments.figures:
        from .figures.sections import report as figures

        return run_report(figures(arguments), arguments)
    if arguments.speed:
        from .speed.report import Speed

        return run_report(Speed(arguments), arguments)
    from .work_precision.report import WorkPrecision

    return run_report(WorkPrecision(arguments), arguments)


def run_report(report: Report, arguments: argparse.Namespace) -> int:
    """The same for a report that is there; see `run`."""
    begin = time.perf_counter()
    folder: Path = arguments.out
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"twistax report: cannot write to --out {folder}: {error.strerror}", file=sys.stderr)
        return 2
    if report.one_thread:
        jax.config.update("jax_cpu_enable_async_dispatch", False)
    report.open(folder)
    _say("machine", report.store.origin.machine)
    for line in report.opening():
        _say("absent", line)
    if report.store.dropped:
        _say("rows", f"{report.store.dropped} of other versions, code, machine or effort dropped")
    progress = Progress(sys.stderr, len(report.parts), shown=not arguments.no_progress)
    for part in report.parts:
        if arguments.again:
            report.store.forget(part)
        lap, before = time.perf_counter(), len(report.store)
        progress.start(part)
        report.measure(part, progress.tell)
        progress.end()
        print(f"{part:<18} {len(report.store) - before:4d} rows in {time.perf_counter() - lap:5.1f} s", flush=True)
        for line in report.said(part):
            print(f"  {line}", flush=True)
    for line in report.conclusion():
        _say("bar", line)
    problems = report.problems()
    for line in problems:
        _say("doubt", line)
    for line in _save(report, folder, _command(arguments)):
        _say("files", line)
    if arguments.renew:
        names = renew(arguments.renew, _tables(folder))
        _say("renewed", f"{arguments.renew}: {', '.join(names) or 'no table of this report is marked there'}")
    _say("time", f"{time.perf_counter() - begin:.1f} s in all")
    return 1 if problems else 0


def _say(word: str, line: str) -> None:
    print(f"{word:<9} {line}", flush=True)


def _save(report: Report, folder: Path, command: str) -> list[str]:
    """Tables, figures and pages; a line for each."""
    name = report.name
    report.store.save(report.bars())
    save_csv(folder / f"{name}.csv", report.rows())
    said = [str(folder / f"{name}.{kind}") for kind in ("csv", "json", "md", "html")]
    pictures: dict[str, Picture] = {}
    drawn = True
    try:
        for stem, draw in report.drawings().items():
            path = f"figures/{stem}.svg"
            (folder / path).write_bytes(svg := draw())
            pictures[stem] = Picture(path, svg)
        said.append(str(folder / "figures"))
    except ImportError:
        drawn = False
        said.append("no figures: they need matplotlib; get it with pip install 'twistax[plot]'")
    origin = report.store.origin
    common = {
        "name": name,
        "title": report.title,
        "command": command,
        "origin": origin,
        "pictures": pictures,
        "drawn": drawn,
        "versions": ", ".join(f"{package} {version}" for package, version in origin.versions.items()),
    }
    pages = render(report.template, common | report.context())
    for kind, text in zip(("md", "html"), pages, strict=True):
        (folder / f"{name}.{kind}").write_text(text)
    return said


def _tables(folder: Path) -> dict[str, tuple[list[str], list[list[str]], int]]:
    """The tables of bars of all reports that were kept in a folder, by name."""
    groups: dict[str, list[Row]] = {}
    for name in _RENEWED:
        path = folder / f"{name}.json"
        for record in json.loads(path.read_text())["bars"] if path.exists() else ():
            row = Row.of(record)
            groups.setdefault(f"{name}: {row.group}", []).append(row)
    tables = {name: section_table(rows, wide=False) for name, rows in groups.items()}
    return tables | {f"{name}, wide": section_table(rows, wide=True) for name, rows in groups.items()}


def _command(arguments: argparse.Namespace) -> str:
    """The words that give this run again."""
    words = ["python -m twistax report"]
    words += [f"--{name}" for name in ("stability", "speed", "figures", "quick") if getattr(arguments, name)]
    for name in ("scene", "method", "case", "only"):
        words += [f"--{name} {value}" for value in getattr(arguments, name) or ()]
    return " ".join([*words, f"--out {arguments.out}"])
