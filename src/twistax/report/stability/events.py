"""Events and jumps of controls at the ends of steps."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import se3
from ..harness.expected import at_most, between, ends, simulated
from ..harness.measurement import MeasuredCase, Section, quick

_METHODS = {"DOP853": tx.RKMK(tx.tableaus.DOP853), "RK4": tx.RKMK(tx.tableaus.RK4), "Tsit5": tx.RKMK(tx.tableaus.TSIT5)}


@functools.cache
def _clock() -> tuple[tx.Dynamics, dict[str, tx.Event]]:
    """x' = 1 from 0, so that x is the time; and events by name."""
    x, at = tx.State("x"), tx.Parameter("at", value=0.5)
    conditions = {"reaching": x - at, "product": (x - 0.51) * (x - 0.53), "touching": (x - 0.55) ** 2}
    conditions |= {"late": x - 0.56, "early": x - 0.53}
    dynamics = tx.compile(tx.System(rates={x: 1.0 + 0.0 * at}))
    return dynamics, {name: tx.Event(condition) for name, condition in conditions.items()}


def _ended(*names: str, at: float = 0.5, dt: float = 0.1) -> tx.Solution:
    dynamics, events = _clock()
    return simulated(dynamics, {"x": 0.0}, t1=1.0, params={"at": at}, event=[events[name] for name in names], dt=dt)


def _end(name: str, at: float = 0.5) -> float:
    """When the integration ended, s."""
    return float(_ended(name, at=at).ts[-1])


def _miss(wanted: float, *names: str, which: int = 0, **how: float) -> float:
    """The distance of the end from a time, s; NaN if another event ended the integration."""
    sol = _ended(*names, **how)
    ended = sol.result is tx.Result.EVENT and sol.event == which
    return abs(float(sol.ts[-1]) - wanted) if ended else float("nan")


def _reached(what: str, at: float, bar: float) -> MeasuredCase:
    return quick(what, "RK4", at_most(bar, "s"), _miss, at, "reaching", at=at)


def _tilted() -> float:
    """A body turns at 1 rad/s about (1, 2, -2)/3, until its x axis has turned by as much as it can.

    1/9 + 8/9 cos(t) = -5/9 at t = arccos(-3/4).
    """
    R = tx.State("R", group=tx.SO3)
    turning, event = tx.compile(tx.System(rates={R: np.array([1.0, 2.0, -2.0]) / 3.0})), tx.Event(R[0, 0] + 5.0 / 9.0)
    sol = simulated(turning, {"R": np.eye(3)}, t1=3.0, rtol=1e-11, method=_METHODS["Tsit5"], event=event)
    return abs(float(sol.ts[-1]) - np.arccos(-0.75))


@functools.cache
def _ball() -> tx.Dynamics:
    h, v = tx.State("h"), tx.State("v")
    return tx.compile(tx.System(rates={h: v, v: -tx.Parameter("pull", value=10.0) + 0.0 * v}))


def _thrown(*events: tx.Event, speed: float = 10.0, **how: Any) -> tx.Solution:
    how = dict[str, Any]({"t0": 0.0, "t1": 3.0, "rtol": 1e-9, "method": _METHODS["Tsit5"]}) | how
    at: float = how["t0"]
    start = {"h": speed * at - 5.0 * at * at, "v": speed - 10.0 * at}
    return simulated(_ball(), start, event=list(events), **how)


_H = tx.State("h")
_LEVEL, _GROUND = tx.Event(_H - 3.0, terminal=False), tx.Event(_H, direction=False)
#: When the ball, thrown at 10 m/s under 10 m/s^2, is 3 m up: 1 - 0.4^(1/2) s and 1 + 0.4^(1/2) s.
_PASSES = 1.0 + np.array([-1.0, 1.0]) * np.sqrt(0.4)


def _crossings(**how: Any) -> float:
    """The largest error of the times at which the ball passes 3 m, s; NaN if there are not two, one each way."""
    crossings, backward = _thrown(_LEVEL, _GROUND, **how).crossings, "t0" in how
    assert crossings is not None
    wanted = _PASSES[::-1] if backward else _PASSES
    if crossings.count != 2 or list(crossings.directions) != [1, -1]:
        return float("nan")
    return float(np.max(np.abs(np.asarray(crossings.ts) - wanted)))


def _moved() -> float:
    """The error of the derivatives of both times with respect to the speed: 0.1 -+ 1 / 40^(1/2) s per m/s."""

    def times(speed: jax.Array) -> jax.Array:
        start = {"h": 0.0, "v": speed}
        sol = tx.integrate(_ball(), start, t1=3.0, steps=20, event=[_LEVEL, _GROUND], max_crossings=4)
        assert sol.crossings is not None
        return sol.crossings.ts[:2]

    wanted = 0.1 + np.array([-1.0, 1.0]) / np.sqrt(40.0)
    return float(np.max(np.abs(np.asarray(jax.jit(jax.jacfwd(times))(10.0)) - wanted)))


def _thrown_together() -> float:
    """The largest error of the times of three balls, under jit and vmap, s: none at 6 m/s, two at 8 and 10 m/s."""

    def crossed(speed: jax.Array) -> tuple[jax.Array, jax.Array]:
        start = {"h": 0.0, "v": speed}
        crossings = tx.integrate(_ball(), start, t1=3.0, steps=20, event=[_LEVEL, _GROUND], max_crossings=4).crossings
        assert crossings is not None
        return crossings.count, crossings.ts[:2]

    speeds = np.array([6.0, 8.0, 10.0])
    counts, ts = jax.jit(jax.vmap(crossed))(speeds)
    if list(counts) != [0, 2, 2]:
        return float("nan")
    wanted = (speeds[1:, None] + np.array([-1.0, 1.0]) * np.sqrt(speeds[1:, None] ** 2 - 60.0)) / 10.0
    return float(np.max(np.abs(np.asarray(ts)[1:] - wanted)))


def _impact(depth: float) -> float:
    """The error of the time of an impact on a sphere, shortly before a perigee below it, by Kepler's equation, s."""
    mu, radius, apogee = 3.986004418e14, 6.371e6, 4.2e7
    r, w = tx.State("r", shape=(2,)), tx.State("w", shape=(2,))
    orbit = tx.compile(tx.System(rates={r: w, w: -mu * r / tx.linalg.Norm(r) ** 3}))
    a, e = 0.5 * (apogee + radius - depth), (apogee - radius + depth) / (apogee + radius - depth)
    n, start = np.sqrt(mu / a**3), {"r": [apogee, 0.0], "w": [0.0, np.sqrt(mu * (2.0 / apogee - 1.0 / a))]}
    ground = tx.Event(tx.linalg.Norm(r) - radius, direction=False)
    sol = simulated(orbit, start, t1=2.0 * np.pi / n, rtol=1e-6, method=_METHODS["DOP853"], event=ground)
    E = -np.arccos((1.0 - radius / a) / e)
    return abs(float(sol.ts[-1]) - (E - e * np.sin(E) + np.pi) / n)


def _begun(at_start: tx.AtStart | None) -> float:
    """When the fall of a ball ends that begins at the level of the event, s."""
    return float(_thrown(tx.Event(_H, direction=False, at_start=at_start), speed=0.0).ts[-1])


def _full() -> tx.Solution:
    return _thrown(_LEVEL, max_crossings=1, dt=0.1, control=tx.StepControl(dtmax=0.2))


_LATE = between(1.0, unit="s")
_TWO_ROOTS, _TWO_EVENTS = "two roots of one condition within a step, at 0.51 and 0.53 s", ("late", "early")

EVENTS: Section = [
    "The last step is taken again up to the root, to round-off of the time.",
    _reached("in the middle of a step, at 0.55 s", 0.55, 3e-16),
    "A root between two steps belongs to one of them, and is not lost.",
    _reached("at the edge of a step, at 0.5 s", 0.5, 3e-16),
    "Round-off decides which step the root belongs to; the time is the same.",
    _reached("before the edge of a step by 2e-16 s", 0.5 - 2e-16, 5e-16),
    _reached("after the edge of a step by 2e-16 s", 0.5 + 2e-16, 5e-16),
    "Whether it counts as ended or as stopped, the time is the same.",
    quick("at the end, at 1 s", "RK4", at_most(5e-16, "s"), lambda: abs(_end("reaching", 1.0) - 1.0)),
    "A condition of any direction that is zero at the start is no event: a body that leaves the ground has not landed.",
    quick("at the start: the end", "RK4", _LATE, _end, "reaching", 0.0),
    "One that goes past zero there, in the direction of the event, is.",
    quick("a ball that begins to fall at the ground: the end", "Tsit5", at_most(0.0, "s"), _begun, None),
    "Unless it is told to wait until it has been on the other side.",
    quick("the same, at_start=AtStart.IGNORE", "Tsit5", between(3.0, unit="s"), _begun, tx.AtStart.IGNORE),
    "Of several roots in a step the first counts, whichever was named first.",
    quick("two events in one step, at 0.56 and 0.53 s", "RK4", at_most(3e-16, "s"), _miss, 0.53, *_TWO_EVENTS, which=1),
    "The sign is the same at both ends of the step; the polynomial of the step is looked at too.",
    quick(_TWO_ROOTS, "RK4", at_most(3e-15, "s"), _miss, 0.51, "product"),
    "A perigee that steps pass over, 10 km and 100 m under the ground; the rest is the tolerance.",
    quick("an impact near the perigee, 10 km deep, rtol 1e-6", "DOP853", at_most(0.1, "s"), _impact, 1e4),
    quick("an impact near the perigee, 100 m deep, rtol 1e-6", "DOP853", at_most(1.0, "s"), _impact, 100.0),
    "Events that do not end the integration are kept with their times.",
    quick("two crossings on the way", "Tsit5", at_most(1e-12, "s"), _crossings),
    "Both in the first step, of 2.5 s.",
    quick("two crossings in a step", "Tsit5", at_most(1e-12, "s"), _crossings, dt=2.5),
    "The same events, in the other order.",
    quick("two crossings backward in time", "Tsit5", at_most(1e-12, "s"), _crossings, t0=3.0, t1=-1.0),
    "Each member of a batch has crossings of its own.",
    quick("three balls under jit and vmap, of which one stays below", "RK4", at_most(1e-12, "s"), _thrown_together),
    "By the implicit function theorem.",
    quick("derivatives of their times with respect to the speed", "RK4", at_most(1e-9), _moved),
    "More crossings than there is room for end the integration; none is lost in silence.",
    quick("more crossings than max_crossings", "Tsit5", ends(tx.Result.MAX_CROSSINGS, 1.0, 2.0), _full),
    "Without a change of sign there is no event; take the derivative as the condition.",
    quick("a condition that touches zero, at 0.55 s: the end", "RK4", _LATE, _end, "touching"),
    "The root is found in the group, within the tolerance of the integration.",
    quick("a condition on an attitude, rtol 1e-11", "Tsit5", at_most(1e-10, "s"), _tilted),
]

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
def _poses() -> tuple[float, int]:
    """The largest error of a pose under the twists, whose truth is a product of exponentials; and rejected steps."""
    g, F = tx.State("g", group=tx.SE3), tx.Control("F", shape=(6,))
    table, method = tx.ZeroOrderHold(ts=_TIMES, values=_TWISTS), tx.RKMK(tx.tableaus.DOP853)
    driven = tx.compile(tx.System(rates={g: F}))
    sol = simulated(driven, {"g": np.eye(4)}, t1=_END, u={"F": table}, rtol=1e-9, method=method)
    truth = np.eye(4)
    for twist, length in zip(_TWISTS, np.diff([*_TIMES, _END]), strict=True):
        truth = truth @ np.asarray(se3.exp(jnp.asarray(length * twist)))
    return float(np.max(np.abs(np.asarray(sol.xs["g"][-1]) - truth))), sol.stats.rejected


@functools.cache
def _lag() -> tx.Dynamics:
    """x' = F - x."""
    x, F = tx.State("x"), tx.Control("F")
    return tx.compile(tx.System(rates={x: F - x}))


def _switched(u: Any, **options: Any) -> float:
    """The error at 1 s of x' = F - x from 0 for the switch at 0.4 s."""
    sol = simulated(_lag(), {"x": 0.0}, t1=1.0, u=u, **options)
    return abs(float(sol.xs["x"][-1]) - float((2.0 - np.exp(-0.4)) * np.exp(0.4 - 1.0) - 1.0))


def _returned(**options: Any) -> float:
    """How far x' = F - x is from its start after 1 s and the way back."""
    options |= {"u": _TABLE, "method": _METHODS["Tsit5" if "rtol" in options else "RK4"]}
    there = simulated(_lag(), {"x": 0.25}, t1=1.0, **options)
    back = simulated(_lag(), there.last, t0=1.0, t1=0.0, **options)
    return abs(float(back.xs["x"][-1]) - 0.25)


_chosen = functools.partial(_switched, rtol=1e-10, method=_METHODS["Tsit5"])


_switch = lambda t: {"F": jnp.where(t < 0.4, 1.0, -1.0)}  # noqa: E731
_TABLE = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4], values=[1.0, -1.0])}
_AT_ENDS = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4, 1.0], values=[1.0, -1.0, 1e9])}
_NAMED = "a function that switches at 0.4 s, named with jumps, rtol 1e-10"

JUMPS: Section = [
    "Steps end at every row of a table, also where two are 1e-9 s apart.",
    quick("five twists, rtol 1e-9", "DOP853", at_most(1e-13), lambda: _poses()[0]),
    "Nothing has to be found out by steps that fail.",
    quick("the same: steps taken back", "DOP853", at_most(0.0, "steps"), lambda: _poses()[1]),
    "A step ends at the switch.",
    quick("a table, rtol 1e-10", "Tsit5", at_most(1e-10), _chosen, _TABLE),
    "A function's jumps are not seen from outside; named, they are ends of steps.",
    quick(_NAMED, "Tsit5", at_most(1e-10), _chosen, _switch, jumps=[0.4]),
    "The error control finds the jump, at many steps taken back, and to its tolerance only.",
    quick("the same, not named", "Tsit5", at_most(1e-7), _chosen, _switch),
    "Where the switch falls between two equal steps, the order is kept.",
    quick("a table, on the edge of a step of 0.1 s", "RK4", at_most(1e-6), _switched, _TABLE, dt=0.1),
    "Equal steps are split at a switch inside of them, and the order is kept.",
    quick("a table, inside of a step of 1/6 s", "RK4", at_most(1e-5), _switched, _TABLE, dt=1.0 / 6.0),
    quick("a table, inside of a step of 1/48 s", "RK4", at_most(5e-9), _switched, _TABLE, dt=1.0 / 48.0),
    "A function's jumps are not seen from outside; named, they split steps.",
    quick("a function, inside of a step, named", "RK4", at_most(5e-9), _switched, _switch, dt=1.0 / 48.0, jumps=[0.4]),
    "The same switch from the other side.",
    quick("there and back across a table, steps of 1/48 s", "RK4", at_most(1e-8), _returned, dt=1.0 / 48.0),
    quick("there and back across a table, rtol 1e-10", "Tsit5", at_most(1e-8), _returned, rtol=1e-10),
    "What is commanded from the end on does not reach back.",
    quick("a table with a jump at the start and at the end, rtol 1e-10", "Tsit5", at_most(1e-10), _chosen, _AT_ENDS),
]
