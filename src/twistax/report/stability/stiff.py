"""Steps far longer than the fastest time of a system."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from ...scenes import SCENES, Scene, actuator_lag, stiff_attitude
from ..checks import Check, Ends, Place, Section, at_least, at_most, simulated
from ..rows import plain

__all__ = ["STIFF", "held"]

_HOLD, _LAG, _JOINT = stiff_attitude.STIFF_ATTITUDE, actuator_lag.ACTUATOR_LAG, SCENES["stiff-joint"]
_RADAU, _GAUSS = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5), tx.ImplicitRKMK(tx.tableaus.GAUSS_LEGENDRE6)
_DOP853 = tx.RKMK(tx.tableaus.DOP853)
_PATIENT = tx.StepControl(max_steps=10**6)


def _error(scene: Scene, of: Scene, method: Any = _RADAU, **options: Any) -> float:
    """The error of a scene, integrated with the compiled system of another that differs in parameters alone."""
    sol = simulated(of.dynamics, scene.start, t1=scene.duration, params=scene.params, method=method, **options)
    return scene.error({name: value[-1] for name, value in sol.xs.items()})


def held(rate: float, method: Any = _RADAU, **steps: Any) -> float:
    """The error of the attitude hold at a rate, rad; one system, so that every rate is the same compiled program."""
    return _error(stiff_attitude.scene(rate), _HOLD, method, **steps)


def _of_steps(rate: float, dt: float, method: Any, by: str, expected: Any, slow: bool = False) -> Check:
    return Check(
        f"rate {plain(rate)}/s, steps of {dt:g} s: step x rate {plain(rate * dt)}",
        by,
        functools.partial(held, rate, method, dt=dt),
        expected,
        slow=slow,
        place=Place(f"{by}, steps of {dt:g} s", rate * dt),
    )


def _radau(what: str, measure: Any, expected: Any, slow: bool = False) -> Check:
    return Check(what, "Radau IIA 5", measure, expected, slow=slow)


STIFF = Section(
    "stiff",
    "Step x rate",
    "A body is held to a moving attitude by a spring and a damper; what the rate makes fast dies out at once, the rest "
    "takes seconds (scene stiff-attitude, 5 s). The error is that of the end, in rad.",
    {
        "An L-stable method steps over what has died out: its steps follow the slow motion, however fast the rest.": [
            _radau(f"rate {plain(rate)}/s, rtol 1e-8", functools.partial(held, rate, rtol=1e-8), at_most(1e-8))
            for rate in stiff_attitude.RATES
        ],
        "The error is that of the slow motion; it does not grow with the rate.": [
            _of_steps(rate, dt, _RADAU, "Radau IIA 5", at_most(bar), slow=True)
            for dt, bar in ((0.05, 1e-7), (1.0, 1e-3))
            for rate in stiff_attitude.RATES
        ],
        "Inside of its region of stability an explicit method is as accurate as its order makes it.": [
            _of_steps(rate, 5e-3, _DOP853, "DOP853", at_most(1e-8)) for rate in (1e2, 1e3)
        ],
        "Outside of its region of stability every step multiplies what should die out, until it overflows.": [
            _of_steps(rate, 5e-3, _DOP853, "DOP853", Ends(tx.Result.NON_FINITE)) for rate in (1e4, 1e8)
        ],
        "An explicit method that chooses its steps stays right, with steps of 1e-8 s, and runs out of them.": [
            Check(
                "rate 1e8/s, rtol 1e-8",
                "DOP853",
                lambda: held(1e8, _DOP853, rtol=1e-8),
                Ends(tx.Result.MAX_STEPS),
                slow=True,
            ),
        ],
        "Stiffness may lower the order to that of the stages, 3; on this one it stays at 5.": [
            _radau(
                "rate 1e8/s, order seen between steps of 0.1 and 0.05 s",
                lambda: np.log2(held(1e8, dt=0.1) / held(1e8, dt=0.05)),
                at_least(4.0),
                slow=True,
            ),
        ],
        "Gauss methods are A-stable but do not damp: what should die out stays as large as it was, and no larger.": [
            Check(
                "rate 1e8/s, steps of 0.05 s",
                "Gauss-Legendre 6",
                lambda: held(1e8, _GAUSS, dt=0.05),
                at_most(1.0),
                True,
            ),
        ],
        "A pose with lags of its own: the same L-stable steps.": [
            _radau(
                f"actuators with a lag of {plain(lag)} s, rtol 1e-8",
                functools.partial(_error, actuator_lag.scene(lag), _LAG, rtol=1e-8),
                at_most(1e-7),
                slow=True,
            )
            for lag in actuator_lag.LAGS
        ],
        "Every error of 1e-8 in a position is a pull of 1 N: the hardest of these, and the error says so.": [
            _radau(
                "two bodies on a joint of 1e8 N/m, rtol 1e-8",
                lambda: _error(_JOINT, _JOINT, rtol=1e-8, control=_PATIENT),
                at_most(1e-5),
                slow=True,
            ),
        ],
    },
    axes=("step x rate", "error, rad"),
)
