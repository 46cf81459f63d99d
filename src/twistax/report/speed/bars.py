"""What we want to be true, said beforehand: ratios of times and seconds to compile, each with its limit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

from .own import Native, Scalars
from .peers.casadi import Casadi
from .peers.plain_jax import PlainJax
from .quantity import JACOBIAN, VALUE, Quantity
from .row import Row
from .use import LOOP, Batch, Use

__all__ = ["BARS", "Bar", "Outcome", "outcomes"]


@dataclasses.dataclass(frozen=True)
class Bar:
    """Median time of a contender over that of another, at most `limit`; seconds to compile if `against` is None."""

    case: str
    quantity: Quantity
    use: Use
    contender: str
    against: str | None
    limit: float


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A bar and what was found; not a number where one side was not measured."""

    bar: Bar
    found: float

    @property
    def verdict(self) -> str:
        if math.isnan(self.found):
            return "not measured"
        return "holds" if self.found <= self.bar.limit else "MISSED"


_MANY = Batch(4096)
_OURS, _NATIVE, _PLAIN, _C = Scalars.name, Native.name, PlainJax.name, Casadi.name

BARS: tuple[Bar, ...] = (
    Bar("aba-7", VALUE, LOOP, _OURS, _PLAIN, 0.2),
    Bar("aba-7", VALUE, _MANY, _OURS, _PLAIN, 0.5),
    Bar("aba-7", VALUE, LOOP, _OURS, None, 1.0),
    Bar("aba-30", VALUE, LOOP, _OURS, None, 7.0),
    Bar("aba-7", VALUE, _MANY, _NATIVE, _C, 0.15),
    Bar("aba-7", VALUE, _MANY, _NATIVE, _PLAIN, 0.03),
    Bar("rnea-7", VALUE, _MANY, _NATIVE, _C, 0.15),
    Bar("free-body", VALUE, _MANY, _NATIVE, _C, 0.4),
    Bar("aba-7", JACOBIAN, _MANY, _NATIVE, _C, 0.2),
    Bar("aba-7", VALUE, LOOP, _NATIVE, _C, 1.2),
)


def outcomes(rows: Iterable[Row]) -> list[Outcome]:
    """Every bar whose case was run with its quantity and use."""
    found = {row.key: row for row in rows if row.done}
    result = []
    for bar in BARS:
        place = (bar.case, bar.quantity.name, bar.use.name)
        if any(key[:3] == place for key in found):
            result.append(Outcome(bar, _found(bar, found.get((*place, bar.contender)), found, place)))
    return result


def _found(bar: Bar, row: Row | None, rows: dict[tuple[str, str, str, str], Row], place: tuple[str, str, str]) -> float:
    if row is None:
        return math.nan
    if bar.against is None:
        return row.compile_seconds
    other = rows.get((*place, bar.against))
    return row.median / other.median if other else math.nan
