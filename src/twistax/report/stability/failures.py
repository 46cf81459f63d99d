"""Integrations that cannot reach their end, and input that is refused before the first step."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import SCENES
from ..checks import Check, Ends, Refused, Section, at_most, simulated

__all__ = ["FAILURES", "INPUTS"]

_DOP853, _RK4, _TSIT5 = (tx.RKMK(tableau) for tableau in (tx.tableaus.DOP853, tx.tableaus.RK4, tx.tableaus.TSIT5))
_TOP = SCENES["euler-top"]
_NAN, _INF = float("nan"), float("inf")


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


def _spoiled(t: Any) -> dict[str, Any]:
    """A control that is NaN from 0.7 s on."""
    return {"F": jnp.where(t < 0.7, 1.0, jnp.nan)}


def _ends(name: str, start: dict[str, Any], t1: float, **options: Any) -> Callable[[], Any]:
    steps = options if "dt" in options else {"method": _TSIT5} | options
    return lambda: simulated(_system(name), start, t1=t1, **steps)


def _raises(name: str, start: dict[str, Any], t1: float, **options: Any) -> Callable[[], Any]:
    return lambda: tx.integrate(_system(name), start, t1=t1, **options)


def _of_top(**control: Any) -> Callable[[], Any]:
    options: dict[str, Any] = {"rtol": 1e-9, "method": _TSIT5, "control": tx.StepControl(**control)}
    return lambda: simulated(_TOP.dynamics, dict(_TOP.start), t1=20.0, **options)


def _kept() -> float:
    """The largest error of 1 / (1 - t) at the saved times that were reached; NaN if those are not what they should."""
    ts = np.linspace(0.05, 1.95, 20)
    sol = tx.integrate(_system("growing"), {"x": 1.0}, t1=2.0, rtol=1e-10, method=_TSIT5, save_at=ts, throw=False)
    reached = np.asarray(sol.ts)
    if sol.result is tx.Result.SUCCESS or len(reached) != 10:
        return _NAN
    return float(np.max(np.abs(np.asarray(sol.xs["x"]) * (1.0 - reached) - 1.0)))


_ONE, _AT_REST, _STILL = {"x": 1.0}, {"x": 0.0}, {"R": np.eye(3), "w": 1.0}
_SMALL, _LOST, _LATE = tx.Result.STEP_TOO_SMALL, tx.Result.NON_FINITE, tx.Result.MAX_STEPS

FAILURES = Section(
    "failures",
    "Integrations that cannot arrive",
    "Each ends by name and at a time, with `throw=False` as a `tx.Result`; without, as an error whose message names "
    "time, state, cause and remedy.",
    {
        "Steps shrink towards the pole until the clock does not move any more.": [
            Check(
                "x' = x^2 from 1, beyond its pole at 1 s, rtol 1e-9",
                "Tsit5",
                _ends("growing", _ONE, 2.0, rtol=1e-9),
                Ends(_SMALL, 0.999, 1.001),
            ),
        ],
        "Equal steps jump over the pole and overflow a few steps later; the time is that of the overflow.": [
            Check(
                "x' = x^2 from 1, steps of 0.01 s",
                "RK4",
                _ends("growing", _ONE, 2.0, dt=0.01),
                Ends(_LOST, 1.0, 1.2),
            ),
        ],
        "No step reaches an infinite rate within the tolerance.": [
            Check(
                "x' = -1/x from 1, beyond its singularity at 0.5 s, rtol 1e-9",
                "Tsit5",
                _ends("falling", _ONE, 1.0, rtol=1e-9),
                Ends(_SMALL, 0.499, 0.501),
            ),
        ],
        "The rotation stays in its group until the rate is lost.": [
            Check(
                "a body spun up to infinity at 1 s, rtol 1e-9",
                "DOP853",
                _ends("spinning up", _STILL, 2.0, rtol=1e-9, method=_DOP853),
                Ends(_SMALL, 0.999, 1.001),
            ),
        ],
        "With throw=False the saved times before the failure come back, and no others.": [
            Check("the part before the pole is kept", "Tsit5", _kept, at_most(1e-7)),
        ],
        "An integration whose tolerance asks for shorter steps than dtmin ends.": [
            Check("steps of at least 0.5 s (dtmin), rtol 1e-9", "Tsit5", _of_top(dtmin=0.5), Ends(_SMALL, 0.0, 20.0)),
        ],
        "It ends where the steps ran out.": [
            Check("ten steps (max_steps), rtol 1e-9", "Tsit5", _of_top(max_steps=10), Ends(_LATE, 0.0, 20.0)),
        ],
        "The message names state and time, and its next lines the control.": [
            Check(
                "a control is NaN from 0.7 s on, steps of 0.1 s",
                "RK4",
                _raises("driven", _AT_REST, 2.0, dt=0.1, u=_spoiled),
                Refused(tx.IntegrationError, "'x' became infinite or NaN in the step from t = 0.6"),
            ),
        ],
        "Steps shrink up to the last time at which the control is a number.": [
            Check(
                "a control is NaN from 0.7 s on, rtol 1e-6",
                "Tsit5",
                _ends("driven", _AT_REST, 2.0, rtol=1e-6, u=_spoiled),
                Ends(_LOST, 0.69, 0.71),
            ),
        ],
        "A method without an estimate of its error says so, and how to go on.": [
            Check(
                "no estimate of the error",
                "RK4",
                _raises("growing", _ONE, 0.5, rtol=1e-6, method=_RK4),
                Refused(tx.ModelError, "cannot choose its own steps"),
            ),
        ],
    },
)


# ---- input ----------------------------------------------------------------------------------------------------------


@functools.cache
def _thing() -> tx.Dynamics:
    """A pose pushed by a control, with a mass."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, m = tx.Control("F", shape=(6,)), tx.Parameter("m")
    return tx.compile(tx.System(rates={g: V, V: F / m}))


def _given(
    pose: Any = None, V: float = 1.0, F: float = 0.0, m: float = 1.0, t1: float = 1.0, **steps: Any
) -> Callable[[], tx.Solution]:
    start = {"g": np.eye(4) if pose is None else pose, "V": np.full(6, V)}
    return lambda: simulated(_thing(), start, u={"F": np.full(6, F)}, params={"m": m}, t1=t1, **(steps or {"dt": 0.1}))


def _pose(rotation: Any, last_row: float = 0.0) -> Any:
    pose = np.eye(4)
    pose[:3, :3], pose[3, 0] = rotation, last_row
    return pose


_REFLECTION, _SHEARED = np.diag([1.0, 1.0, -1.0]), np.eye(3) + 1e-3 * np.eye(3, k=1)

INPUTS = Section(
    "inputs",
    "Input that makes no sense",
    "Each is refused before the first step, with an error whose first line says what is wrong.",
    {
        why: [Check(what, "tx.integrate", measure, Refused(tx.InputError, words)) for what, measure, words in cases]
        for why, cases in {
            "NaN and infinity are refused where they enter, by name.": (
                ("a velocity at the start is NaN", _given(V=_NAN), "x0['V'] is not finite"),
                ("a velocity at the start is infinite", _given(V=_INF), "x0['V'] is not finite"),
                ("a control is NaN", _given(F=_NAN), "u['F'] is not finite"),
                ("a parameter is infinite", _given(m=_INF), "params['m'] is not finite"),
                ("a pose is NaN", _given(np.full((4, 4), _NAN)), "x0['g'] is not finite"),
                ("the end is NaN", _given(t1=_NAN), "t1"),
                ("a tolerance is NaN", _given(rtol=_NAN), "rtol"),
            ),
            "Integration goes forward in time.": (("the end lies before the start", _given(t1=-1.0), "t1"),),
            "A step of zero never arrives.": (("a step of zero", _given(dt=0.0), "dt"),),
            "What is no rotation is refused with its distance from one; it is never put right in silence.": (
                ("a reflection", _given(_pose(_REFLECTION)), "is no element of SE3"),
                ("a rotation times 1.001", _given(_pose(1.001 * np.eye(3))), "is no element of SE3"),
                ("a sheared rotation", _given(_pose(_SHEARED)), "is no element"),
                ("a pose with another last row", _given(_pose(np.eye(3), 1e-3)), "is no element of SE3"),
            ),
        }.items()
    },
)
