"""`python -m twistax report --speed`."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

from ..checks import at_most, judged
from ..progress import Tell
from ..report import Report
from ..rows import Row
from ..timing import empty_call_seconds
from .casadi import Casadi
from .case import CASES
from .contender import ARRAYS, NATIVE, PLAIN, SCALARS, Contender
from .measure import FULL, QUICK, measure
from .openscvx import OpenScvx
from .page import context, draw
from .pinocchio import Pinocchio
from .programs import JACOBIAN, LOOP, QUANTITIES, USES, VALUE, Batch, Quantity

__all__ = ["BARS", "CONTENDERS", "Bar", "Speed", "bar_rows"]

CONTENDERS: tuple[Contender, ...] = (SCALARS, NATIVE, ARRAYS, PLAIN, OpenScvx(), Casadi(), Pinocchio())


@dataclasses.dataclass(frozen=True)
class Bar:
    """Median time of a contender over that of another, at most `limit`; seconds to compile if `against` is None."""

    case: str
    quantity: Quantity
    use: str
    contender: Contender
    against: str | None
    limit: float


_MANY = Batch.with_points(4096).name

#: What we want to be true, said beforehand.
BARS: tuple[Bar, ...] = (
    Bar("aba-7", VALUE, LOOP.name, SCALARS, PLAIN.name, 0.2),
    Bar("aba-7", VALUE, _MANY, SCALARS, PLAIN.name, 0.5),
    Bar("free-body", VALUE, LOOP.name, SCALARS, OpenScvx.name, 1.0),
    Bar("aba-7", VALUE, LOOP.name, SCALARS, None, 1.0),
    Bar("aba-30", VALUE, LOOP.name, SCALARS, None, 7.0),
    Bar("aba-7", VALUE, _MANY, NATIVE, Casadi.name, 0.15),
    Bar("aba-7", VALUE, _MANY, NATIVE, PLAIN.name, 0.03),
    Bar("rnea-7", VALUE, _MANY, NATIVE, Casadi.name, 0.15),
    Bar("free-body", VALUE, _MANY, NATIVE, Casadi.name, 0.4),
    Bar("aba-7", JACOBIAN, _MANY, NATIVE, Casadi.name, 0.2),
    Bar("aba-7", VALUE, LOOP.name, NATIVE, Casadi.name, 1.2),
)


def bar_rows(rows: Sequence[Row]) -> list[Row]:
    """Every bar whose case was run with its quantity and use."""
    found = {row.key: row for row in rows if row.done}
    result = []
    for bar in BARS:
        case, quantity, use = bar.case, bar.quantity.name, bar.use
        if any((key[0], key[1], key[3]) == (case, quantity, use) for key in found):
            own = found.get((case, quantity, bar.contender.name, use))
            other = found.get((case, quantity, bar.against or "", use))
            if bar.against is None:
                value = own.numbers["compile_seconds"] if own else math.nan
            else:
                value = own.value / other.value if own and other else math.nan
            what, setting = (
                f"{CASES[case].title}, {quantity}, {use}",
                f"over {bar.against}" if bar.against else "compiling",
            )
            row = Row("bars", what, bar.contender.name, setting, value)
            result.append(judged(row, at_most(bar.limit, "" if bar.against else "s")))
    return result


class Speed(Report):
    name, template, title = "speed", "speed", "What does one evaluation cost?"
    # Everything as it comes: nothing is set but x64.
    one_thread = False

    def __init__(self, arguments: argparse.Namespace, contenders: Sequence[Contender] = CONTENDERS) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self._missing = {each.name: why for each in contenders if (why := each.absent()) is not None}
        self._contenders = [each for each in contenders if each.name not in self._missing]
        self.parts = [name for name in CASES if name in (arguments.case or self._effort.cases or CASES)]

    def versions(self) -> dict[str, str]:
        return {name: version for each in self._contenders for name, version in each.versions().items()}

    def opening(self) -> list[str]:
        return [f"{name}: {reason}" for name, reason in self._missing.items()]

    def measure(self, part: str, tell: Tell) -> None:
        quantities = [each for each in QUANTITIES if each.name in (self._effort.quantities or (each.name,))]
        uses = [use for use in USES if not (isinstance(use, Batch) and use.count > self._effort.largest)]
        for number, quantity in enumerate(quantities):

            def said(what: str, share: float, number: int = number) -> None:
                tell(what, (number + share) / len(quantities))

            measure(CASES[part], quantity, uses, self._contenders, self._effort, self.store, said)

    def rows(self) -> list[Row]:
        present = {each.name for each in self._contenders}
        return [row for name in self.parts for row in self.store if row.group == name and row.by in present]

    def bars(self) -> list[Row]:
        return bar_rows(self.rows())

    def problems(self) -> list[str]:
        wrong = [row for row in self.rows() if row.note.startswith("disagrees")]
        return [f"{row.by} {row.note}: {row.group} {row.what} {row.setting}" for row in wrong]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        rows = self.rows()

        def drawing(quantity: Quantity) -> Callable[[], bytes]:
            return lambda: draw(rows, quantity, self._contenders)

        timed = {row.what for row in rows if row.done}
        return {f"speed-{each.name}": drawing(each) for each in QUANTITIES if each.name in timed}

    def context(self) -> dict[str, Any]:
        empty = empty_call_seconds()
        return context(self.rows(), self._contenders, self.bars(), self._missing, self._effort, empty)
