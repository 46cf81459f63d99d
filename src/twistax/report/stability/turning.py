"""Steps that turn far."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from ...scenes.arrays import about
from ...scenes.scene import rotation_angle
from .row import AtMost, Ends, Place, Row, Section, flown

__all__ = ["TURNING", "exact"]

#: The body turns at 1 rad/s about an axis that leans by LEAN rad and goes round in the body at ROUND rad/s.
LEAN, ROUND = 0.3, 0.05
_STEPS = 20
_TABLEAU = tx.tableaus.DOP853
_METHODS = {
    "polynomials (the default)": tx.RKMK(_TABLEAU),
    "closed form": tx.RKMK(_TABLEAU, tx.charts.Exponential()),
    "quaternion": tx.RKMK(_TABLEAU, tx.charts.Ambient()),
    "Magnus 6": tx.Magnus(6),
}
#: Turns in a step, rad, and the largest error after 20 of them, rad, some ten times what was seen; None where the
#: chart ends.
_TURNS = (0.1, 0.5, 1.0, 2.0, 3.0, 3.3, 4.0, 5.0, 6.0, 7.0)
_BARS: dict[str, tuple[float | None, ...]] = {
    "polynomials (the default)": (1e-14, 2e-11, 1e-8, 6e-6, 7e-5, *5 * (None,)),
    "closed form": (1e-14, 1e-12, 2e-10, 1e-7, 5e-6, 2e-5, 4e-4, 2e-2, np.pi, None),
    "quaternion": (1e-14, 1e-10, 5e-8, 3e-5, 1e-3, 2e-3, 1e-2, 6e-2, 0.2, 0.3),
    "Magnus 6": (1e-11, 1e-7, 8e-6, 6e-4, 3e-3, 6e-3, 6e-2, 0.4, np.pi, None),
}


@functools.cache
def _coning() -> tx.Dynamics:
    R, t = tx.State("R", group=tx.SO3), tx.Time()
    side = np.sin(LEAN)
    return tx.compile(tx.System(rates={R: tx.Concat(side * tx.Cos(ROUND * t), side * tx.Sin(ROUND * t), np.cos(LEAN))}))


def exact(t: float) -> Any:
    """R(t) = Exp(t (w(0) + n)) Exp(-t n), n = ROUND e_z: in axes that go round with it, the axis stands still."""
    steady = np.array([np.sin(LEAN), 0.0, np.cos(LEAN) + ROUND])
    size = np.linalg.norm(steady)
    return about(steady / size, size * t) @ about((0.0, 0.0, 1.0), -ROUND * t)


def _error(method: Any, duration: float, **steps: Any) -> float:
    sol = flown(_coning(), {"R": np.eye(3)}, t1=duration, method=method, **steps)
    return rotation_angle(exact(duration), np.asarray(sol.xs["R"][-1]))


def _row(label: str, turn: float, bar: float | None) -> Row:
    magnus = label.startswith("Magnus")
    if bar is None:
        held = "half a turn" if label.startswith("polynomials") else "a full turn"
        why = f"Exponential coordinates hold {held} in a step; beyond, the flight ends and the message names the turn."
    elif label == "quaternion":
        why = "Plain numbers have no edge: a step that is too long is as wrong as the tableau makes it, in the group."
    elif bar == np.pi:
        why = "So near to a full turn the coordinates all but end: the answer is wrong, as a smaller step would show."
    else:
        why = "The coordinates hold the step; the error is that of the method, as for any long step."
    return Row(
        f"{turn:g} rad a step, {_STEPS} steps",
        label if magnus else f"DOP853, {label}",
        lambda: _error(_METHODS[label], _STEPS * turn, steps=_STEPS),
        Ends(tx.Result.NON_FINITE, before=0.0) if bar is None else AtMost(bar, "rad"),
        why,
        place=Place(label, turn),
    )


TURNING = Section(
    "turning",
    "Rotation in a step",
    f"A body turns at 1 rad/s about an axis that leans by {LEAN} rad and goes round in the body at {ROUND} rad/s; the "
    "attitude has a closed form. Steps of given length, from 0.1 rad to more than a full turn; errors in rad.",
    (
        *(_row(label, turn, bar) for label in _METHODS for turn, bar in zip(_TURNS, _BARS[label], strict=True)),
        Row(
            "200 rad, rtol 1e-9, first step of 7 s",
            "DOP853",
            lambda: _error(_METHODS["polynomials (the default)"], 200.0, rtol=1e-9, dt=7.0),
            AtMost(1e-7, "rad"),
            "Steps chosen by tolerances are taken back where the chart ends, and made shorter.",
        ),
    ),
    axes=("rotation in a step, rad", "error, rad"),
)
