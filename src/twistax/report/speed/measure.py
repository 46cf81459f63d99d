"""Compare contenders, then time those that agree in turn."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from collections.abc import Sequence
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from ..rows import Row, Store
from ..timing import Repeats, Tell, Timed, keep, quiet
from .case import Case
from .contenders import Contender
from .programs import Lacks, Quantity, Task, Use, values

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
    tell: Tell = quiet,
) -> None:
    """Rows of all uses, kept use by use; those that are there already are not measured again.

    Args:
        contenders: all are on this machine; the first that has the task is the reference.
    """
    tasks: dict[str, Task | str] = {}
    for number, use in enumerate(uses):
        if all(store.get(case.name, quantity.name, each.name, use.name) for each in contenders):
            continue

        def told(what: str, share: float, number: int = number, use: Use = use) -> None:
            tell(f"{quantity.name}, {use.name}: {what}", (number + share) / len(uses))

        pairs: list[tuple[Row, Timed | None]] = []
        reference: NDArray[np.float64] | None = None
        sitting = datetime.now().isoformat(timespec="seconds")
        for i, contender in enumerate(contenders):
            told(f"compiling {contender.name}", 0.5 * i / len(contenders))
            row = Row(case.name, quantity.name, contender.name, use.name, unit="s", sitting=sitting)
            smaller = [store.get(*row.key[:3], other.name) for other in uses if 0 < other.count < use.count]
            wait = max((row.value * use.count for row in smaller if row is not None and row.done), default=0.0)
            try:
                if wait > effort.longest:
                    raise Lacks(f"a call would take {wait:.0f} s")
                timed = use.of(_task(tasks, contender, case, quantity))
                result = values(timed)
            except Lacks as error:
                pairs.append((dataclasses.replace(row, note=str(error)), None))
                continue
            except (RuntimeError, MemoryError, subprocess.SubprocessError) as error:  # of a compiler, or no memory
                first = (str(error).strip().splitlines() or [type(error).__name__])[0]
                pairs.append((dataclasses.replace(row, note=f"failed: {first[:120]}"), None))
                continue
            if timed.compile_seconds > effort.patience:
                tasks[contender.name] = f"compiling another use took {timed.compile_seconds:.0f} s"
            reference = result if reference is None else reference
            pairs.append((_compared(row, timed, apart(result, reference, len(quantity.shape(case)))), timed))
            if pairs[-1][0].done and timed.look() > effort.longest:
                timed.samples.append(timed.rough)
        keep(pairs, effort.repeats, store, told)


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


def _compared(row: Row, timed: Timed, difference: float) -> Row:
    numbers = {"evaluations": float(timed.evaluations), "compile_seconds": timed.compile_seconds}
    note = row.note if difference <= AGREEMENT else f"disagrees by {difference:.0e}"
    return dataclasses.replace(row, note=note, numbers={"difference": difference, **numbers})


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
