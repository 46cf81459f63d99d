"""Compare contenders, then time those that agree in turn."""

from __future__ import annotations

import dataclasses
import math
import subprocess
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rows import Row, Store, first_line, now
from ..timing import Repeats, Tell, Timed, keep, quiet
from .cases import Case
from .contenders import Contender
from .programs import Lacks, Quantity, Task, Use, values

#: The largest difference from the reference with which a contender is timed.
AGREEMENT = 1e-9


@dataclasses.dataclass(frozen=True)
class Effort:
    """What is run, and how often it is repeated."""

    name: str  # for the page
    cases: tuple[str, ...]  # names of those that are run if none is asked for; empty for all
    quantities: tuple[str, ...]  # the same
    largest: int  # batches of more points are left out
    longest: float  # a call that takes longer, s, is timed once; left out if a smaller batch says so before
    patience: float  # where compiling takes longer, s, further uses of the same are left out
    repeats: Repeats  # of every call of a group, in turn


FULL = Effort("full", (), (), 65536, 10.0, 150.0, Repeats(31, 3, 0.5))
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

    The first contender that has the task is the reference.
    """
    tasks: dict[str, Task] = {}
    for number, use in enumerate(uses):
        if all(store.get(case.name, quantity.name, each.name, use.name) for each in contenders):
            continue

        def told(what: str, share: float, number: int = number, use: Use = use) -> None:
            tell(f"{quantity.name}, {use.name}: {what}", (number + share) / len(uses))

        pairs: list[tuple[Row, Timed | None]] = []
        reference: Any = None
        sitting = now()
        for i, contender in enumerate(contenders):
            told(f"compiling {contender.name}", 0.5 * i / len(contenders))
            row = Row(case.name, quantity.name, contender.name, use.name, unit="s", sitting=sitting)
            smaller = [store.get(*row.key[:3], other.name) for other in uses if 0 < other.count < use.count]
            wait = max((row.value * use.count for row in smaller if row is not None and row.done), default=0.0)
            if wait > effort.longest:
                pairs.append((dataclasses.replace(row, note=f"a call would take {wait:.0f} s"), None))
                continue
            try:
                # Made once for all uses, and refused once.
                if contender.name not in tasks:
                    tasks[contender.name] = contender.task(case, quantity)
                if isinstance(task := tasks[contender.name], Lacks):
                    raise task
                timed = use.of(task)
                result = values(timed)
            except (
                Lacks,
                RuntimeError,
                MemoryError,
                subprocess.SubprocessError,
            ) as error:  # of a compiler, or no memory
                if isinstance(error, Lacks):
                    tasks.setdefault(contender.name, error)
                why = str(error) if isinstance(error, Lacks) else f"failed: {first_line(error)[:120]}"
                pairs.append((dataclasses.replace(row, note=why), None))
                continue
            if timed.compile_seconds > effort.patience:
                tasks[contender.name] = Lacks(f"compiling another use took {timed.compile_seconds:.0f} s")
            reference = result if reference is None else reference
            off = apart(result, reference, len(quantity.shape(case)))
            numbers = {"evaluations": float(timed.evaluations), "compile_seconds": timed.compile_seconds}
            note = row.note if off <= AGREEMENT else f"disagrees by {off:.0e}"
            pairs.append((dataclasses.replace(row, note=note, numbers={"difference": off, **numbers}), timed))
            if timed.rough > effort.longest:
                timed.samples.append(timed.rough)
        keep(pairs, effort.repeats, store, told)


def apart(found: NDArray[np.float64], reference: NDArray[np.float64], rank: int) -> float:
    """The largest difference of entries over the largest of the reference, the worst of all points.

    Infinite where shapes differ or something is not finite. The rank is that of one result.
    """
    if found.shape != reference.shape or not np.all(np.isfinite(found)):
        return math.inf
    axes = tuple(range(found.ndim - rank, found.ndim))
    return float(np.max(np.max(np.abs(found - reference), axis=axes) / np.max(np.abs(reference), axis=axes)))
