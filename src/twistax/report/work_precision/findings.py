"""What the rows say: who agrees with the truth, the time at an error, rankings, and the bars."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping, Sequence

from ..checks import at_most, judged
from ..rows import Row, plain
from .contender import Contender, Line, Side
from .contenders import CONTENDERS, ONE_CALL, OURS, SHIPPED

__all__ = ["AGREED", "BARS", "TARGETS", "Bar", "Curve", "Doubt", "Findings", "Ranked", "bar_rows", "doubts"]

#: Errors at which methods are compared.
TARGETS = (1e-6, 1e-9)
#: A method agrees with the truth if one of its runs comes this close.
AGREED = 1e-6
#: Or if its finest run comes within so many of its tolerances: then it was only not run finer.
_TOLERANCES = 100.0
#: Errors below this are round-off, and have a logarithm.
_ROUND_OFF = 1e-16


def _error(row: Row) -> float:
    return row.numbers.get("error", math.nan)


# ---- agreement, asked before any times are compared -----------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Doubt:
    """A method that did not come close to the truth of a scene.

    Attributes:
        best: its smallest error; infinite where no run ended with a finite one.
        excuse: why that need not mean that it disagrees; empty where there is none.
    """

    scene: str
    method: str
    best: float
    excuse: str

    @property
    def disagrees(self) -> bool:
        return not self.excuse

    @property
    def sentence(self) -> str:
        best = f"smallest error {self.best:.1e}, " if math.isfinite(self.best) else ""
        return f"{self.method} on {self.scene}: {best}{self.excuse or 'and does not fall: IT DISAGREES'}"


def doubts(rows: Iterable[Row]) -> list[Doubt]:
    """Methods whose errors do not get below `AGREED`."""
    runs: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        runs.setdefault((row.group, row.by), []).append(row)
    found = []
    for (scene, method), own in runs.items():
        done = [row for row in sorted(own, key=_fineness) if row.done]
        best = min((_error(row) for row in done if math.isfinite(_error(row))), default=math.inf)
        if best > AGREED:
            found.append(Doubt(scene, method, best, _excuse(done)))
    return found


def _fineness(row: Row) -> float:
    """Numbers of steps grow, tolerances fall."""
    return row.numbers["setting"] if row.setting.startswith("steps") else -row.numbers["setting"]


def _excuse(done: list[Row]) -> str:
    if not done:
        return "none of its runs reached the end"
    last = done[-1]
    if len(done) > 1 and _error(last) < 0.5 * _error(done[-2]):
        return "still falling where it was stopped"
    if last.setting.startswith("tolerance") and _error(last) <= _TOLERANCES * last.numbers["setting"]:
        return "as close as its tolerance asks where it was stopped"
    return ""


# ---- the time at an error -------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Curve:
    """The best runs of a line, from the fastest to the most accurate: each is slower and better than the one before."""

    rows: tuple[Row, ...]

    @classmethod
    def of(cls, rows: Iterable[Row]) -> Curve:
        """The front of some rows; those without a time or an error are left out."""
        timed = [row for row in rows if row.done and math.isfinite(_error(row)) and math.isfinite(row.value)]
        front: list[Row] = []
        for row in sorted(timed, key=lambda row: (row.value, _error(row))):
            if not front or _error(row) < _error(front[-1]):
                front.append(row)
        return cls(tuple(front))

    def time_at(self, error: float) -> float:
        """Seconds for an error, on straight lines between the runs in logarithms of both.

        Of an error that the fastest run undercuts it is the time of that run. NaN where no run is accurate enough:
        nothing is extrapolated.
        """
        for number, row in enumerate(self.rows):
            if _error(row) <= error:
                return row.value if number == 0 else _between(self.rows[number - 1], row, error)
        return math.nan

    def row_at(self, error: float) -> Row | None:
        """The fastest run that is accurate enough."""
        return next((row for row in self.rows if _error(row) <= error), None)


def _between(coarse: Row, fine: Row, error: float) -> float:
    high, low, at = (math.log(max(value, _ROUND_OFF)) for value in (_error(coarse), _error(fine), error))
    if high == low:
        return fine.value
    share = (high - at) / (high - low)
    return math.exp((1.0 - share) * math.log(coarse.value) + share * math.log(fine.value))


# ---- all of it ------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Ranked:
    """A line and the time it takes, s."""

    line: Line
    seconds: float


class Findings:
    """Rows put together by scene and line.

    Methods that disagree with the truth of a scene do not take part there.

    Args:
        rows: of all scenes.
        contenders: by name; their order is that of tables.
    """

    def __init__(self, rows: Iterable[Row], contenders: Mapping[str, Contender]) -> None:
        self.rows = [row for row in rows if row.by in contenders]
        present = {row.by for row in self.rows}
        self.contenders = {name: contender for name, contender in contenders.items() if name in present}
        self.doubts: list[Doubt] = doubts(self.rows)
        self.scenes: list[str] = list(dict.fromkeys(row.group for row in self.rows))
        self.lines: list[Line] = list(dict.fromkeys(contender.line for contender in self.contenders.values()))

    @property
    def agreed(self) -> bool:
        """Whether every method that was run far enough finds the same answers; one of ours must reach an end."""
        return not any(doubt.disagrees or self._fails(doubt) for doubt in self.doubts)

    def _fails(self, doubt: Doubt) -> bool:
        return math.isinf(doubt.best) and self.contenders[doubt.method].line.side == OURS

    @functools.cache  # noqa: B019  lives as long as the report
    def curve(self, scene: str, line: Line) -> Curve:
        """Of a line's runs of a scene, without methods that disagree."""
        out = {doubt.method for doubt in self.doubts if doubt.scene == scene and doubt.disagrees}
        own = [row for row in self.rows if row.group == scene and row.by not in out]
        return Curve.of(row for row in own if self.contenders[row.by].line == line)

    def time(self, scene: str, line: Line, error: float) -> float:
        """Seconds for an error; NaN where the line does not get there."""
        return self.curve(scene, line).time_at(error)

    def ranking(self, scene: str, error: float, lines: Sequence[Line] | None = None) -> list[Ranked]:
        """Lines that reach an error, the fastest first."""
        times = [Ranked(line, self.time(scene, line, error)) for line in (self.lines if lines is None else lines)]
        return sorted((each for each in times if math.isfinite(each.seconds)), key=lambda each: each.seconds)

    def best(self, scene: str, error: float, side: Side) -> Ranked | None:
        """The fastest line of a side."""
        return next(iter(self.ranking(scene, error, [line for line in self.lines if line.side == side])), None)

    def drawn(self, scene: str) -> list[Line]:
        """The lines of the scene's figure: those meant to be drawn, or all there are if none of them was run."""
        there = [line for line in self.lines if self.curve(scene, line).rows]
        return [line for line in there if line.drawn] or there

    def sittings(self, scene: str) -> int:
        """How many sittings the rows of a scene come from."""
        return len({row.sitting for row in self.rows if row.group == scene})


# ---- bars: what we want to be true, said beforehand -----------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Bar:
    """A method's time over the better of diffrax's Tsit5 and Dopri8, at most `limit` at every error of `TARGETS`."""

    scene: str
    method: str
    against: Side
    limit: float


#: The chart of DOP853 that is compared on each scene, chosen before the measurement.
_NAMED = dict.fromkeys(("euler-top", "heavy-top", "rocket", "low-orbit"), "dop853-quaternion") | {"fast-spin": "dop853"}
_EXPONENTIAL = "dop853"
#: What it is compared with: the better of these.
_RIVALS = {
    ONE_CALL: ("diffrax-tsit5-call", "diffrax-dopri8-call"),
    SHIPPED: ("diffrax-tsit5", "diffrax-dopri8"),
}


def _bars() -> tuple[Bar, ...]:
    found: dict[Bar, None] = {}
    for scene, method in _NAMED.items():
        fast = scene == "fast-spin"
        found[Bar(scene, method, ONE_CALL, 0.4 if fast else 0.7)] = None
        found[Bar(scene, _EXPONENTIAL, ONE_CALL, 0.4 if fast else 0.85)] = None
        found[Bar(scene, method, SHIPPED, 0.3)] = None
    return tuple(found)


BARS = _bars()


def bar_rows(
    findings: Findings, names: Mapping[str, str], contenders: Mapping[str, Contender] = CONTENDERS
) -> list[Row]:
    """Every bar whose scene and method were run, at every error.

    Args:
        names: titles of the scenes.
    """
    found = []
    for bar in BARS:
        if bar.scene in findings.scenes and bar.method in findings.contenders:
            ours, rivals = contenders[bar.method].line, [contenders[name].line for name in _RIVALS[bar.against]]
            for error in TARGETS:
                theirs = min((each.seconds for each in findings.ranking(bar.scene, error, rivals)), default=math.nan)
                ratio = findings.time(bar.scene, ours, error) / theirs
                what = f"{names[bar.scene]}, error {plain(error)}"
                row = Row("bars", what, ours.title, f"over {bar.against.name}", ratio)
                found.append(judged(row, at_most(bar.limit)))
    return found
