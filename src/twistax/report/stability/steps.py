"""Long steps: far longer than the fastest time of a system, and of more than a full turn."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from ...scenes import SCENES, Scene, actuator_lag, stiff_attitude
from ...scenes.scene import about, rotation_angle
from ..checks import Check, Expected, Section, at_least, at_most, ends, simulated
from ..rows import plain

_HOLD, _LAG, _JOINT = stiff_attitude.STIFF_ATTITUDE, actuator_lag.ACTUATOR_LAG, SCENES["stiff-joint"]
_RADAU, _GAUSS = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5), tx.ImplicitRKMK(tx.tableaus.GAUSS_LEGENDRE6)
_DOP853 = tx.RKMK(tx.tableaus.DOP853)
_NAMES = {_RADAU: "Radau IIA 5", _GAUSS: "Gauss-Legendre 6", _DOP853: "DOP853"}


def _error(scene: Scene, of: Scene, method: Any = _RADAU, **options: Any) -> float:
    """The error of a scene, integrated with the compiled system of another that differs in parameters alone."""
    sol = simulated(of.dynamics, scene.start, t1=scene.duration, params=scene.params, method=method, **options)
    return scene.error({name: value[-1] for name, value in sol.xs.items()})


def held(rate: float, method: Any = _RADAU, **steps: Any) -> float:
    """The error of the attitude hold at a rate, rad; one system, so that every rate is the same compiled program."""
    return _error(stiff_attitude.scene(rate), _HOLD, method, **steps)


def _long(rate: float, dt: float, method: Any, expected: Expected, slow: bool = False) -> Check:
    what, place = f"steps of {dt:g} s: step x rate {plain(rate * dt)}", f"{_NAMES[method]}, steps of {dt:g} s"
    return _held(rate, what, method, expected, slow, (place, rate * dt), dt=dt)


def _held(
    rate: float, what: str, method: Any, expected: Expected, slow: bool = True, place: Any = None, **steps: Any
) -> Check:
    measure = functools.partial(held, rate, method, **steps)
    return Check(f"rate {plain(rate)}/s, {what}", _NAMES[method], measure, expected, slow, place)


def _radau(what: str, measure: Any, expected: Expected) -> Check:
    return Check(what, "Radau IIA 5", measure, expected, slow=True)


STIFF = Section(
    "stiff",
    [
        "An L-stable method steps over what has died out: its steps follow the slow motion, however fast the rest.",
        *(_held(rate, "rtol 1e-8", _RADAU, at_most(1e-8), False, rtol=1e-8) for rate in stiff_attitude.RATES),
        "The error is that of the slow motion; it does not grow with the rate.",
        *(_long(rate, 0.05, _RADAU, at_most(1e-7), slow=True) for rate in stiff_attitude.RATES),
        *(_long(rate, 1.0, _RADAU, at_most(1e-3), slow=True) for rate in stiff_attitude.RATES),
        "Inside of its region of stability an explicit method is as accurate as its order makes it.",
        *(_long(rate, 5e-3, _DOP853, at_most(1e-8)) for rate in (1e2, 1e3)),
        "Outside of its region of stability every step multiplies what should die out, until it overflows.",
        *(_long(rate, 5e-3, _DOP853, ends(tx.Result.NON_FINITE)) for rate in (1e4, 1e8)),
        "An explicit method that chooses its steps stays right, with steps of 1e-8 s, and runs out of them.",
        _held(1e8, "rtol 1e-8", _DOP853, ends(tx.Result.MAX_STEPS), rtol=1e-8),
        "Stiffness may lower the order to that of the stages, 3; on this one it stays at 5.",
        _radau(
            "rate 1e8/s, order seen between steps of 0.1 and 0.05 s",
            lambda: np.log2(held(1e8, dt=0.1) / held(1e8, dt=0.05)),
            at_least(4.0),
        ),
        "Gauss methods are A-stable but do not damp: what should die out stays as large as it was, and no larger.",
        _held(1e8, "steps of 0.05 s", _GAUSS, at_most(1.0), dt=0.05),
        "A pose with lags of its own: the same L-stable steps.",
        *[
            _radau(
                f"actuators with a lag of {plain(lag)} s, rtol 1e-8",
                functools.partial(_error, actuator_lag.scene(lag), _LAG, rtol=1e-8),
                at_most(1e-7),
            )
            for lag in actuator_lag.LAGS
        ],
        "Every error of 1e-8 in a position is a pull of 1 N: the hardest of these, and the error says so.",
        _radau(
            "two bodies on a joint of 1e8 N/m, rtol 1e-8",
            lambda: _error(_JOINT, _JOINT, rtol=1e-8, control=tx.StepControl(max_steps=10**6)),
            at_most(1e-5),
        ),
    ],
    axes=("step x rate", "error, rad"),
)


# ---- rotation in a step ---------------------------------------------------------------------------------------------

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


def _turned(label: str, duration: float, **steps: Any) -> float:
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


def _turn(label: str, turn: float, bar: float | None) -> Check:
    by = label if label.startswith("Magnus") else f"DOP853, {label}"
    measure = functools.partial(_turned, label, _STEPS * turn, steps=_STEPS)
    expected = ends(tx.Result.NON_FINITE, before=0.0) if bar is None else at_most(bar, "rad")
    return Check(f"{turn:g} rad a step, {_STEPS} steps", by, measure, expected, place=(label, turn))


TURNING = Section(
    "turning",
    [
        *(
            each
            for label, bars in _BARS.items()
            for turn, bar in zip(_TURNS, bars, strict=True)
            for each in (_why(label, bar), _turn(label, turn, bar))
        ),
        "Steps chosen by tolerances are taken back where the chart ends, and made shorter.",
        Check(
            "200 rad, rtol 1e-9, first step of 7 s",
            "DOP853",
            lambda: _turned(_POLYNOMIALS, 200.0, rtol=1e-9, dt=7.0),
            at_most(1e-7, "rad"),
        ),
    ],
    axes=("rotation in a step, rad", "error, rad"),
)
