"""One group of the report: a quantity of a case, all uses, all contenders; compared first, then timed in turn."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from statistics import median, quantiles
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..turns import Tell, seconds_of, time_in_turn
from ..work_precision.store import Store
from .case import Case
from .contender import Contender
from .effort import Effort
from .quantity import Quantity
from .row import DONE, Row
from .task import Lacks, Program, Task
from .use import USES, Batch, Use

__all__ = ["AGREEMENT", "apart", "measure"]

#: The largest difference from the reference with which a contender is timed.
AGREEMENT = 1e-9


@dataclasses.dataclass
class _Entry:
    """A contender in one use: its row so far, and what is called to be timed."""

    row: Row
    program: Program
    rough: float
    samples: list[float] = dataclasses.field(default_factory=list)

    @property
    def call(self) -> Callable[[], Any]:
        return self.program.call

    def timed(self) -> Row:
        each = sorted(sample / self.program.evaluations for sample in self.samples)
        lower, _, upper = quantiles(each, method="inclusive") if len(each) > 1 else (each[0], each[0], each[0])
        return dataclasses.replace(
            self.row, median=median(each), lower=lower, upper=upper, fastest=each[0], repeats=len(each)
        )


def measure(
    case: Case,
    quantity: Quantity,
    uses: Sequence[Use],
    contenders: Sequence[Contender],
    effort: Effort,
    store: Store[Row],
    tell: Tell,
) -> None:
    """Rows of all uses, kept use by use; those that are there already are not measured again.

    Args:
        contenders: all are on this machine; the first that has the task is the reference.
    """
    tasks: dict[str, Task | str] = {}
    for number, use in enumerate(uses):
        if all(store.get(case.name, quantity.name, use.name, each.name) for each in contenders):
            continue

        def said(what: str, share: float, number: int = number, use: Use = use) -> None:
            tell(f"{quantity.name}, {use.name}: {what}", (number + share) / len(uses))

        waiting = {each.name: _wait(store, case, quantity, use, each) for each in contenders}
        long = {name: f"a call would take {wait:.0f} s" for name, wait in waiting.items() if wait > effort.longest}
        store.add(_measure_use(case, quantity, use, contenders, effort, tasks, long, said))


def _wait(store: Store[Row], case: Case, quantity: Quantity, use: Use, contender: Contender) -> float:
    """What a call will take, s, going by smaller batches; zero where there is none."""
    if not isinstance(use, Batch):
        return 0.0
    smaller = [other for other in USES if isinstance(other, Batch) and other.count < use.count]
    rows = [store.get(case.name, quantity.name, other.name, contender.name) for other in smaller]
    return max((row.median * use.count for row in rows if row is not None and row.done), default=0.0)


def _measure_use(
    case: Case,
    quantity: Quantity,
    use: Use,
    contenders: Sequence[Contender],
    effort: Effort,
    tasks: dict[str, Task | str],
    long: Mapping[str, str],
    tell: Tell,
) -> list[Row]:
    rows: list[Row] = []
    entries: list[_Entry] = []
    reference: NDArray[np.float64] | None = None
    sitting = datetime.now().isoformat(timespec="seconds")
    for number, contender in enumerate(contenders):
        tell(f"compiling {contender.name}", 0.5 * number / len(contenders))
        row = Row(case.name, quantity.name, use.name, contender.name, DONE, sitting=sitting)
        if contender.name in long:
            rows.append(dataclasses.replace(row, result=long[contender.name]))
            continue
        try:
            program = use.of(_task(tasks, contender, case, quantity))
            values = program.values()
        except Lacks as error:
            rows.append(dataclasses.replace(row, result=str(error)))
            continue
        except (RuntimeError, MemoryError, subprocess.SubprocessError) as error:  # of a compiler, or no memory
            rows.append(dataclasses.replace(row, result=f"failed: {_first_line(error)}"))
            continue
        if program.compile_seconds > effort.patience:
            tasks[contender.name] = f"compiling another use took {program.compile_seconds:.0f} s"
        reference = values if reference is None else reference
        row = dataclasses.replace(
            row,
            difference=apart(values, reference, len(quantity.shape(case))),
            evaluations=program.evaluations,
            compile_seconds=program.compile_seconds,
        )
        if not row.difference <= AGREEMENT:
            rows.append(dataclasses.replace(row, result=f"disagrees by {row.difference:.0e}"))
            continue
        entries.append(_Entry(row, program, seconds_of(program.call)))
    for entry in entries:
        if entry.rough > effort.longest:
            entry.samples.append(entry.rough)
    time_in_turn([entry for entry in entries if not entry.samples], effort, tell)
    timed = {row.contender: row for row in [*rows, *(entry.timed() for entry in entries)]}
    return [timed[contender.name] for contender in contenders]


def _task(tasks: dict[str, Task | str], contender: Contender, case: Case, quantity: Quantity) -> Task:
    """Made once for all uses. Raises Lacks, also for what was refused before."""
    if contender.name not in tasks:
        try:
            tasks[contender.name] = contender.task(case, quantity)
        except Lacks as error:
            tasks[contender.name] = str(error)
    found = tasks[contender.name]
    if isinstance(found, str):
        raise Lacks(found)
    return found


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:120]


def apart(values: NDArray[np.float64], reference: NDArray[np.float64], rank: int) -> float:
    """The largest difference of the entries over the largest entry of the reference, the worst of all points.

    Infinite where shapes differ or something is not finite.

    Args:
        rank: of one result; axes before are points.
    """
    if values.shape != reference.shape or not np.all(np.isfinite(values)):
        return math.inf
    axes = tuple(range(values.ndim - rank, values.ndim))
    size = np.max(np.abs(reference), axis=axes)
    return float(np.max(np.max(np.abs(values - reference), axis=axes) / size))
