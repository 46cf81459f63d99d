"""Single precision."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import so3
from ...scenes import SCENES
from ..accuracy_of_maps import BAR, MAPS, Map, twists, worst_units
from .row import AtMost, Refused, Row, Section, flown

__all__ = ["PRECISION"]

_TOP = SCENES["euler-top"]
_EPS = float(np.finfo(np.float32).eps)
_DOP853 = tx.RKMK(tx.tableaus.DOP853)


def _single(scene: Any) -> dict[str, Any]:
    return {name: np.asarray(value, np.float32) for name, value in scene.start.items()}


def _flight(**steps: Any) -> float:
    """The error of the Euler top after 2 s in units of the precision; not a number if it came back as doubles."""
    sol = flown(_TOP.dynamics, _single(_TOP), t1=2.0, method=_DOP853, **steps)
    if any(value.dtype != jnp.float32 for value in sol.xs.values()):
        return float("nan")
    return _TOP.error({name: value[-1] for name, value in sol.xs.items()}, t=2.0) / _EPS


def _accuracy(each: Map) -> Row:
    return Row(
        f"{each.name} of SE(3), 60 twists",
        "tx.lie.se3",
        lambda: max(
            units for units, _ in worst_units(each, twists(60, each.largest, np.float32, below=each.of_poses)).values()
        ),
        AtMost(BAR, "ulp"),
        "Single precision has switch points of its own between series and closed forms.",
        slow=True,
    )


def _defect() -> float:
    """|R'R - I| after 10,000 steps, in units of the precision."""
    sol = flown(_TOP.dynamics, _single(_TOP), t1=20.0, steps=10_000, method=tx.RKMK(tx.tableaus.RK4))
    R = np.asarray(sol.xs["R"][-1], float)
    return float(np.max(np.abs(R.T @ R - np.eye(3)))) / _EPS


def _round_trip() -> float:
    w = np.float32(1e-30) * np.array([1.0, 2.0, -2.0], np.float32)
    return float(np.max(np.abs(np.asarray(so3.log(so3.exp(jnp.asarray(w)))) - w)) / 1e-30) / _EPS


PRECISION = Section(
    "single",
    "Single precision",
    "Arrays in float32 give a flight in float32, with x64 switched on. Errors in units of its precision, 1.2e-7.",
    (
        Row(
            "Euler top, 2 s, equal steps of 0.02 s",
            "DOP853",
            lambda: _flight(dt=0.02),
            AtMost(50.0, "eps"),
            "Only round-off is left: a few units for some rad of motion.",
        ),
        Row(
            "Euler top, 2 s, rtol 1e-5",
            "DOP853",
            lambda: _flight(rtol=1e-5),
            AtMost(200.0, "eps"),
            "A tolerance of 80 eps is kept.",
        ),
        Row(
            "rtol 1e-6, which is below ten eps",
            "DOP853",
            lambda: _flight(rtol=1e-6),
            Refused(tx.InputError, "ten times the round-off of float32"),
            "Finer than round-off no step can be; the message tells how to get doubles.",
        ),
        Row(
            "R'R - I after 10,000 steps",
            "RK4",
            _defect,
            AtMost(5.0, "eps"),
            "The stored quaternion is put back to length one in every step.",
        ),
        Row(
            "log(Exp(w)), |w| = 3e-30 rad",
            "tx.lie.so3",
            _round_trip,
            AtMost(4.0, "eps"),
            "The squares underflow; the series never sees them.",
        ),
        *(_accuracy(each) for each in MAPS),
    ),
)
