"""Compare contenders, then time those that agree in turn."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..progress import Tell
from ..rows import Row
from ..store import Store
from ..timing import Repeats, Timed, in_turn
from .case import Case
from .contender import Contender
from .programs import Batch, Lacks, Quantity, Task, Use, values

__all__ = ["AGREEMENT", "FULL", "QUICK", "Effort", "apart", "measure"]

#: The largest difference from the reference with which a contender is timed.
AGREEMENT = 1e-9


@dataclasses.dataclass(frozen=True)
class Effort:
    """What is run, and how often it is repeated.

    Attributes:
        name: for the page.
        cases, quantities: names of those that are run if none is asked for; empty for all.
        largest: batches of more points are left out.
        longest: a call that takes longer, s, is timed once only; left out if a smaller batch says so before.
        patience: where compiling takes longer, s, further uses of the same are left out.
        repeats: of every call of a group, in turn.
    """

    name: str
    cases: tuple[str, ...]
    quantities: tuple[str, ...]
    largest: int
    longest: float
    patience: float
    repeats: Repeats


FULL = Effort("full", (), (), 65536, 20.0, 150.0, Repeats(41, 5, 1.0))
QUICK = Effort("quick", ("free-body", "aba-7"), ("value",), 4096, 1.0, 60.0, Repeats(15, 3, 0.1))


def measure(
    case: Case,
    quantity: Quantity,
    uses: Sequence[Use],
    contenders: Sequence[Contender],
    effort: Effort,
    store: Store,
    tell: Tell,
) -> None:
    """Rows of all uses, kept use by use; those that are there already are not measured again.

    Args:
        contenders: all are on this machine; the first that has the task is the reference.
    """
    group = _Group(case, quantity, contenders, effort, store)
    for number, use in enumerate(uses):
        if all(group.row(use, each) for each in contenders):
            continue

        def said(what: str, share: float, number: int = number, use: Use = use) -> None:
            tell(f"{quantity.name}, {use.name}: {what}", (number + share) / len(uses))

        store.add(group.measure(use, [other for other in uses if isinstance(other, Batch)], said))


class _Group:
    """A quantity of a case by all contenders. Tasks are made once for all uses."""

    def __init__(
        self, case: Case, quantity: Quantity, contenders: Sequence[Contender], effort: Effort, store: Store
    ) -> None:
        self._case, self._quantity, self._contenders = case, quantity, contenders
        self._effort, self._store = effort, store
        #: A task, or why there is none.
        self._tasks: dict[str, Task | str] = {}

    def row(self, use: Use, contender: Contender) -> Row | None:
        """The row that is there."""
        return self._store.get(self._case.name, self._quantity.name, contender.name, use.name)

    def measure(self, use: Use, batches: Sequence[Batch], tell: Tell) -> list[Row]:
        """A row of each contender."""
        rows: dict[str, Row] = {}
        timed: dict[str, Timed] = {}
        reference: NDArray[np.float64] | None = None
        sitting = datetime.now().isoformat(timespec="seconds")
        for number, contender in enumerate(self._contenders):
            name = contender.name
            tell(f"compiling {name}", 0.5 * number / len(self._contenders))
            row = Row(self._case.name, self._quantity.name, name, use.name, unit="s", sitting=sitting)
            try:
                program, found = self._program(use, batches, contender)
            except Lacks as error:
                rows[name] = dataclasses.replace(row, note=str(error))
                continue
            except (RuntimeError, MemoryError, subprocess.SubprocessError) as error:  # of a compiler, or no memory
                rows[name] = dataclasses.replace(row, note=f"failed: {_first_line(error)}")
                continue
            reference = found if reference is None else reference
            difference = apart(found, reference, len(self._quantity.shape(self._case)))
            numbers = {
                "difference": difference,
                "evaluations": float(program.evaluations),
                "compile_seconds": program.compile_seconds,
            }
            agrees = difference <= AGREEMENT
            note = row.note if agrees else f"disagrees by {difference:.0e}"
            rows[name] = dataclasses.replace(row, note=note, numbers=numbers)
            if agrees:
                timed[name] = program
                program.look()
        self._time(list(timed.values()), tell)
        return [_with_times(row, timed.get(name)) for name, row in rows.items()]

    def _program(self, use: Use, batches: Sequence[Batch], contender: Contender) -> tuple[Timed, NDArray[np.float64]]:
        """What is timed, and its results. Raises Lacks, also for what was refused before."""
        wait = self._wait(use, batches, contender)
        if wait > self._effort.longest:
            raise Lacks(f"a call would take {wait:.0f} s")
        task = self._task(contender)
        program = use.of(task)
        found = values(program)
        if program.compile_seconds > self._effort.patience:
            self._tasks[contender.name] = f"compiling another use took {program.compile_seconds:.0f} s"
        return program, found

    def _task(self, contender: Contender) -> Task:
        if contender.name not in self._tasks:
            try:
                self._tasks[contender.name] = contender.task(self._case, self._quantity)
            except Lacks as error:
                self._tasks[contender.name] = str(error)
        found = self._tasks[contender.name]
        if isinstance(found, str):
            raise Lacks(found)
        return found

    def _wait(self, use: Use, batches: Sequence[Batch], contender: Contender) -> float:
        """What a call will take, s, going by smaller batches; zero where there is none."""
        if not isinstance(use, Batch):
            return 0.0
        rows = [self.row(other, contender) for other in batches if other.count < use.count]
        return max((row.value * use.count for row in rows if row is not None and row.done), default=0.0)

    def _time(self, timed: Sequence[Timed], tell: Tell) -> None:
        long = [each for each in timed if each.rough > self._effort.longest]
        for each in long:
            each.samples.append(each.rough)
        in_turn([each for each in timed if each not in long], self._effort.repeats, tell)


def _with_times(row: Row, timed: Timed | None) -> Row:
    if timed is None:
        return row
    lower, upper = timed.quartiles
    more: dict[str, Any] = {
        "lower": lower,
        "upper": upper,
        "fastest": timed.fastest,
        "repeats": float(len(timed.samples)),
    }
    return dataclasses.replace(row, value=timed.seconds, numbers={**row.numbers, **more})


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:120]


def apart(found: NDArray[np.float64], reference: NDArray[np.float64], rank: int) -> float:
    """The largest difference of the entries over the largest entry of the reference, the worst of all points.

    Infinite where shapes differ or something is not finite.

    Args:
        rank: of one result; axes before are points.
    """
    if found.shape != reference.shape or not np.all(np.isfinite(found)):
        return math.inf
    axes = tuple(range(found.ndim - rank, found.ndim))
    size = np.max(np.abs(reference), axis=axes)
    return float(np.max(np.max(np.abs(found - reference), axis=axes) / size))
