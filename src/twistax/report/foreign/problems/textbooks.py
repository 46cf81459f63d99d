"""Dymos' brachistochrone and mountain car, Kelly's cart-pole, and Bryson's glide."""

from __future__ import annotations

import math
from typing import Any

from ..statement import Foreign, Points, RungeKutta, Var

BRACHISTOCHRONE = Foreign(
    name="brachistochrone",
    source="dymos, examples/brachistochrone",
    published=1.8016,
    states={
        "x": Var(0.0, 10.0, 0.0, 10.0),
        "y": Var(0.0, 10.0, 10.0, 5.0),
        "v": Var(start=0.0, guess=lambda s: 9.9 * s),
    },
    controls={"angle": Var(0.01 * math.pi / 180.0, math.pi, guess=lambda s: math.pi / 180.0 * (5.0 + 95.5 * s))},
    rates=lambda x, m: [x.v * m.sin(x.angle), -x.v * m.cos(x.angle), 9.80665 * m.cos(x.angle)],
    cost=lambda x, m: x.t,
    final_time=(0.5, 10.0, 2.0),
    intervals=30,
    linear=True,
    rule=Points(2),
    theirs="Gauss-Lobatto, 10 segments of order 3",
)

MOUNTAIN_CAR = Foreign(
    name="mountain car",
    source="dymos, examples/mountain_car; Melnikov, Makmal, Briegel (2014)",
    states={
        "x": Var(-1.2, 0.5, -0.5, 0.5),
        "v": Var(-0.07, 0.07, 0.0, guess=lambda s: 0.07 * s),
    },
    controls={"u": Var(-1.0, 1.0, guess=lambda s: s)},
    rates=lambda x, m: [x.v, 0.001 * x.u - 0.0025 * m.cos(3.0 * x.x)],
    cost=lambda x, m: x.t,
    final_time=(0.05, 10_000.0, 500.0),
    intervals=100,
    theirs="Radau, 30 segments; v >= 0 at the end, which does not bind",
)


def _cart_pole(x: Any, m: Any) -> list[Any]:
    s, c = m.sin(x.a), m.cos(x.a)
    mass = 1.0 + 0.3 * s**2
    cart = (0.15 * s * x.da**2 + x.u + 0.3 * 9.81 * c * s) / mass
    return [x.dq, x.da, cart, -(0.15 * c * s * x.da**2 + x.u * c + 1.3 * 9.81 * s) / (0.5 * mass)]


CART_POLE = Foreign(
    name="cart-pole swing-up",
    source="Kelly, SIAM Review 59 (2017), section 6 and appendix E",
    published=58.8077,
    states={
        "q": Var(-2.0, 2.0, 0.0, 1.0),
        "a": Var(start=0.0, end=math.pi),
        "dq": Var(start=0.0, end=0.0),
        "da": Var(start=0.0, end=0.0),
    },
    controls={"u": Var(-20.0, 20.0, guess=0.0)},
    rates=_cart_pole,
    running=lambda x, m: x.u**2,
    final_time=2.0,
    intervals=50,
    linear=True,
    rule=RungeKutta(2),
    theirs="trapezoid rule, and Hermite-Simpson",
)

MAX_RANGE = Foreign(
    name="Bryson's maximum range",
    source="Bryson, Dynamic Optimization (1999); PSOPT, examples/bryson_max_range/bryson_max_range.cxx",
    published=1.712314,
    states={
        "x": Var(-10.0, 10.0, 0.0),
        "y": Var(-10.0, 10.0, 0.0, 0.1),
        "v": Var(-10.0, 10.0, 0.0, guess=lambda s: s),
    },
    controls={"u1": Var(-10.0, 10.0, guess=1.0), "u2": Var(-10.0, 10.0, guess=0.0)},
    rates=lambda x, m: [x.v * x.u1, x.v * x.u2, 0.5 - x.u2],
    path=lambda x, m: {"unit": (1.0, x.u1**2 + x.u2**2, 1.0)},
    cost=lambda x, m: x.x,
    maximise=True,
    final_time=2.0,
    intervals=50,
    theirs="Legendre, 50 nodes",
)
