"""Problems of CasADi's own examples, and of Opti's demonstration."""

from __future__ import annotations

import math
from typing import Any

from ..statement import Foreign, Points, RungeKutta, Var

RACE_CAR = Foreign(
    name="race car below a speed limit",
    source="CasADi, docs/examples/python/race_car.py",
    states={"p": Var(start=0.0, end=1.0, guess=0.0), "v": Var(start=0.0, guess=1.0)},
    controls={"u": Var(0.0, 1.0, guess=0.0)},
    rates=lambda x, m: [x.v, x.u - x.v],
    cost=lambda x, m: x.t,
    path=lambda x, m: {"speed": (-math.inf, x.v - 1.0 + m.sin(2.0 * math.pi * x.p) / 2.0, 0.0)},
    final_time=(1e-3, 100.0, 1.0),
    intervals=100,
)

_VAN_DER_POL: dict[str, Any] = {
    "states": {"x1": Var(-0.25, start=0.0), "x2": Var(start=1.0, guess=0.0)},
    "controls": {"u": Var(-1.0, 1.0, guess=0.0)},
    "rates": lambda x, m: [(1.0 - x.x2**2) * x.x1 - x.x2 + x.u, x.x1],
    "running": lambda x, m: x.x1**2 + x.x2**2 + x.u**2,
    "final_time": 10.0,
    "intervals": 20,
}

VAN_DER_POL_SHOOTING = Foreign(
    name="Van der Pol, shooting",
    source="CasADi, docs/examples/python/direct_multiple_shooting.py",
    rule=RungeKutta(4),
    theirs="the cost as a state",
    **_VAN_DER_POL,
)

VAN_DER_POL_COLLOCATION = Foreign(
    name="Van der Pol, collocation",
    source="CasADi, docs/examples/python/direct_collocation.py",
    rule=Points(3),
    **_VAN_DER_POL,
)

ROCKET = Foreign(
    name="rocket of least effort",
    source="CasADi, docs/examples/python/rocket.py",
    states={"s": Var(start=0.0, end=10.0), "v": Var(start=0.0, end=0.0), "m": Var(start=1.0)},
    controls={"u": Var(-0.5, 0.5, guess=0.4)},
    rates=lambda x, m: [x.v, (x.u - 0.05 * x.v**2) / x.m, -0.1 * x.u**2],
    running=lambda x, m: x.u**2 / 0.2,
    final_time=10.0,
    intervals=50,
    theirs="20 steps of Euler, single shooting",
)
