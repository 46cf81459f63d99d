"""Integrations that cannot reach their end, and invalid input."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import SCENES
from ...scenes.scene import placed
from ..harness.expected import Expected, at_most, ends, refused, simulated
from ..harness.measurement import MeasuredCase, Section, quick

_METHODS = {"DOP853": tx.RKMK(tx.tableaus.DOP853), "RK4": tx.RKMK(tx.tableaus.RK4), "Tsit5": tx.RKMK(tx.tableaus.TSIT5)}
_NAN, _INF = float("nan"), float("inf")
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
) -> MeasuredCase:
    """An integration from 1, of the lag from 0. With `raised` the error of `tx.integrate` is what counts."""
    start = {"R": np.eye(3), "w": 1.0} if name == "spinning up" else {"x": 0.0 if name == "driven" else 1.0}
    run = tx.integrate if raised else simulated
    return quick(what, by, expected, lambda: run(_system(name), start, t1=t1, method=_METHODS[by], **how))


def _of_top(what: str, result: tx.Result, **control: Any) -> MeasuredCase:
    options: dict[str, Any] = {"rtol": 1e-9, "method": _METHODS["Tsit5"], "control": tx.StepControl(**control)}
    measure = lambda: simulated(_TOP.dynamics, _TOP.start, t1=20.0, **options)  # noqa: E731
    return quick(what, "Tsit5", ends(result, 0.0, 20.0), measure)


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
    quick("the part before the pole is kept", "Tsit5", at_most(1e-7), _kept),
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
def _pushed_body() -> tx.Dynamics:
    """A pose pushed by a control, with a mass."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, m = tx.Control("F", shape=(6,)), tx.Parameter("m")
    return tx.compile(tx.System(rates={g: V, V: F / m}))


def _refused(
    what: str, words: str, g: Any = None, V: float = 1.0, F: float = 0.0, m: float = 1.0, **how: Any
) -> MeasuredCase:
    """An integration of a pose with one wrong input, which is refused with these words."""
    start = {"g": np.eye(4) if g is None else g, "V": np.full(6, V)}
    how = {"t1": 1.0, "u": {"F": np.full(6, F)}, "params": {"m": m}} | (how if "rtol" in how else {"dt": 0.1} | how)
    return quick(what, "tx.integrate", refused(tx.InputError, words), lambda: simulated(_pushed_body(), start, **how))


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
    _refused("a reflection", "is not an element of SE3", g=placed(_REFLECTION, 0.0)),
    _refused("a rotation times 1.001", "is not an element of SE3", g=placed(1.001 * np.eye(3), 0.0)),
    _refused("a sheared rotation", "is not an element", g=placed(_SHEARED, 0.0)),
    _refused("a pose with another last row", "is not an element of SE3", g=np.eye(4) + 1e-3 * np.eye(4, k=-3)),
]
