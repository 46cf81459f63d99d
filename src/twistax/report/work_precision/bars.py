"""What we want to be true, said beforehand: ratios of times at an error, each with its limit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

from .contender import Contender, Side
from .contenders import CONTENDERS, ONE_CALL, SHIPPED
from .findings import TARGETS, Findings

__all__ = ["BARS", "Bar", "Outcome", "outcomes"]

#: The chart of DOP853 that is compared on each scene, chosen before the measurement.
_NAMED = {
    "euler-top": "dop853-quaternion",
    "heavy-top": "dop853-quaternion",
    "rocket": "dop853-quaternion",
    "low-orbit": "dop853-quaternion",
    "fast-spin": "dop853",
}
_EXPONENTIAL = "dop853"
#: What it is compared with: the better of these.
_RIVALS = {
    ONE_CALL: ("diffrax-tsit5-call", "diffrax-dopri8-call"),
    SHIPPED: ("diffrax-tsit5", "diffrax-dopri8"),
}


@dataclasses.dataclass(frozen=True)
class Bar:
    """A method's time over the better of diffrax's Tsit5 and Dopri8, at most `limit` at every error of `TARGETS`."""

    scene: str
    method: str
    against: Side
    limit: float


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A bar at one error.

    Attributes:
        ratio: not a number where one side does not reach the error.
    """

    bar: Bar
    error: float
    ratio: float

    @property
    def verdict(self) -> str:
        if math.isnan(self.ratio):
            return "not measured"
        return "holds" if self.ratio <= self.bar.limit else "MISSED"


def _bars() -> tuple[Bar, ...]:
    found: dict[Bar, None] = {}
    for scene, method in _NAMED.items():
        fast = scene == "fast-spin"
        found[Bar(scene, method, ONE_CALL, 0.4 if fast else 0.7)] = None
        found[Bar(scene, _EXPONENTIAL, ONE_CALL, 0.4 if fast else 0.85)] = None
        found[Bar(scene, method, SHIPPED, 0.3)] = None
    return tuple(found)


BARS = _bars()


def outcomes(findings: Findings, contenders: Mapping[str, Contender] = CONTENDERS) -> list[Outcome]:
    """Every bar whose scene and method were run, at every error."""
    found = []
    for bar in BARS:
        if bar.scene not in findings.scenes or bar.method not in findings.contenders:
            continue
        rivals = [contenders[name].line for name in _RIVALS[bar.against]]
        for error in TARGETS:
            ours = findings.time(bar.scene, contenders[bar.method].line, error)
            theirs = min((each.seconds for each in findings.ranking(bar.scene, error, rivals)), default=math.nan)
            found.append(Outcome(bar, error, ours / theirs))
    return found
