"""Events at the edges of steps and of flights."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from .row import AtLeast, AtMost, Row, Section, flown

__all__ = ["EVENTS"]


@functools.cache
def _clock() -> tuple[tx.Dynamics, tx.State, tx.Parameter]:
    """x' = 1 from 0, so that x is the time; and where the event is."""
    x, at = tx.State("x"), tx.Parameter("at", value=0.5)
    return tx.compile(tx.System(rates={x: 1.0 + 0.0 * at})), x, at


@functools.cache
def _reaching() -> tx.Event:
    """x reaches `at`."""
    _, x, at = _clock()
    return tx.Event(x - at)


@functools.cache
def _product() -> tx.Event:
    """x passes 0.51 and 0.53."""
    _, x, _ = _clock()
    return tx.Event((x - 0.51) * (x - 0.53))


@functools.cache
def _touching() -> tx.Event:
    """x touches 0.55."""
    _, x, _ = _clock()
    return tx.Event((x - 0.55) ** 2)


@functools.cache
def _turning() -> tuple[tx.Dynamics, tx.Event]:
    """A body that turns at 1 rad/s about (1, 2, -2)/3, until its x axis has turned by as much as it can."""
    R = tx.State("R", group=tx.SO3)
    return tx.compile(tx.System(rates={R: np.array([1.0, 2.0, -2.0]) / 3.0})), tx.Event(R[0, 0] + 5.0 / 9.0)


def _ended(at: float, event: tx.Event | list[tx.Event] | None = None, **steps: Any) -> tx.Solution:
    dynamics, _, _ = _clock()
    return flown(
        dynamics, {"x": 0.0}, t1=1.0, params={"at": at}, event=_reaching() if event is None else event, **steps
    )


def _miss(at: float, **steps: Any) -> float:
    """How far from `at` the flight ended, s; not a number if it was not the event that ended it."""
    sol = _ended(at, **steps)
    return abs(float(sol.ts[-1]) - at) if sol.result is tx.Result.EVENT else float("nan")


def _end(event: Any, **steps: Any) -> float:
    """When the flight ended, s."""
    return float(_ended(0.5, event(), **steps).ts[-1])


def _tilted() -> float:
    """The miss of a condition on an attitude: 1/9 + 8/9 cos(t) = -5/9 at t = arccos(-3/4)."""
    dynamics, event = _turning()
    sol = flown(dynamics, {"R": np.eye(3)}, t1=3.0, rtol=1e-11, event=event)
    return abs(float(sol.ts[-1]) - np.arccos(-0.75))


EVENTS = Section(
    "events",
    "Events at the edge of a step",
    "x' = 1 from 0, so that an event at x = a is an event at t = a; steps of 0.1 s, up to 1 s. Misses in s.",
    (
        Row(
            "in the middle of a step, at 0.55 s",
            "RK4",
            lambda: _miss(0.55, dt=0.1),
            AtMost(3e-16, "s"),
            "The last step is flown again up to the root, to round-off of the time.",
        ),
        Row(
            "at the edge of a step, at 0.5 s",
            "RK4",
            lambda: _miss(0.5, dt=0.1),
            AtMost(3e-16, "s"),
            "A root between two steps belongs to one of them, and is not lost.",
        ),
        *(
            Row(
                f"{side} the edge of a step by 2e-16 s",
                "RK4",
                functools.partial(_miss, at, dt=0.1),
                AtMost(5e-16, "s"),
                "Round-off decides which step the root belongs to; the time is the same.",
            )
            for side, at in (("before", 0.5 - 2e-16), ("after", 0.5 + 2e-16))
        ),
        Row(
            "at the end of the flight, at 1 s",
            "RK4",
            lambda: abs(float(_ended(1.0, dt=0.1).ts[-1]) - 1.0),
            AtMost(3e-16, "s"),
            "Whether the flight counts as ended or as stopped, the time is the same.",
        ),
        Row(
            "at the start: the end of the flight",
            "RK4",
            lambda: float(_ended(0.0, dt=0.1).ts[-1]),
            AtLeast(1.0, "s"),
            "A condition that is zero at the start is no event: a body that leaves the ground has not landed.",
        ),
        Row(
            "two events in one step, at 0.56 and 0.53 s: the number of the one that stops it",
            "RK4",
            lambda: _first_of_two(),
            AtMost(3e-16, "s"),
            "Of several roots in a step the first counts, whichever was named first.",
        ),
        Row(
            "two roots of one condition within a step, at 0.51 and 0.53 s: the end of the flight",
            "RK4",
            lambda: _end(_product, dt=0.1),
            AtLeast(1.0, "s"),
            "The sign is the same at both ends of the step: such a pair is passed over, as the documentation says.",
        ),
        Row(
            "the same with steps of 0.02 s",
            "RK4",
            lambda: abs(_end(_product, dt=0.02) - 0.51),
            AtMost(3e-15, "s"),
            "Steps shorter than the time between the roots see them.",
        ),
        Row(
            "a condition that touches zero, at 0.55 s: the end of the flight",
            "RK4",
            lambda: _end(_touching, dt=0.1),
            AtLeast(1.0, "s"),
            "Without a change of sign there is no event; take the derivative as the condition.",
        ),
        Row(
            "a condition on an attitude, rtol 1e-11",
            "Tsit5",
            _tilted,
            AtMost(1e-10, "s"),
            "The root is found in the group, within the tolerance of the flight.",
        ),
    ),
)


def _first_of_two() -> float:
    """The miss of the earlier of two events, the later one named first."""
    _, x, _ = _clock()
    sol = _ended(0.5, [tx.Event(x - 0.56), tx.Event(x - 0.53)], dt=0.1)
    return abs(float(sol.ts[-1]) - 0.53) if sol.event == 1 else float("nan")
