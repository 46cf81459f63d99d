"""`python -m twistax report`: measure what is not there yet, print what came, write page, figures and tables."""

from __future__ import annotations

import argparse
import functools
import importlib
import importlib.util
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from .page import MISSING, Picture, Table, bar_table, render, renew, table_of
from .report import Report
from .rows import Origin, Row, Store, save_csv

#: Reports whose bars a document may show.
_RENEWED = ("report", "speed", "stability", "figures")
_WIDTH = 24


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
    kind = next((name for name in ("stability", "figures", "speed") if getattr(arguments, name)), "work_precision")
    # Loaded where it is run: each brings much of the package with it.
    module = importlib.import_module(f".{kind}.page", __package__)
    return run_report(module.report(arguments), arguments)


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
    report.store = Store(folder / f"{report.name}.json", Origin.now(report.effort, report.versions))
    _say("machine", report.store.origin.machine)
    for name, why in report.missing.items():
        _say("absent", f"{name}: {why}")
    if report.store.dropped:
        _say("rows", f"{report.store.dropped} of other versions, code, machine or effort dropped")
    progress = Progress(sys.stderr, report.parts, shown=not arguments.no_progress)
    for part in report.parts:
        if arguments.again:
            report.store.forget(part)
        lap, before = time.perf_counter(), len(report.store)
        report.measure(part, functools.partial(progress.tell, part))
        progress.clear()
        print(f"{part:<18} {len(report.store) - before:4d} rows in {time.perf_counter() - lap:5.1f} s", flush=True)
        for row in report.bars(part):
            what = f"{row.what}, {row.by} {row.setting}".rstrip()
            print(f"  {what:<72} {row.came[:60]:<16} {row.bar[:60]:<20} {row.verdict}".rstrip(), flush=True)
    problems = report.problems()
    for line in problems:
        _say("doubt", line)
    _save(report, arguments)
    if arguments.renew:
        names = renew(arguments.renew, _tables(folder))
        _say("renewed", f"{arguments.renew}: {', '.join(names) or 'no table of this report is marked there'}")
    _say("time", f"{time.perf_counter() - begin:.1f} s in all")
    return 1 if problems else 0


class Progress:
    """One line that is overwritten; silent where the stream is no terminal, or when told to be."""

    def __init__(self, stream: Any, parts: Sequence[str], shown: bool) -> None:
        self._stream, self._parts, self._shown = stream, list(parts), shown and stream.isatty()
        self._begin = time.perf_counter()

    def tell(self, part: str, what: str, share: float) -> None:
        """Show what is going on, and how much of a part is done; parts are of equal weight."""
        whole = (self._parts.index(part) + share) / len(self._parts)
        bar, seconds = "=" * round(_WIDTH * whole), time.perf_counter() - self._begin
        self._write(f"[{bar:<{_WIDTH}}] {whole:4.0%} {seconds:4.0f} s  {part}  {what}")

    def clear(self) -> None:
        """Make room for what is printed."""
        self._write("")

    def _write(self, text: str) -> None:
        if self._shown:
            self._stream.write(f"\r\033[K{text}")
            self._stream.flush()


def _say(word: str, line: str) -> None:
    print(f"{word:<9} {line}", flush=True)


def _save(report: Report, arguments: argparse.Namespace) -> None:
    """Tables, figures and pages."""
    folder, name, origin = arguments.out, report.name, report.store.origin
    bars = [row for part in report.parts for row in report.bars(part)]
    report.store.save(bars)
    save_csv(folder / f"{name}.csv", report.rows())
    pictures = {}
    try:
        for stem, draw in report.drawings().items():
            path = f"figures/{stem}.svg"
            (folder / path).write_bytes(svg := draw())
            pictures[stem] = Picture(path, svg)
        drawn = True
    except ImportError:
        drawn = False
        _say("files", "no figures: they need matplotlib; get it with pip install 'twistax[plot]'")
    common = {
        "name": name,
        "title": report.title,
        "command": _command(arguments),
        "origin": origin,
        "effort": report.effort,
        "pictures": pictures,
        "drawn": drawn,
        "missing": report.missing,
        "bars": bar_table(bars),
        "missed": sum(row.holds is False for row in bars),
        "bar_count": len(bars),
        "versions": ", ".join(f"{package} {version}" for package, version in origin.versions.items()),
    }
    for kind, text in zip(("md", "html"), render(report.template, common | report.context()), strict=True):
        (folder / f"{name}.{kind}").write_text(text)
    for each in (*(f"{name}.{kind}" for kind in ("csv", "json", "md", "html")), "figures"):
        _say("files", str(folder / each))


def _tables(folder: Path) -> dict[str, Table]:
    """The tables of bars of all reports that were kept in a folder, by name."""
    groups: dict[str, list[Row]] = {}
    for name in _RENEWED:
        path = folder / f"{name}.json"
        for record in json.loads(path.read_text())["bars"] if path.exists() else ():
            row = Row.of(record)
            groups.setdefault(f"{name}: {row.group}", []).append(row)
    tables = {name: table_of(rows, wide=False) for name, rows in groups.items()}
    return tables | {f"{name}, wide": table_of(rows, wide=True) for name, rows in groups.items()}


def _command(arguments: argparse.Namespace) -> str:
    """The words that give this run again."""
    words = ["python -m twistax report"]
    words += [f"--{name}" for name in ("stability", "speed", "figures", "quick") if getattr(arguments, name)]
    for name in ("scene", "method", "case", "only"):
        words += [f"--{name} {value}" for value in getattr(arguments, name) or ()]
    return " ".join([*words, f"--out {arguments.out}"])
