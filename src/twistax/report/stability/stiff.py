"""Steps far longer than the fastest time of a system."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

import twistax as tx

from ...scenes import SCENES, Scene, actuator_lag, stiff_attitude
from .row import AtLeast, AtMost, Ends, Place, Row, Section, flown, plain

__all__ = ["STIFF"]

_HOLD = stiff_attitude.STIFF_ATTITUDE
_RADAU, _GAUSS = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5), tx.ImplicitRKMK(tx.tableaus.GAUSS_LEGENDRE6)
_DOP853 = tx.RKMK(tx.tableaus.DOP853)
_PATIENT = tx.StepControl(max_steps=10**6)


def _hold(rate: float, method: Any, **steps: Any) -> float:
    """The error of the attitude hold at a rate; one system, so that every rate is the same compiled flight."""
    scene = stiff_attitude.scene(rate)
    sol = flown(_HOLD.dynamics, scene.start, t1=scene.duration, params=scene.params, method=method, **steps)
    return scene.error({name: value[-1] for name, value in sol.xs.items()})


def _lagged(lag: float) -> float:
    return _error(actuator_lag.scene(lag), actuator_lag.ACTUATOR_LAG, rtol=1e-8)


def _error(scene: Scene, of: Scene, **options: Any) -> float:
    """The error of a scene, flown with the compiled system of another that differs in parameters alone."""
    sol = flown(of.dynamics, scene.start, t1=scene.duration, params=scene.params, method=_RADAU, **options)
    return scene.error({name: value[-1] for name, value in sol.xs.items()})


def _chosen(rate: float) -> Row:
    return Row(
        f"rate {plain(rate)}/s, rtol 1e-8",
        "Radau IIA 5",
        lambda: _hold(rate, _RADAU, rtol=1e-8),
        AtMost(1e-8),
        "An L-stable method steps over what has died out: its steps follow the slow motion, however fast the rest.",
    )


def _fixed(rate: float, dt: float, bar: float) -> Row:
    return Row(
        f"rate {plain(rate)}/s, steps of {dt:g} s: step x rate {plain(rate * dt)}",
        "Radau IIA 5",
        lambda: _hold(rate, _RADAU, dt=dt),
        AtMost(bar),
        "The error is that of the slow motion; it does not grow with the rate.",
        slow=True,
        place=Place(f"Radau IIA 5, steps of {dt:g} s", rate * dt),
    )


def _explicit(rate: float) -> Row:
    dt = 5e-3
    short = rate * dt < 6.0
    return Row(
        f"rate {plain(rate)}/s, steps of {dt:g} s: step x rate {plain(rate * dt)}",
        "DOP853",
        lambda: _hold(rate, _DOP853, dt=dt),
        AtMost(1e-8) if short else Ends(tx.Result.NON_FINITE),
        "Inside of its region of stability an explicit method is as accurate as its order makes it."
        if short
        else "Outside of its region of stability every step multiplies what should die out, until it overflows.",
        place=Place(f"DOP853, steps of {dt:g} s", rate * dt),
    )


STIFF = Section(
    "stiff",
    "Step x rate",
    "A body is held to a moving attitude by a spring and a damper; what the rate makes fast dies out at once, the rest "
    "takes seconds (scene stiff-attitude, 5 s). The error is that of the end, in rad.",
    (
        *(_chosen(rate) for rate in stiff_attitude.RATES),
        *(_fixed(rate, 0.05, 1e-7) for rate in stiff_attitude.RATES),
        *(_fixed(rate, 1.0, 1e-3) for rate in stiff_attitude.RATES),
        *(_explicit(rate) for rate in (1e2, 1e3, 1e4, 1e8)),
        Row(
            "rate 1e8/s, rtol 1e-8",
            "DOP853",
            lambda: _hold(1e8, _DOP853, rtol=1e-8),
            Ends(tx.Result.MAX_STEPS),
            "An explicit method that chooses its steps stays right, with steps of 1e-8 s, and runs out of them.",
            slow=True,
        ),
        Row(
            "rate 1e8/s, order seen between steps of 0.1 and 0.05 s",
            "Radau IIA 5",
            lambda: np.log2(_hold(1e8, _RADAU, dt=0.1) / _hold(1e8, _RADAU, dt=0.05)),
            AtLeast(4.0),
            "Stiffness may lower the order to that of the stages, 3; on this one it stays at 5.",
            slow=True,
        ),
        Row(
            "rate 1e8/s, steps of 0.05 s",
            "Gauss-Legendre 6",
            lambda: _hold(1e8, _GAUSS, dt=0.05),
            AtMost(1.0),
            "Gauss methods are A-stable but do not damp: what should die out stays as large as it was, and no larger.",
            slow=True,
        ),
        *(
            Row(
                f"actuators with a lag of {plain(lag)} s, rtol 1e-8",
                "Radau IIA 5",
                functools.partial(_lagged, lag),
                AtMost(1e-7),
                "A pose with lags of its own: the same L-stable steps.",
                slow=True,
            )
            for lag in actuator_lag.LAGS
        ),
        Row(
            "two bodies on a joint of 1e8 N/m, rtol 1e-8",
            "Radau IIA 5",
            lambda: _error(SCENES["stiff-joint"], SCENES["stiff-joint"], rtol=1e-8, control=_PATIENT),
            AtMost(1e-5),
            "Every error of 1e-8 in a position is a pull of 1 N: the hardest of these, and the error says so.",
            slow=True,
        ),
    ),
    axes=("step x rate", "error, rad"),
)
