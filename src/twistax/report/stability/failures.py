"""Flights that cannot reach their end."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...scenes import SCENES
from .row import AtMost, Ends, Refused, Row, Section, flown

__all__ = ["FAILURES"]

_DOP853 = tx.RKMK(tx.tableaus.DOP853)
_TOP = SCENES["euler-top"]


@functools.cache
def _growing() -> tx.Dynamics:
    """x' = x^2: from 1 it is infinite at 1 s."""
    x = tx.State("x")
    return tx.compile(tx.System(rates={x: x * x}))


@functools.cache
def _falling() -> tx.Dynamics:
    """x' = -1/x: from 1 it is 0, with an infinite rate, at 1/2 s."""
    x = tx.State("x")
    return tx.compile(tx.System(rates={x: -1.0 / x}))


@functools.cache
def _spinning_up() -> tx.Dynamics:
    """A body that a torque turns faster and faster: w' = w^2 about z."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w")
    return tx.compile(tx.System(rates={R: tx.Concat(0.0, 0.0, w), w: w * w}))


@functools.cache
def _driven() -> tx.Dynamics:
    x, F = tx.State("x"), tx.Control("F")
    return tx.compile(tx.System(rates={x: F - x}))


def _spoiled(t: Any) -> dict[str, Any]:
    """A control that stops being a number at 0.7 s."""
    return {"F": jnp.where(t < 0.7, 1.0, jnp.nan)}


def _ends(dynamics: Any, start: dict[str, Any], t1: float, **options: Any) -> Any:
    return lambda: flown(dynamics(), start, t1=t1, **options)


def _message(dynamics: Any, start: dict[str, Any], t1: float, **options: Any) -> Any:
    return lambda: tx.integrate(dynamics(), start, t1=t1, **options)


def _kept() -> float:
    """The part before a failure is kept, and right: the largest error of 1 / (1 - t) at the times that were reached."""
    ts = np.linspace(0.0, 2.0, 21)
    sol = tx.integrate(_growing(), {"x": 1.0}, t1=2.0, rtol=1e-10, save_at=ts, throw=False)
    reached = np.asarray(sol.ts)
    if sol.result is tx.Result.SUCCESS or len(reached) != 10:
        return float("nan")
    return float(np.max(np.abs(np.asarray(sol.xs["x"]) * (1.0 - reached) - 1.0)))


FAILURES = Section(
    "failures",
    "Flights that cannot arrive",
    "Each ends by name and at a time, with `throw=False` as a `tx.Result`; without, as an error whose message names "
    "time, state, cause and remedy.",
    (
        Row(
            "x' = x^2 from 1, beyond its pole at 1 s, rtol 1e-9",
            "Tsit5",
            _ends(_growing, {"x": 1.0}, 2.0, rtol=1e-9),
            Ends(tx.Result.STEP_TOO_SMALL, 0.999, 1.001),
            "Steps shrink towards the pole until the clock does not move any more.",
        ),
        Row(
            "x' = x^2 from 1, steps of 0.01 s",
            "RK4",
            _ends(_growing, {"x": 1.0}, 2.0, dt=0.01),
            Ends(tx.Result.NON_FINITE, 1.0, 1.2),
            "Equal steps jump over the pole and overflow a few steps later; the time is that of the overflow.",
        ),
        Row(
            "x' = -1/x from 1, beyond its singularity at 0.5 s, rtol 1e-9",
            "Tsit5",
            _ends(_falling, {"x": 1.0}, 1.0, rtol=1e-9),
            Ends(tx.Result.STEP_TOO_SMALL, 0.499, 0.501),
            "No step reaches an infinite rate within the tolerance.",
        ),
        Row(
            "a body spun up to infinity at 1 s, rtol 1e-9",
            "DOP853",
            _ends(_spinning_up, {"R": np.eye(3), "w": 1.0}, 2.0, rtol=1e-9, method=_DOP853),
            Ends(tx.Result.STEP_TOO_SMALL, 0.999, 1.001),
            "The rotation stays in its group until the rate is lost.",
        ),
        Row(
            "the part before the pole is kept",
            "Tsit5",
            _kept,
            AtMost(1e-7),
            "With throw=False the saved times before the failure come back, and no others.",
        ),
        Row(
            "steps of at least 0.5 s (dtmin), rtol 1e-9",
            "Tsit5",
            _ends(lambda: _TOP.dynamics, dict(_TOP.start), 20.0, rtol=1e-9, control=tx.StepControl(dtmin=0.5)),
            Ends(tx.Result.STEP_TOO_SMALL, 0.0, 20.0),
            "A flight whose tolerance asks for shorter steps than dtmin ends.",
        ),
        Row(
            "ten steps (max_steps), rtol 1e-9",
            "Tsit5",
            _ends(lambda: _TOP.dynamics, dict(_TOP.start), 20.0, rtol=1e-9, control=tx.StepControl(max_steps=10)),
            Ends(tx.Result.MAX_STEPS, 0.0, 20.0),
            "The flight ends where the steps ran out.",
        ),
        Row(
            "a control stops being a number at 0.7 s, steps of 0.1 s",
            "RK4",
            _message(_driven, {"x": 0.0}, 2.0, dt=0.1, u=_spoiled),
            Refused(tx.IntegrationError, "'x' became infinite or NaN in the step from t = 0.6"),
            "The message names state and time, and its next lines the control.",
        ),
        Row(
            "a control stops being a number at 0.7 s, rtol 1e-6",
            "Tsit5",
            _ends(_driven, {"x": 0.0}, 2.0, rtol=1e-6, u=_spoiled),
            Ends(tx.Result.NON_FINITE, 0.69, 0.71),
            "Steps shrink up to the last time at which the control is a number.",
        ),
        Row(
            "no estimate of the error",
            "RK4",
            _message(_growing, {"x": 1.0}, 0.5, rtol=1e-6, method=tx.RKMK(tx.tableaus.RK4)),
            Refused(tx.ModelError, "cannot choose its own steps"),
            "A method without an estimate of its error says so, and how to go on.",
        ),
    ),
)
