"""What the rows say: who is fastest at which error, on which scene."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping, Sequence

from .agreement import Doubt, doubts
from .contender import Contender, Line, Side
from .contenders import OURS
from .curve import Curve
from .row import Row

__all__ = ["TARGETS", "Findings", "Ranked"]

#: Errors at which methods are compared.
TARGETS = (1e-6, 1e-9)


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
        self.rows = [row for row in rows if row.method in contenders]
        self.contenders = {
            name: contender for name, contender in contenders.items() if any(row.method == name for row in self.rows)
        }
        self.doubts: list[Doubt] = doubts(self.rows)
        self.scenes: list[str] = list(dict.fromkeys(row.scene for row in self.rows))
        self.lines: list[Line] = list(dict.fromkeys(contender.line for contender in self.contenders.values()))

    @property
    def agreed(self) -> bool:
        """Whether every method that was run far enough finds the same answers; one of ours must finish a flight."""
        return not any(doubt.disagrees or self._fails(doubt) for doubt in self.doubts)

    def _fails(self, doubt: Doubt) -> bool:
        return math.isinf(doubt.best) and self.contenders[doubt.method].line.side == OURS

    def rows_of(self, scene: str, line: Line) -> list[Row]:
        """The flights of a scene on a line, without methods that disagree."""
        out = {doubt.method for doubt in self.doubts if doubt.scene == scene and doubt.disagrees}
        return [
            row
            for row in self.rows
            if row.scene == scene and row.method not in out and self.contenders[row.method].line == line
        ]

    @functools.cache  # noqa: B019  lives as long as the report
    def curve(self, scene: str, line: Line) -> Curve:
        return Curve.of(self.rows_of(scene, line))

    def time(self, scene: str, line: Line, error: float) -> float:
        """Seconds for an error; not a number where the line does not get there."""
        return self.curve(scene, line).time_at(error)

    def ranking(self, scene: str, error: float, lines: Sequence[Line] | None = None) -> list[Ranked]:
        """Lines that reach an error, the fastest first."""
        lines = self.lines if lines is None else lines
        times = [Ranked(line, self.time(scene, line, error)) for line in lines]
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
        return len({row.sitting for row in self.rows if row.scene == scene})
