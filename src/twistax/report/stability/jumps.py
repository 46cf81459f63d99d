"""Controls that jump."""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import se3
from .row import AtMost, Row, Section, flown

__all__ = ["JUMPS"]

_DOP853 = tx.RKMK(tx.tableaus.DOP853)
#: A twist that is held between jumps: times, s, and twists.
_TIMES = np.array([0.0, 0.3, 0.7, 0.7 + 1e-9, 1.6])
_TWISTS = np.array(
    [
        [1.0, 0.0, 0.0, 0.3, 2.0, 0.0],
        [0.0, -3.0, 0.0, -1.0, 0.0, 0.5],
        [1e6, 0.0, 0.0, 0.0, 0.0, 1e6],
        [0.5, 0.5, 0.5, 0.0, 0.0, -2.0],
        [0.0, 0.0, 1.0, 1.0, 1.0, 1.0],
    ]
)
_END = 2.0


@functools.cache
def _pose() -> tx.Dynamics:
    g, xi = tx.State("g", group=tx.SE3), tx.Control("xi", shape=(6,))
    return tx.compile(tx.System(rates={g: xi}))


@functools.cache
def _lag() -> tx.Dynamics:
    x, F = tx.State("x"), tx.Control("F")
    return tx.compile(tx.System(rates={x: F - x}))


def _poses(**options: Any) -> tuple[float, tx.Solution]:
    """The largest error of the pose, and the flight: the truth is a product of exponentials."""
    sol = flown(_pose(), {"g": np.eye(4)}, t1=_END, u={"xi": tx.ZeroOrderHold(ts=_TIMES, values=_TWISTS)}, **options)
    truth = np.eye(4)
    for twist, length in zip(_TWISTS, np.diff([*_TIMES, _END]), strict=True):
        truth = truth @ np.asarray(se3.exp(jnp.asarray(length * twist)))
    return float(np.max(np.abs(np.asarray(sol.xs["g"][-1]) - truth))), sol


def _switch(t: Any) -> dict[str, Any]:
    return {"F": jnp.where(t < 0.4, 1.0, -1.0)}


def _lagged(t: float) -> float:
    """The truth of x' = F - x from 0 for the switch at 0.4 s."""
    at_switch = 1.0 - np.exp(-0.4)
    return float((at_switch + 1.0) * np.exp(0.4 - t) - 1.0)


def _switched(u: Any, **options: Any) -> tuple[float, tx.Solution]:
    sol = flown(_lag(), {"x": 0.0}, t1=1.0, u=u, **options)
    return abs(float(sol.xs["x"][-1]) - _lagged(1.0)), sol


_TABLE = {"F": tx.ZeroOrderHold(ts=[0.0, 0.4], values=[1.0, -1.0])}

JUMPS = Section(
    "jumps",
    "Controls that jump",
    "A pose whose twist is held between jumps, one of them a kick of 1e6 for 1e-9 s: the truth is a product of "
    "exponentials. A first-order lag whose command switches at 0.4 s.",
    (
        Row(
            "a table of five twists, rtol 1e-9",
            "DOP853",
            lambda: _poses(rtol=1e-9, method=_DOP853)[0],
            AtMost(1e-13),
            "Steps end at every row of a table, also where two are 1e-9 s apart.",
        ),
        Row(
            "the same: steps taken back",
            "DOP853",
            lambda: _poses(rtol=1e-9, method=_DOP853)[1].stats.rejected,
            AtMost(0.0, "steps"),
            "Nothing has to be found out by steps that fail.",
        ),
        Row(
            "a table that switches at 0.4 s, rtol 1e-10",
            "Tsit5",
            lambda: _switched(_TABLE, rtol=1e-10)[0],
            AtMost(1e-10),
            "A step ends at the switch.",
        ),
        Row(
            "a function that switches at 0.4 s, named with jumps, rtol 1e-10",
            "Tsit5",
            lambda: _switched(_switch, rtol=1e-10, jumps=[0.4])[0],
            AtMost(1e-10),
            "A function's jumps are not seen from outside; named, they are ends of steps.",
        ),
        Row(
            "the same, not named",
            "Tsit5",
            lambda: _switched(_switch, rtol=1e-10)[0],
            AtMost(1e-7),
            "The error control finds the jump, at many steps taken back, and to its tolerance only.",
        ),
        Row(
            "a table that switches on the edge of a step, steps of 0.1 s",
            "RK4",
            lambda: _switched(_TABLE, dt=0.1)[0],
            AtMost(1e-6),
            "Where the switch falls between two equal steps, the order is kept.",
        ),
        Row(
            "a table that switches inside of a step, steps of 1/6 s",
            "RK4",
            lambda: _switched(_TABLE, dt=1.0 / 6.0)[0],
            AtMost(0.3),
            "Equal steps do not see a switch inside of them: the order is lost.",
        ),
        Row(
            "a table with a jump at the start and at the end, rtol 1e-10",
            "Tsit5",
            lambda: _switched({"F": tx.ZeroOrderHold(ts=[0.0, 0.4, 1.0], values=[1.0, -1.0, 1e9])}, rtol=1e-10)[0],
            AtMost(1e-10),
            "What is commanded from the end on does not reach back.",
        ),
    ),
)
