"""`python -m twistax report --stability`: run all rows, write page, figures and table."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from importlib import metadata
from pathlib import Path

from ..machine import machine
from ..work_precision.blocks import as_html, as_markdown
from ..work_precision.progress import Progress
from .figure import draw
from .outcome import Outcome
from .page import TITLE, page
from .row import Section
from .sections import SECTIONS

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Run every row, or the fast ones with `--quick`, and write everything into `--out`.

    Returns:
        the exit status: 0 all as expected, 1 a row did something else, 2 the folder cannot be written.
    """
    begin = time.perf_counter()
    folder: Path = arguments.out
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"twistax report: cannot write to --out {folder}: {error.strerror}", file=sys.stderr)
        return 2
    progress = Progress(sys.stderr, len(SECTIONS), shown=not arguments.no_progress)
    outcomes: list[Outcome] = []
    for section in SECTIONS:
        lap = time.perf_counter()
        progress.start(section.name)
        found = _outcomes(section, arguments.quick, progress)
        progress.end()
        bad = [each for each in found if not each.good]
        said = f"{len(bad)} UNEXPECTED" if bad else "as expected"
        print(f"{section.name:<12} {len(found):4d} rows in {time.perf_counter() - lap:5.1f} s, {said}", flush=True)
        for each in bad:
            print(f"  {each.row.case} ({each.row.method}): {each.found.text}; should: {each.row.expected.text}")
        outcomes += found
    command = f"python -m twistax report --stability{' --quick' if arguments.quick else ''} --out {folder}"
    for line in _save(folder, outcomes, command):
        print(f"files        {line}")
    print(f"time         {time.perf_counter() - begin:.1f} s in all")
    return 0 if all(each.good for each in outcomes) else 1


def _outcomes(section: Section, quick: bool, progress: Progress) -> list[Outcome]:
    rows = [row for row in section.rows if not (quick and row.slow)]
    found = []
    for number, row in enumerate(rows):
        progress.tell(row.case, number / len(rows))
        found.append(Outcome(section, row, row.observe()))
    return found


def _save(folder: Path, outcomes: list[Outcome], command: str) -> list[str]:
    """Table, figures and pages; a line for each."""
    with (folder / "stability.csv").open("w", newline="") as file:
        records = [each.record() for each in outcomes]
        table = csv.DictWriter(file, list(records[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(records)
    said = [str(folder / name) for name in ("stability.csv", "stability.md", "stability.html")]
    figures: dict[str, bytes] = {}
    try:
        for section in SECTIONS:
            drawn = draw([each for each in outcomes if each.section is section])
            if drawn is not None:
                figures[section.name] = drawn
                (folder / "figures" / f"stability-{section.name}.svg").write_bytes(drawn)
        said.append(str(folder / "figures"))
    except ImportError:
        said.append("no figures: they need matplotlib; get it with pip install 'twistax[plot]'")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("twistax", "jax", "jaxlib", "numpy"))
    blocks = page(outcomes, figures, machine(), versions, command)
    (folder / "stability.md").write_text(as_markdown(blocks))
    (folder / "stability.html").write_text(as_html(TITLE, blocks))
    return said
