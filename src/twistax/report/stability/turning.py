"""Steps that turn far."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from ...scenes.scene import about, rotation_angle
from ..checks import Check, Ends, Place, Section, at_most, simulated

__all__ = ["TURNING", "exact"]

#: The body turns at 1 rad/s about an axis that leans by LEAN rad and goes round in the body at ROUND rad/s.
LEAN, ROUND = 0.3, 0.05
_STEPS = 20
_TABLEAU = tx.tableaus.DOP853
_POLYNOMIALS = "polynomials (the default)"
_METHODS = {
    _POLYNOMIALS: tx.RKMK(_TABLEAU),
    "closed form": tx.RKMK(_TABLEAU, tx.charts.Exponential()),
    "quaternion": tx.RKMK(_TABLEAU, tx.charts.Ambient()),
    "Magnus 6": tx.Magnus(6),
}
#: Turns in a step, rad, and the largest error after 20 of them, rad, some ten times what was seen; None where the
#: chart ends.
_TURNS = (0.1, 0.5, 1.0, 2.0, 3.0, 3.3, 4.0, 5.0, 6.0, 7.0)
_BARS: dict[str, tuple[float | None, ...]] = {
    _POLYNOMIALS: (1e-14, 2e-11, 1e-8, 6e-6, 7e-5, *5 * (None,)),
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


def _error(label: str, duration: float, **steps: Any) -> float:
    sol = simulated(_coning(), {"R": np.eye(3)}, t1=duration, method=_METHODS[label], **steps)
    return rotation_angle(exact(duration), np.asarray(sol.xs["R"][-1]))


def _why(label: str, bar: float | None) -> str:
    if bar is None:
        held = "half a turn" if label == _POLYNOMIALS else "a full turn"
        return f"Exponential coordinates hold {held} in a step; beyond, it ends and the message names the turn."
    if label == "quaternion":
        return "Plain numbers have no edge: a step that is too long is as wrong as the tableau makes it, in the group."
    if bar == np.pi:
        return "So near to a full turn the coordinates all but end: the answer is wrong, as a smaller step would show."
    return "The coordinates hold the step; the error is that of the method, as for any long step."


def _reasons() -> dict[str, list[Check]]:
    found: dict[str, list[Check]] = {}
    for label, bars in _BARS.items():
        for turn, bar in zip(_TURNS, bars, strict=True):
            check = Check(
                f"{turn:g} rad a step, {_STEPS} steps",
                label if label.startswith("Magnus") else f"DOP853, {label}",
                functools.partial(_error, label, _STEPS * turn, steps=_STEPS),
                Ends(tx.Result.NON_FINITE, before=0.0) if bar is None else at_most(bar, "rad"),
                place=Place(label, turn),
            )
            found.setdefault(_why(label, bar), []).append(check)
    chosen = Check(
        "200 rad, rtol 1e-9, first step of 7 s",
        "DOP853",
        lambda: _error(_POLYNOMIALS, 200.0, rtol=1e-9, dt=7.0),
        at_most(1e-7, "rad"),
    )
    return found | {"Steps chosen by tolerances are taken back where the chart ends, and made shorter.": [chosen]}


TURNING = Section(
    "turning",
    "Rotation in a step",
    f"A body turns at 1 rad/s about an axis that leans by {LEAN} rad and goes round in the body at {ROUND} rad/s; the "
    "attitude has a closed form. Steps of given length, from 0.1 rad to more than a full turn; errors in rad.",
    _reasons(),
    axes=("rotation in a step, rad", "error, rad"),
)
