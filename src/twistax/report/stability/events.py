"""Events at the edges of steps and of integrations."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from ..checks import Check, Section, at_least, at_most, simulated

__all__ = ["EVENTS"]


@functools.cache
def _clock() -> tuple[tx.Dynamics, tx.State, tx.Parameter]:
    """x' = 1 from 0, so that x is the time; and where the event is."""
    x, at = tx.State("x"), tx.Parameter("at", value=0.5)
    return tx.compile(tx.System(rates={x: 1.0 + 0.0 * at})), x, at


@functools.cache
def _condition(name: str) -> tx.Event:
    """x reaches `at`; passes 0.51 and 0.53; touches 0.55. Made once, so that each is compiled once."""
    _, x, at = _clock()
    reaching, product, touching = x - at, (x - 0.51) * (x - 0.53), (x - 0.55) ** 2
    return tx.Event({"reaching": reaching, "product": product, "touching": touching}[name])


def _ended(at: float, event: tx.Event | list[tx.Event], **steps: Any) -> tx.Solution:
    return simulated(_clock()[0], {"x": 0.0}, t1=1.0, params={"at": at}, event=event, **steps)


def _end(name: str, at: float = 0.5, **steps: Any) -> float:
    """When the integration ended, s."""
    return float(_ended(at, _condition(name), **steps).ts[-1])


def _miss(at: float, **steps: Any) -> float:
    """How far from `at` it ended, s; NaN if it was not the event that ended it."""
    sol = _ended(at, _condition("reaching"), **steps)
    return abs(float(sol.ts[-1]) - at) if sol.result is tx.Result.EVENT else float("nan")


def _first_of_two() -> float:
    """The miss of the earlier of two events, the later one named first."""
    x = _clock()[1]
    sol = _ended(0.5, [tx.Event(x - 0.56), tx.Event(x - 0.53)], dt=0.1)
    return abs(float(sol.ts[-1]) - 0.53) if sol.event == 1 else float("nan")


def _tilted() -> float:
    """A body turns at 1 rad/s about (1, 2, -2)/3, until its x axis has turned by as much as it can.

    1/9 + 8/9 cos(t) = -5/9 at t = arccos(-3/4).
    """
    R = tx.State("R", group=tx.SO3)
    turning = tx.compile(tx.System(rates={R: np.array([1.0, 2.0, -2.0]) / 3.0}))
    event, method = tx.Event(R[0, 0] + 5.0 / 9.0), tx.RKMK(tx.tableaus.TSIT5)
    sol = simulated(turning, {"R": np.eye(3)}, t1=3.0, rtol=1e-11, method=method, event=event)
    return abs(float(sol.ts[-1]) - np.arccos(-0.75))


EVENTS = Section(
    "events",
    "Events at the edge of a step",
    "x' = 1 from 0, so that an event at x = a is an event at t = a; steps of 0.1 s, up to 1 s. Misses in s.",
    {
        "The last step is taken again up to the root, to round-off of the time.": [
            Check("in the middle of a step, at 0.55 s", "RK4", lambda: _miss(0.55, dt=0.1), at_most(3e-16, "s")),
        ],
        "A root between two steps belongs to one of them, and is not lost.": [
            Check("at the edge of a step, at 0.5 s", "RK4", lambda: _miss(0.5, dt=0.1), at_most(3e-16, "s")),
        ],
        "Round-off decides which step the root belongs to; the time is the same.": [
            Check(
                f"{side} the edge of a step by 2e-16 s",
                "RK4",
                functools.partial(_miss, at, dt=0.1),
                at_most(5e-16, "s"),
            )
            for side, at in (("before", 0.5 - 2e-16), ("after", 0.5 + 2e-16))
        ],
        "Whether it counts as ended or as stopped, the time is the same.": [
            Check("at the end, at 1 s", "RK4", lambda: abs(_end("reaching", 1.0, dt=0.1) - 1.0), at_most(3e-16, "s")),
        ],
        "A condition that is zero at the start is no event: a body that leaves the ground has not landed.": [
            Check("at the start: the end", "RK4", lambda: _end("reaching", 0.0, dt=0.1), at_least(1.0, "s")),
        ],
        "Of several roots in a step the first counts, whichever was named first.": [
            Check("two events in one step, at 0.56 and 0.53 s", "RK4", _first_of_two, at_most(3e-16, "s")),
        ],
        "The sign is the same at both ends of the step: such a pair is passed over, as the documentation says.": [
            Check(
                "two roots of one condition within a step, at 0.51 and 0.53 s: the end",
                "RK4",
                lambda: _end("product", dt=0.1),
                at_least(1.0, "s"),
            ),
        ],
        "Steps shorter than the time between the roots see them.": [
            Check("the same, 0.02 s a step", "RK4", lambda: abs(_end("product", dt=0.02) - 0.51), at_most(3e-15, "s")),
        ],
        "Without a change of sign there is no event; take the derivative as the condition.": [
            Check(
                "a condition that touches zero, at 0.55 s: the end",
                "RK4",
                lambda: _end("touching", dt=0.1),
                at_least(1.0, "s"),
            ),
        ],
        "The root is found in the group, within the tolerance of the integration.": [
            Check("a condition on an attitude, rtol 1e-11", "Tsit5", _tilted, at_most(1e-10, "s")),
        ],
    },
)
