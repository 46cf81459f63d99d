"""Events at the edges of steps and of integrations, and controls that jump."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import se3
from ..checks import Check, Section, at_least, at_most, simulated


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


def _ended(event: str | list[tx.Event], at: float = 0.5, dt: float = 0.1) -> tx.Solution:
    events = _condition(event) if isinstance(event, str) else event
    return simulated(_clock()[0], {"x": 0.0}, t1=1.0, params={"at": at}, event=events, dt=dt)


def _end(name: str, at: float = 0.5, dt: float = 0.1) -> float:
    """When the integration ended, s."""
    return float(_ended(name, at, dt).ts[-1])


def _miss(at: float) -> float:
    """How far from `at` it ended, s; NaN if it was not the event that ended it."""
    sol = _ended("reaching", at)
    return abs(float(sol.ts[-1]) - at) if sol.result is tx.Result.EVENT else float("nan")


def _first_of_two() -> float:
    """The miss of the earlier of two events, the later one named first."""
    x = _clock()[1]
    sol = _ended([tx.Event(x - 0.56), tx.Event(x - 0.53)])
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


_LATE = at_least(1.0, "s")

EVENTS = Section(
    "events",
    [
        "The last step is taken again up to the root, to round-off of the time.",
        Check("in the middle of a step, at 0.55 s", "RK4", lambda: _miss(0.55), at_most(3e-16, "s")),
        "A root between two steps belongs to one of them, and is not lost.",
        Check("at the edge of a step, at 0.5 s", "RK4", lambda: _miss(0.5), at_most(3e-16, "s")),
        "Round-off decides which step the root belongs to; the time is the same.",
        Check("before the edge of a step by 2e-16 s", "RK4", lambda: _miss(0.5 - 2e-16), at_most(5e-16, "s")),
        Check("after the edge of a step by 2e-16 s", "RK4", lambda: _miss(0.5 + 2e-16), at_most(5e-16, "s")),
        "Whether it counts as ended or as stopped, the time is the same.",
        Check("at the end, at 1 s", "RK4", lambda: abs(_end("reaching", 1.0) - 1.0), at_most(3e-16, "s")),
        "A condition that is zero at the start is no event: a body that leaves the ground has not landed.",
        Check("at the start: the end", "RK4", lambda: _end("reaching", 0.0), _LATE),
        "Of several roots in a step the first counts, whichever was named first.",
        Check("two events in one step, at 0.56 and 0.53 s", "RK4", _first_of_two, at_most(3e-16, "s")),
        "The sign is the same at both ends of the step: such a pair is passed over, as the documentation says.",
        Check(
            "two roots of one condition within a step, at 0.51 and 0.53 s: the end",
            "RK4",
            lambda: _end("product"),
            _LATE,
        ),
        "Steps shorter than the time between the roots see them.",
        Check("the same, 0.02 s a step", "RK4", lambda: abs(_end("product", dt=0.02) - 0.51), at_most(3e-15, "s")),
        "Without a change of sign there is no event; take the derivative as the condition.",
        Check("a condition that touches zero, at 0.55 s: the end", "RK4", lambda: _end("touching"), _LATE),
        "The root is found in the group, within the tolerance of the integration.",
        Check("a condition on an attitude, rtol 1e-11", "Tsit5", _tilted, at_most(1e-10, "s")),
    ],
)

# ---- jumps ----------------------------------------------------------------------------------------------------------

#: A twist that is held between jumps: times, s, and twists.
_TIMES = np.array([0.0, 0.3, 0.7, 0.7 + 1e-9, 1.6])
_TWISTS = np.array(
    [
        [1, 0, 0, 0.3, 2, 0],
        [0, -3, 0, -1, 0, 0.5],
        [1e6, 0, 0, 0, 0, 1e6],
        [0.5, 0.5, 0.5, 0, 0, -2],
        [0, 0, 1, 1, 1, 1.0],
    ]
)
_END = 2.0


@functools.cache
def _driven(group: Any) -> tx.Dynamics:
    """A pose that follows a twist, or a first-order lag that follows a command."""
    x, F = tx.State("x", group=group) if group else tx.State("x"), tx.Control("F", shape=(6,) if group else ())
    return tx.compile(tx.System(rates={x: F if group else F - x}))


@functools.cache
def _poses() -> tuple[float, int]:
    """The largest error of the pose, and the steps taken back: the truth is a product of exponentials."""
    options = {"rtol": 1e-9, "method": tx.RKMK(tx.tableaus.DOP853)}
    table = tx.ZeroOrderHold(ts=_TIMES, values=_TWISTS)
    sol = simulated(_driven(tx.SE3), {"x": np.eye(4)}, t1=_END, u={"F": table}, **options)
    truth = np.eye(4)
    for twist, length in zip(_TWISTS, np.diff([*_TIMES, _END]), strict=True):
        truth = truth @ np.asarray(se3.exp(jnp.asarray(length * twist)))
    return float(np.max(np.abs(np.asarray(sol.xs["x"][-1]) - truth))), sol.stats.rejected


def _switched(u: Any, **options: Any) -> float:
    """The error at 1 s of x' = F - x from 0 for the switch at 0.4 s."""
    sol = simulated(_driven(None), {"x": 0.0}, t1=1.0, u=u, **options)
    return abs(float(sol.xs["x"][-1]) - float((2.0 - np.exp(-0.4)) * np.exp(0.4 - 1.0) - 1.0))


def _chosen(what: str, u: Any, bar: float, **jumps: Any) -> Check:
    method = tx.RKMK(tx.tableaus.TSIT5)
    return Check(what, "Tsit5", lambda: _switched(u, rtol=1e-10, method=method, **jumps), at_most(bar))


def _switch(t: Any) -> dict[str, Any]:
    return {"F": jnp.where(t < 0.4, 1.0, -1.0)}


_TABLE = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4], values=[1.0, -1.0])}
_AT_ENDS = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4, 1.0], values=[1.0, -1.0, 1e9])}

JUMPS = Section(
    "jumps",
    [
        "Steps end at every row of a table, also where two are 1e-9 s apart.",
        Check("five twists, rtol 1e-9", "DOP853", lambda: _poses()[0], at_most(1e-13)),
        "Nothing has to be found out by steps that fail.",
        Check("the same: steps taken back", "DOP853", lambda: _poses()[1], at_most(0.0, "steps")),
        "A step ends at the switch.",
        _chosen("a table, rtol 1e-10", _TABLE, 1e-10),
        "A function's jumps are not seen from outside; named, they are ends of steps.",
        _chosen("a function that switches at 0.4 s, named with jumps, rtol 1e-10", _switch, 1e-10, jumps=[0.4]),
        "The error control finds the jump, at many steps taken back, and to its tolerance only.",
        _chosen("the same, not named", _switch, 1e-7),
        "Where the switch falls between two equal steps, the order is kept.",
        Check("a table, on the edge of a step of 0.1 s", "RK4", lambda: _switched(_TABLE, dt=0.1), at_most(1e-6)),
        "Equal steps do not see a switch inside of them: the order is lost.",
        Check("a table, inside of a step of 1/6 s", "RK4", lambda: _switched(_TABLE, dt=1.0 / 6.0), at_most(0.3)),
        "What is commanded from the end on does not reach back.",
        _chosen("a table with a jump at the start and at the end, rtol 1e-10", _AT_ENDS, 1e-10),
    ],
)
