"""Problems of PSOPT's examples: a rigid body, a crane, a missile, heat along a rod."""

from __future__ import annotations

import math
from typing import Any

from ..statement import Foreign, Points, Var

_FILE = "PSOPT, examples/{0}/{0}.cxx"
_S, _C = math.sin(math.radians(75.0)), math.cos(math.radians(75.0))

REORIENTATION = Foreign(
    name="reorientation with an algebraic quaternion",
    source=f"Betts (2010), example 6.12; {_FILE.format('reorientation')}",
    published=28.6304,
    states={
        "q1": Var(-1.0, 1.0, 0.0, _S),
        "q2": Var(-1.0, 1.0, 0.0, 0.0),
        "q3": Var(-1.0, 1.0, 0.0, 0.0),
        **{f"w{i}": Var(-0.5, 0.5, 0.0, 0.0) for i in (1, 2, 3)},
    },
    controls={**{f"u{i}": Var(-50.0, 50.0, guess=50.0) for i in (1, 2, 3)}, "q4": Var(-1.0, 1.0, 1.0, _C)},
    rates=lambda x, m: [
        0.5 * (x.w1 * x.q4 - x.w2 * x.q3 + x.w3 * x.q2),
        0.5 * (x.w1 * x.q3 + x.w2 * x.q4 - x.w3 * x.q1),
        0.5 * (-x.w1 * x.q2 + x.w2 * x.q1 + x.w3 * x.q4),
        (x.u1 - (2364.0 - 4547.0) * x.w2 * x.w3) / 5621.0,
        (x.u2 - (5621.0 - 2364.0) * x.w1 * x.w3) / 4547.0,
        (x.u3 - (4547.0 - 5621.0) * x.w1 * x.w2) / 2364.0,
    ],
    path=lambda x, m: {"unit": (1.0, x.q1**2 + x.q2**2 + x.q3**2 + x.q4**2, 1.0)},
    cost=lambda x, m: x.t,
    final_time=(25.0, 35.0, 35.0),
    intervals=60,
    linear=True,
    theirs="trapezoid rule, 60 nodes, refined",
)

CRANE = Foreign(
    name="container crane",
    source=f"Sakawa and Shindo, Int. J. Control 35 (1982); {_FILE.format('crane')}",
    published=0.0051513,
    states={
        "x1": Var(-5.0, 15.0, 0.0, 10.0),
        "x2": Var(-5.0, 25.0, 22.0, 14.0),
        "x3": Var(-5.0, 15.0, 0.0, 0.0),
        "x4": Var(-2.5, 2.5, 0.0, 2.5),
        "x5": Var(-1.0, 1.0, -1.0, 0.0),
        "x6": Var(-5.0, 15.0, 0.0, 0.0),
    },
    controls={"u1": Var(-2.83374, 2.83374, guess=0.0), "u2": Var(-0.80865, 0.71265, guess=0.0)},
    rates=lambda x, m: [
        9.0 * x.x4,
        9.0 * x.x5,
        9.0 * x.x6,
        9.0 * (x.u1 + 17.2656 * x.x3),
        9.0 * x.u2,
        -9.0 / x.x2 * (x.u1 + 27.0756 * x.x3 + 2.0 * x.x5 * x.x6),
    ],
    running=lambda x, m: 4.5 * (x.x3**2 + x.x6**2),
    final_time=1.0,
    intervals=80,
    linear=True,
    theirs="Legendre, 40 to 80 nodes",
)


def _missile(x: Any, m: Any) -> Any:
    density = 3.312e-9 * x.h**2 - 1.142e-4 * x.h + 1.224
    push = 0.5 * density * x.V**2 * 0.3376
    force, lift = x.T - (-1.9431 * x.a**2 - 0.1499 * x.a + 0.2359) * push, 21.9 * x.a * push
    return force, lift


def _flown(x: Any, m: Any) -> Any:
    (force, lift), mass = _missile(x, m), 1005.0
    return [
        (force * m.sin(x.a) + lift * m.cos(x.a)) / (mass * x.V) - 9.81 * m.cos(x.gamma) / x.V,
        (force * m.cos(x.a) - lift * m.sin(x.a)) / mass - 9.81 * m.sin(x.gamma),
        x.V * m.cos(x.gamma),
        x.V * m.sin(x.gamma),
    ]


MISSILE = Foreign(
    name="missile, terminal bunt",
    source=f"Subchan and Zbikowski (2009); {_FILE.format('missile')}",
    published=40.91755,
    states={
        "gamma": Var(-math.pi / 2.0, math.pi / 2.0, 0.0, -math.pi / 2.0),
        "V": Var(200.0, 310.0, 272.0, 310.0),
        "x": Var(0.0, 10_000.0, 0.0, 10_000.0),
        "h": Var(0.0, 1900.0, 30.0, 0.0),
    },
    controls={"T": Var(1000.0, 6000.0, guess=6000.0), "a": Var(-0.3, 0.3, guess=0.0)},
    rates=_flown,
    path=lambda x, m: {
        "load": (-4.0, _missile(x, m)[1] / (1005.0 * 9.81), 4.0),
        "height": (0.0, x.h - 15.0 * (1.0 + m.tanh((7500.0 - x.x) / 10.0)), 1900.0),
    },
    cost=lambda x, m: x.t,
    final_time=(10.0, 100.0, 50.0),
    intervals=80,
    linear=True,
    theirs="trapezoid rule, 20 and 80 nodes",
)

_LINES = 10
_X = [i / (_LINES - 1) for i in range(_LINES)]


def _heated(x: Any, m: Any) -> Any:
    """Rates of ten lines; the two values beyond the ends follow from the fluxes there."""
    e, d, pi = m.exp(-x.t), 1.0 / (_LINES - 1), math.pi
    y = [getattr(x, f"y{i}") for i in range(_LINES)]
    ghost = y[1] - 2.0 * d * (y[0] - x.v) / (4.0 - y[0])
    line = [ghost, *y, y[-2]]
    rates = []
    for i, at in enumerate(_X):
        c = math.cos(pi * at)
        heat = (2.0 * pi**2 - 6.0) * e * c + pi**2 * e**2 + (-2.0 * pi**2 - 1.0) * e**2 * c**2
        bend, slope = (line[i + 2] - 2.0 * y[i] + line[i]) / d**2, (line[i + 2] - line[i]) / (2.0 * d)
        rates.append((heat + (4.0 - y[i]) * bend - slope**2) / (4.0 + y[i]))
    return rates


HEAT = Foreign(
    name="heat along a rod",
    source=f"Betts (2010), example 4.6.10; {_FILE.format('heat')}",
    published=4.372837e-5,
    states={f"y{i}": Var(0.0, 3.0, 2.0 + math.cos(math.pi * at)) for i, at in enumerate(_X)},
    controls={"v": Var(0.0, 0.1, guess=0.1)},
    rates=_heated,
    running=lambda x, m: 0.5 * ((x.y9 - (2.0 - m.exp(-x.t))) ** 2 + 1e-3 * x.v**2),
    final_time=0.5,
    intervals=60,
    linear=True,
    rule=Points(2, "radau"),
    theirs="trapezoid rule, values beyond the ends as algebraic states",
)
