"""What is refused before a flight, and by which name."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from .row import Refused, Row, Section, flown

__all__ = ["INPUTS"]

_INPUT = tx.InputError


@functools.cache
def _thing() -> tx.Dynamics:
    """A pose pushed by a control, with a mass."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, m = tx.Control("F", shape=(6,)), tx.Parameter("m")
    return tx.compile(tx.System(rates={g: V, V: F / m}))


def _fly(
    pose: Any = None, V: float = 1.0, F: float = 0.0, m: float = 1.0, t1: float = 1.0, **given: Any
) -> tx.Solution:
    start = {"g": np.eye(4) if pose is None else pose, "V": np.full(6, V)}
    settings = given or {"dt": 0.1}
    return flown(_thing(), start, u={"F": np.full(6, F)}, params={"m": m}, t1=t1, **settings)


def _turned(rotation: Any) -> Any:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return pose


def _last_row() -> Any:
    pose = np.eye(4)
    pose[3, 0] = 1e-3
    return pose


_NAN, _INF = float("nan"), float("inf")
_UNSEEN = "Numbers that are none are refused where they enter, by name."
_NO_ROTATION = "What is no rotation is refused with its distance from one; it is never put right in silence."

_CASES: tuple[tuple[str, Any, str, str], ...] = (
    ("a velocity at the start is not a number", lambda: _fly(V=_NAN), "x0['V'] is not finite", _UNSEEN),
    ("a velocity at the start is infinite", lambda: _fly(V=_INF), "x0['V'] is not finite", _UNSEEN),
    ("a control is not a number", lambda: _fly(F=_NAN), "u['F'] is not finite", _UNSEEN),
    ("a parameter is infinite", lambda: _fly(m=_INF), "params['m'] is not finite", _UNSEEN),
    ("a pose is not a number", lambda: _fly(np.full((4, 4), _NAN)), "x0['g'] is not finite", _UNSEEN),
    ("the end is not a number", lambda: _fly(t1=_NAN), "t1", _UNSEEN),
    ("the end lies before the start", lambda: _fly(t1=-1.0), "t1", "Flights go forward in time."),
    ("a step of zero", lambda: _fly(dt=0.0), "dt", "A step of zero never arrives."),
    ("a tolerance that is not a number", lambda: _fly(rtol=_NAN), "rtol", _UNSEEN),
    ("a reflection", lambda: _fly(_turned(np.diag([1.0, 1.0, -1.0]))), "is no element of SE3", _NO_ROTATION),
    ("a rotation times 1.001", lambda: _fly(_turned(1.001 * np.eye(3))), "is no element of SE3", _NO_ROTATION),
    ("a sheared rotation", lambda: _fly(_turned(np.eye(3) + 1e-3 * np.eye(3, k=1))), "is no element", _NO_ROTATION),
    ("a pose with another last row", lambda: _fly(_last_row()), "is no element of SE3", _NO_ROTATION),
)

INPUTS = Section(
    "inputs",
    "Input that makes no sense",
    "Each is refused before the first step, with an error whose first line says what is wrong.",
    tuple(Row(case, "tx.integrate", measure, Refused(_INPUT, words), why) for case, measure, words, why in _CASES),
)
