"""`python -m twistax report --speed`: compare, measure, write page, figures and tables."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from ..turns import Tell
from ..work_precision.blocks import as_html, as_markdown
from ..work_precision.flights import empty_call_seconds
from ..work_precision.origin import Origin, origin_of
from ..work_precision.progress import Progress
from ..work_precision.store import Store, save_csv, save_json
from .bars import Outcome, outcomes
from .case import CASES
from .contender import Contender
from .contenders import CONTENDERS
from .effort import FULL, QUICK, Effort
from .figure import draw
from .measure import measure
from .page import TITLE, page
from .quantity import QUANTITIES
from .row import COLUMNS, Row
from .use import USES, Batch

__all__ = ["run"]

#: What may change a time, beside the package itself.
_HERE = Path(__file__).parent
_MEASURING = tuple(
    path for path in sorted(_HERE.rglob("*")) if path.suffix in (".py", ".c") and path.stem not in ("page", "figure")
)


def run(arguments: argparse.Namespace) -> int:
    """Measure what is not there yet, and write everything into `--out`.

    Returns:
        the exit status: 0 done, 1 a contender disagrees, 2 the folder cannot be written.
    """
    begin = time.perf_counter()
    folder: Path = arguments.out
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"twistax report: cannot write to --out {folder}: {error.strerror}", file=sys.stderr)
        return 2
    effort = QUICK if arguments.quick else FULL
    missing = {each.name: reason for each in CONTENDERS if (reason := each.absent()) is not None}
    contenders = [each for each in CONTENDERS if each.name not in missing]
    versions = {name: version for each in contenders for name, version in each.versions().items()}
    origin = origin_of(effort, _MEASURING, versions)
    store = Store(folder / "speed-rows.jsonl", origin, Row.of)
    print(f"machine   {origin.machine}", flush=True)
    for name, reason in missing.items():
        print(f"absent    {name}: {reason}", flush=True)
    if store.dropped:
        print(f"rows      {store.dropped} of other versions, code, machine or effort dropped", flush=True)

    cases = [name for name in CASES if name in (arguments.case or effort.cases or CASES)]
    progress = Progress(sys.stderr, len(cases), shown=not arguments.no_progress)
    for name in cases:
        lap, before = time.perf_counter(), len(store)
        progress.start(name)
        _measure_case(name, contenders, effort, store, progress.tell)
        progress.end()
        print(f"{name:<10}{len(store) - before:4d} rows in {time.perf_counter() - lap:5.1f} s", flush=True)

    present = {each.name for each in contenders}
    rows = [row for name in cases for row in store if row.case == name and row.contender in present]
    bars = outcomes(rows)
    for each in bars:
        print(
            f"bar       {each.bar.case} {each.bar.quantity.name} {each.bar.use.name}, {each.bar.contender} / "
            f"{each.bar.against or 's to compile'}: {each.found:.3f} of {each.bar.limit:g}  {each.verdict}"
        )
    wrong = [row for row in rows if row.result.startswith("disagrees")]
    for row in wrong:
        print(f"doubt     {row.contender} {row.result}: {row.case} {row.quantity} {row.use}")
    for line in _save(folder, rows, bars, missing, origin, _command(arguments)):
        print(f"files     {line}")
    print(f"time      {time.perf_counter() - begin:.1f} s in all")
    return 1 if wrong else 0


def _measure_case(name: str, contenders: list[Contender], effort: Effort, store: Store[Row], tell: Tell) -> None:
    quantities = [each for each in QUANTITIES if each.name in (effort.quantities or (each.name,))]
    uses = [use for use in USES if not (isinstance(use, Batch) and use.count > effort.largest)]
    for number, quantity in enumerate(quantities):

        def said(what: str, share: float, number: int = number) -> None:
            tell(what, (number + share) / len(quantities))

        measure(CASES[name], quantity, uses, contenders, effort, store, said)


def _save(
    folder: Path, rows: list[Row], bars: list[Outcome], missing: dict[str, str], origin: Origin, command: str
) -> list[str]:
    """Tables, figures and pages; a line for each."""
    save_csv(folder / "speed.csv", COLUMNS, rows)
    verdicts = [
        {
            "case": each.bar.case,
            "quantity": each.bar.quantity.name,
            "use": each.bar.use.name,
            "contender": each.bar.contender,
            "against": each.bar.against,
            "limit": each.bar.limit,
            "found": each.found if each.found == each.found else None,
            "verdict": each.verdict,
        }
        for each in bars
    ]
    document = {
        "machine": origin.machine,
        "versions": origin.versions,
        "code": origin.code,
        "effort": origin.effort,
        "absent": missing,
        "bars": verdicts,
        "columns": list(COLUMNS),
        "rows": [list(row.record().values()) for row in rows],
    }
    save_json(folder / "speed.json", document)
    figures: dict[str, bytes] = {}
    said = [str(folder / name) for name in ("speed.csv", "speed.json", "speed.md", "speed.html")]
    try:
        for quantity in QUANTITIES:
            drawn = draw(rows, quantity)
            if drawn is not None:
                figures[quantity.name] = drawn
                (folder / "figures" / f"speed-{quantity.name}.svg").write_bytes(drawn)
        said.append(str(folder / "figures"))
    except ImportError:
        said.append("no figures: they need matplotlib; get it with pip install 'twistax[plot]'")
    blocks = page(rows, bars, missing, origin, empty_call_seconds(), figures, command)
    (folder / "speed.md").write_text(as_markdown(blocks))
    (folder / "speed.html").write_text(as_html(TITLE, blocks))
    return said


def _command(arguments: argparse.Namespace) -> str:
    words = ["python -m twistax report --speed"]
    words += [f"--case {name}" for name in arguments.case or ()]
    words += ["--quick"] if arguments.quick else []
    return " ".join([*words, f"--out {arguments.out}"])
