"""Events and jumps at the edges of steps, integrations that cannot reach their end, and input that is refused."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import se3
from ...scenes import SCENES
from ...scenes.scene import placed
from ..checks import Check, Expected, Section, at_most, between, ends, refused, simulated

_METHODS = {"DOP853": tx.RKMK(tx.tableaus.DOP853), "RK4": tx.RKMK(tx.tableaus.RK4), "Tsit5": tx.RKMK(tx.tableaus.TSIT5)}
_NAN, _INF = float("nan"), float("inf")


@functools.cache
def _clock() -> tuple[tx.Dynamics, dict[str, tx.Event]]:
    """x' = 1 from 0, so that x is the time, and events: x reaches `at`; passes 0.51 and 0.53; touches 0.55; .."""
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
    """How far from a time it ended, s; NaN if it was not that event that ended it."""
    sol = _ended(*names, **how)
    found = sol.result is tx.Result.EVENT and sol.event == which
    return abs(float(sol.ts[-1]) - wanted) if found else float("nan")


def _reached(what: str, at: float, bar: float) -> Check:
    return Check(what, "RK4", at_most(bar, "s"), _miss, at, "reaching", at=at)


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
    """A ball that is thrown."""
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
    found, backward = _thrown(_LEVEL, _GROUND, **how).crossings, "t0" in how
    assert found is not None
    wanted = _PASSES[::-1] if backward else _PASSES
    if found.count != 2 or list(found.directions) != [1, -1]:
        return _NAN
    return float(np.max(np.abs(np.asarray(found.ts) - wanted)))


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
        found = tx.integrate(_ball(), start, t1=3.0, steps=20, event=[_LEVEL, _GROUND], max_crossings=4).crossings
        assert found is not None
        return found.count, found.ts[:2]

    speeds = np.array([6.0, 8.0, 10.0])
    counts, ts = jax.jit(jax.vmap(crossed))(speeds)
    if list(counts) != [0, 2, 2]:
        return _NAN
    wanted = (speeds[1:, None] + np.array([-1.0, 1.0]) * np.sqrt(speeds[1:, None] ** 2 - 60.0)) / 10.0
    return float(np.max(np.abs(np.asarray(ts)[1:] - wanted)))


def _impact(depth: float) -> float:
    """By how many s an impact on a sphere, shortly before a perigee under it, is missed: by Kepler's equation."""
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
    """When a ball that falls from the level that ends its fall is stopped, s."""
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
    Check("at the end, at 1 s", "RK4", at_most(5e-16, "s"), lambda: abs(_end("reaching", 1.0) - 1.0)),
    "A condition of any direction that is zero at the start is no event: a body that leaves the ground has not landed.",
    Check("at the start: the end", "RK4", _LATE, _end, "reaching", 0.0),
    "One that goes past zero there, in the direction of the event, is.",
    Check("a ball that begins to fall at the ground: the end", "Tsit5", at_most(0.0, "s"), _begun, None),
    "Unless it is told to wait until it has been on the other side.",
    Check("the same, at_start=AtStart.IGNORE", "Tsit5", between(3.0, unit="s"), _begun, tx.AtStart.IGNORE),
    "Of several roots in a step the first counts, whichever was named first.",
    Check("two events in one step, at 0.56 and 0.53 s", "RK4", at_most(3e-16, "s"), _miss, 0.53, *_TWO_EVENTS, which=1),
    "The sign is the same at both ends of the step; the polynomial of the step is looked at too.",
    Check(_TWO_ROOTS, "RK4", at_most(3e-15, "s"), _miss, 0.51, "product"),
    "A perigee that steps pass over, 10 km and 100 m under the ground; the rest is the tolerance.",
    Check("an impact near the perigee, 10 km deep, rtol 1e-6", "DOP853", at_most(0.1, "s"), _impact, 1e4),
    Check("an impact near the perigee, 100 m deep, rtol 1e-6", "DOP853", at_most(1.0, "s"), _impact, 100.0),
    "Events that do not end the integration are kept with their times.",
    Check("two crossings on the way", "Tsit5", at_most(1e-12, "s"), _crossings),
    "Both in the first step, of 2.5 s.",
    Check("two crossings in a step", "Tsit5", at_most(1e-12, "s"), _crossings, dt=2.5),
    "The same events, in the other order.",
    Check("two crossings backward in time", "Tsit5", at_most(1e-12, "s"), _crossings, t0=3.0, t1=-1.0),
    "Each member of a batch has crossings of its own.",
    Check("three balls under jit and vmap, of which one stays below", "RK4", at_most(1e-12, "s"), _thrown_together),
    "By the implicit function theorem.",
    Check("derivatives of their times with respect to the speed", "RK4", at_most(1e-9), _moved),
    "More crossings than there is room for end the integration; none is lost in silence.",
    Check("more crossings than max_crossings", "Tsit5", ends(tx.Result.MAX_CROSSINGS, 1.0, 2.0), _full),
    "Without a change of sign there is no event; take the derivative as the condition.",
    Check("a condition that touches zero, at 0.55 s: the end", "RK4", _LATE, _end, "touching"),
    "The root is found in the group, within the tolerance of the integration.",
    Check("a condition on an attitude, rtol 1e-11", "Tsit5", at_most(1e-10, "s"), _tilted),
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
    """The largest error of a pose that follows the twist, and the steps taken back: a product of exponentials."""
    g, F = tx.State("g", group=tx.SE3), tx.Control("F", shape=(6,))
    table, method = tx.ZeroOrderHold(ts=_TIMES, values=_TWISTS), tx.RKMK(tx.tableaus.DOP853)
    driven = tx.compile(tx.System(rates={g: F}))
    sol = simulated(driven, {"g": np.eye(4)}, t1=_END, u={"F": table}, rtol=1e-9, method=method)
    truth = np.eye(4)
    for twist, length in zip(_TWISTS, np.diff([*_TIMES, _END]), strict=True):
        truth = truth @ np.asarray(se3.exp(jnp.asarray(length * twist)))
    return float(np.max(np.abs(np.asarray(sol.xs["g"][-1]) - truth))), sol.stats.rejected


def _switched(u: Any, **options: Any) -> float:
    """The error at 1 s of x' = F - x from 0 for the switch at 0.4 s."""
    sol = simulated(_system("driven"), {"x": 0.0}, t1=1.0, u=u, **options)
    return abs(float(sol.xs["x"][-1]) - float((2.0 - np.exp(-0.4)) * np.exp(0.4 - 1.0) - 1.0))


def _returned(**options: Any) -> float:
    """How far x' = F - x is from its start after 1 s and the way back."""
    options |= {"u": _TABLE, "method": _METHODS["Tsit5" if "rtol" in options else "RK4"]}
    there = simulated(_system("driven"), {"x": 0.25}, t1=1.0, **options)
    back = simulated(_system("driven"), there.last, t0=1.0, t1=0.0, **options)
    return abs(float(back.xs["x"][-1]) - 0.25)


_chosen = functools.partial(_switched, rtol=1e-10, method=_METHODS["Tsit5"])


_switch = lambda t: {"F": jnp.where(t < 0.4, 1.0, -1.0)}  # noqa: E731
_TABLE = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4], values=[1.0, -1.0])}
_AT_ENDS = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4, 1.0], values=[1.0, -1.0, 1e9])}
_NAMED = "a function that switches at 0.4 s, named with jumps, rtol 1e-10"

JUMPS: Section = [
    "Steps end at every row of a table, also where two are 1e-9 s apart.",
    Check("five twists, rtol 1e-9", "DOP853", at_most(1e-13), lambda: _poses()[0]),
    "Nothing has to be found out by steps that fail.",
    Check("the same: steps taken back", "DOP853", at_most(0.0, "steps"), lambda: _poses()[1]),
    "A step ends at the switch.",
    Check("a table, rtol 1e-10", "Tsit5", at_most(1e-10), _chosen, _TABLE),
    "A function's jumps are not seen from outside; named, they are ends of steps.",
    Check(_NAMED, "Tsit5", at_most(1e-10), _chosen, _switch, jumps=[0.4]),
    "The error control finds the jump, at many steps taken back, and to its tolerance only.",
    Check("the same, not named", "Tsit5", at_most(1e-7), _chosen, _switch),
    "Where the switch falls between two equal steps, the order is kept.",
    Check("a table, on the edge of a step of 0.1 s", "RK4", at_most(1e-6), _switched, _TABLE, dt=0.1),
    "Equal steps are split at a switch inside of them, and the order is kept.",
    Check("a table, inside of a step of 1/6 s", "RK4", at_most(1e-5), _switched, _TABLE, dt=1.0 / 6.0),
    Check("a table, inside of a step of 1/48 s", "RK4", at_most(5e-9), _switched, _TABLE, dt=1.0 / 48.0),
    "A function's jumps are not seen from outside; named, they split steps.",
    Check("a function, inside of a step, named", "RK4", at_most(5e-9), _switched, _switch, dt=1.0 / 48.0, jumps=[0.4]),
    "The same switch from the other side.",
    Check("there and back across a table, steps of 1/48 s", "RK4", at_most(1e-8), _returned, dt=1.0 / 48.0),
    Check("there and back across a table, rtol 1e-10", "Tsit5", at_most(1e-8), _returned, rtol=1e-10),
    "What is commanded from the end on does not reach back.",
    Check("a table with a jump at the start and at the end, rtol 1e-10", "Tsit5", at_most(1e-10), _chosen, _AT_ENDS),
]

_TOP = SCENES["euler-top"]


@functools.cache
def _system(name: str) -> tx.Dynamics:
    """x' = x^2, infinite at 1 s from 1; x' = -1/x, 0 at 1/2 s; a body spun up by w' = w^2; a lag with a command."""
    x, F, R, w = tx.State("x"), tx.Control("F"), tx.State("R", group=tx.SO3), tx.State("w")
    rates: dict[str, dict[Any, Any]] = {
        "growing": {x: x * x},
        "falling": {x: -1.0 / x},
        "spinning up": {R: tx.Concat(0.0, 0.0, w), w: w * w},
        "driven": {x: F - x},
    }
    return tx.compile(tx.System(rates=rates[name]))


_spoiled = lambda t: {"F": jnp.where(t < 0.7, 1.0, jnp.nan)}  # noqa: E731


def _case(
    what: str, by: str, name: str, expected: Expected, t1: float = 2.0, raised: bool = False, **how: Any
) -> Check:
    """From 1; the lag from 0. What `tx.integrate` itself raises counts if that is asked for."""
    start = {"R": np.eye(3), "w": 1.0} if name == "spinning up" else {"x": 0.0 if name == "driven" else 1.0}
    run = tx.integrate if raised else simulated
    return Check(what, by, expected, lambda: run(_system(name), start, t1=t1, method=_METHODS[by], **how))


def _of_top(what: str, result: tx.Result, **control: Any) -> Check:
    options: dict[str, Any] = {"rtol": 1e-9, "method": _METHODS["Tsit5"], "control": tx.StepControl(**control)}
    measure = lambda: simulated(_TOP.dynamics, _TOP.start, t1=20.0, **options)  # noqa: E731
    return Check(what, "Tsit5", ends(result, 0.0, 20.0), measure)


def _kept() -> float:
    """The largest error of 1 / (1 - t) at the saved times that were reached; NaN if those are not what they should."""
    ts, dynamics = np.linspace(0.05, 1.95, 20), _system("growing")
    sol = tx.integrate(dynamics, {"x": 1.0}, t1=2.0, rtol=1e-10, method=_METHODS["Tsit5"], save_at=ts, throw=False)
    reached = np.asarray(sol.ts)
    if sol.result is tx.Result.SUCCESS or len(reached) != 10:
        return _NAN
    return float(np.max(np.abs(np.asarray(sol.xs["x"]) * (1.0 - reached) - 1.0)))


_SMALL, _LOST, _OUT = tx.Result.STEP_TOO_SMALL, tx.Result.NON_FINITE, tx.Result.MAX_STEPS
_HALFWAY, _AT_POLE, _AT_NAN = ends(_SMALL, 0.499, 0.501), ends(_SMALL, 0.999, 1.001), ends(_LOST, 0.69, 0.71)
_SAID = refused(tx.IntegrationError, "'x' became infinite or NaN in the step from t = 0.6")
_NO_ESTIMATE = refused(tx.ModelError, "cannot choose its own steps")
_SINGULAR, _SPOILT = "x' = -1/x from 1, beyond its singularity at 0.5 s, rtol 1e-9", "a control is NaN from 0.7 s on"

FAILURES: Section = [
    "Steps shrink towards the pole until the clock does not move any more.",
    _case("x' = x^2 from 1, beyond its pole at 1 s, rtol 1e-9", "Tsit5", "growing", _AT_POLE, rtol=1e-9),
    "Equal steps jump over the pole and overflow a few steps later; the time is that of the overflow.",
    _case("x' = x^2 from 1, steps of 0.01 s", "RK4", "growing", ends(_LOST, 1.0, 1.2), dt=0.01),
    "No step reaches an infinite rate within the tolerance.",
    _case(_SINGULAR, "Tsit5", "falling", _HALFWAY, 1.0, rtol=1e-9),
    "The rotation stays in its group until the rate is lost.",
    _case("a body spun up to infinity at 1 s, rtol 1e-9", "DOP853", "spinning up", _AT_POLE, rtol=1e-9),
    "With throw=False the saved times before the failure come back, and no others.",
    Check("the part before the pole is kept", "Tsit5", at_most(1e-7), _kept),
    "An integration whose tolerance asks for shorter steps than dtmin ends.",
    _of_top("steps of at least 0.5 s (dtmin), rtol 1e-9", _SMALL, dtmin=0.5),
    "It ends where the steps ran out.",
    _of_top("ten steps (max_steps), rtol 1e-9", _OUT, max_steps=10),
    "The message names state and time, and its next lines the control.",
    _case(f"{_SPOILT}, steps of 0.1 s", "RK4", "driven", _SAID, raised=True, dt=0.1, u=_spoiled),
    "Steps shrink up to the last time at which the control is finite.",
    _case(f"{_SPOILT}, rtol 1e-6", "Tsit5", "driven", _AT_NAN, rtol=1e-6, u=_spoiled),
    "A method without an estimate of its error says so, and how to go on.",
    _case("no estimate of the error", "RK4", "growing", _NO_ESTIMATE, raised=True, rtol=1e-6),
]


@functools.cache
def _thing() -> tx.Dynamics:
    """A pose pushed by a control, with a mass."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, m = tx.Control("F", shape=(6,)), tx.Parameter("m")
    return tx.compile(tx.System(rates={g: V, V: F / m}))


def _refused(what: str, words: str, g: Any = None, V: float = 1.0, F: float = 0.0, m: float = 1.0, **how: Any) -> Check:
    """Of a pose at rest that nothing pushes, but for what is given."""
    start = {"g": np.eye(4) if g is None else g, "V": np.full(6, V)}
    how = {"t1": 1.0, "u": {"F": np.full(6, F)}, "params": {"m": m}} | (how if "rtol" in how else {"dt": 0.1} | how)
    return Check(what, "tx.integrate", refused(tx.InputError, words), lambda: simulated(_thing(), start, **how))


_REFLECTION, _SHEARED = np.diag([1.0, 1.0, -1.0]), np.eye(3) + 1e-3 * np.eye(3, k=1)

INPUTS: Section = [
    "NaN and infinity are refused where they enter, by name.",
    _refused("a velocity at the start is NaN", "x0['V'] expects finite numbers", V=_NAN),
    _refused("a velocity at the start is infinite", "x0['V'] expects finite numbers", V=_INF),
    _refused("a control is NaN", "u['F'] expects finite numbers", F=_NAN),
    _refused("a parameter is infinite", "params['m'] expects finite numbers", m=_INF),
    _refused("a pose is NaN", "x0['g'] expects finite numbers", g=np.full((4, 4), _NAN)),
    _refused("the end is NaN", "t1", t1=_NAN),
    _refused("a tolerance is NaN", "rtol", rtol=_NAN),
    "A step of zero never arrives.",
    _refused("a step of zero", "dt", dt=0.0),
    "What is no rotation is refused with its distance from one; it is never put right in silence.",
    _refused("a reflection", "is no element of SE3", g=placed(_REFLECTION, 0.0)),
    _refused("a rotation times 1.001", "is no element of SE3", g=placed(1.001 * np.eye(3), 0.0)),
    _refused("a sheared rotation", "is no element", g=placed(_SHEARED, 0.0)),
    _refused("a pose with another last row", "is no element of SE3", g=np.eye(4) + 1e-3 * np.eye(4, k=-3)),
]
