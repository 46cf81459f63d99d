"""Timing of what competes: calls take turns, so that whatever else the machine does falls on all alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

import jax

__all__ = ["SHORT", "Repeats", "Tell", "Timed", "seconds_of", "time_in_turn"]

#: Called with what is going on, and how much of it is done, 0 to 1.
Tell = Callable[[str, float], None]

#: Timed calls in a row on each visit, after one that is not timed; what is longer (s) is called once.
_CALLS, SHORT = 3, 5e-3


@runtime_checkable
class Timed(Protocol):
    """What is called, how long that takes about, s, and the samples of time so far, s."""

    @property
    def call(self) -> Callable[[], Any]: ...
    @property
    def rough(self) -> float: ...
    @property
    def samples(self) -> list[float]: ...


@runtime_checkable
class Repeats(Protocol):
    """How often.

    Attributes:
        rounds: at most.
        least: and at least, however long the call.
        share: time for all repeats of one call, s; a longer one is repeated less often.
    """

    @property
    def rounds(self) -> int: ...
    @property
    def least(self) -> int: ...
    @property
    def share(self) -> float: ...


def time_in_turn(timed: Sequence[Timed], effort: Repeats, tell: Tell) -> None:
    """Rounds over all; what takes long takes part in some of them, evenly spread."""
    visits = [_visits(each.rough, effort) for each in timed]
    for number in range(effort.rounds):
        tell("timing", 0.5 + 0.5 * number / effort.rounds)
        for each, wanted in zip(timed, visits, strict=True):
            if (number + 1) * wanted // effort.rounds > number * wanted // effort.rounds:
                short = each.rough < SHORT
                if short:
                    jax.block_until_ready(each.call())
                each.samples.extend(seconds_of(each.call) for _ in range(_CALLS if short else 1))


def _visits(rough: float, effort: Repeats) -> int:
    visit = rough * (1 + _CALLS if rough < SHORT else 1)
    return min(effort.rounds, max(effort.least, int(effort.share / max(visit, 1e-9))))


def seconds_of(call: Callable[[], Any]) -> float:
    """Of one call, its results waited for."""
    begin = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - begin
