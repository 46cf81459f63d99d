"""Problems of PSOPT's examples: a shuttle's entry, friction, obstacles, a soft landing."""

from __future__ import annotations

import math
from typing import Any

from ..statement import Foreign, Points, Var

_FILE = "PSOPT, examples/{0}/{0}.cxx"
_DEGREE = math.pi / 180.0


def _entered(x: Any, m: Any) -> list[Any]:
    """The entry of a shuttle, in feet and pounds; heights are in 1e5 ft, speeds in 1e4 ft/s."""
    h, v, mass, a = 1e5 * x.h, 1e4 * x.v, 203_000.0 / 32.174, x.alpha / _DEGREE
    push = 0.5 * 2690.0 * 0.002378 * m.exp(-h / 23_800.0) * v**2
    lift = (-0.20704 + 0.029244 * a) * push
    drag = (0.07854 - 0.61592e-2 * a + 0.621408e-3 * a**2) * push
    r = 20_902_900.0 + h
    g = 0.14076539e17 / r**2
    cosine, sine = m.cos(x.gamma), m.sin(x.gamma)
    return [
        v * sine / 1e5,
        v / r * cosine * m.sin(x.psi) / m.cos(x.theta),
        v / r * cosine * m.cos(x.psi),
        (-drag / mass - g * sine) / 1e4,
        lift / (mass * v) * m.cos(x.beta) + cosine * (v / r - g / v),
        lift * m.sin(x.beta) / (mass * v * cosine) + v / (r * m.cos(x.theta)) * cosine * m.sin(x.psi) * m.sin(x.theta),
    ]


SHUTTLE = Foreign(
    name="entry of the Space Shuttle",
    source=f"Betts (2010), section 6.1; {_FILE.format('shuttle_reentry')}; guess of JuMP's tutorial space_shuttle",
    published=34.1412 * _DEGREE,
    states={
        "h": Var(0.0, start=2.6, end=0.8),
        "phi": Var(start=0.0),
        "theta": Var(-89.0 * _DEGREE, 89.0 * _DEGREE, 0.0),
        "v": Var(1e-4, start=2.56, end=0.25),
        "gamma": Var(-89.0 * _DEGREE, 89.0 * _DEGREE, -_DEGREE, -5.0 * _DEGREE),
        "psi": Var(start=90.0 * _DEGREE),
    },
    controls={
        "alpha": Var(-90.0 * _DEGREE, 90.0 * _DEGREE, guess=0.0),
        "beta": Var(-89.0 * _DEGREE, 1.0 * _DEGREE, guess=0.0),
    },
    rates=_entered,
    cost=lambda x, m: x.theta,
    maximise=True,
    final_time=(1757.0, 2259.0, 2008.0),
    intervals=100,
    linear=True,
    rule=Points(1),
    theirs="trapezoid rule, refined (PSOPT); 502 steps of Euler (JuMP)",
)


def _friction(speed: Any, m: Any) -> Any:
    """PSOPT's smooth sign."""
    return m.tanh(speed / 0.01)


COULOMB = Foreign(
    name="two masses with Coulomb friction",
    source=f"Driessen and Sadegh (2000); {_FILE.format('coulomb')}",
    published=2.104992,
    states={
        "q1": Var(-2.0, 2.0, 0.0, 1.0),
        "v1": Var(-20.0, 20.0, -1.0, 0.0),
        "q2": Var(-2.0, 2.0, 0.0, 2.0),
        "v2": Var(-20.0, 20.0, -2.0, 0.0),
    },
    controls={"u1": Var(-4.0, 4.0, guess=0.0), "u2": Var(-4.0, 4.0, guess=0.0)},
    rates=lambda x, m: [
        x.v1,
        (-1.8 * x.q1 + 0.85 * x.q2 - _friction(x.v1, m) + x.u1) / 1.1,
        x.v2,
        (0.85 * x.q1 - 0.85 * x.q2 - _friction(x.v2, m) + x.u2) / 1.2,
    ],
    cost=lambda x, m: x.t,
    final_time=(1.8, 4.0, 4.0),
    intervals=40,
    theirs="Legendre",
)

OBSTACLES = Foreign(
    name="way between two discs",
    source=_FILE.format("obstacle"),
    published=4.571044,
    states={"x": Var(0.0, 2.0, 0.0, 1.2), "y": Var(0.0, 2.0, 0.0, 1.6)},
    controls={"angle": Var(-10.0, 10.0, guess=0.0)},
    rates=lambda x, m: [2.138 * m.cos(x.angle), 2.138 * m.sin(x.angle)],
    running=lambda x, m: 2.138**2 * (m.cos(x.angle) ** 2 + m.sin(x.angle) ** 2),
    path=lambda x, m: {
        "first disc": (0.1, (x.x - 0.4) ** 2 + (x.y - 0.5) ** 2, 100.0),
        "second disc": (0.1, (x.x - 0.8) ** 2 + (x.y - 1.5) ** 2, 100.0),
    },
    final_time=1.0,
    intervals=60,
    linear=True,
    theirs="Legendre, 60 and 80 nodes",
)

SOFT_LANDING = Foreign(
    name="soft landing on the Moon",
    source=f"Meditch, IEEE Trans. Autom. Control 9 (1964); {_FILE.format('moon')}",
    published=1.4204,
    states={
        "h": Var(-20.0, 20.0, 1.0, 0.0),
        "v": Var(-20.0, 20.0, -0.783, 0.0),
        "m": Var(0.01, 1.0, 1.0, guess=lambda s: 1.0 - 0.99 * s),
    },
    controls={"T": Var(0.0, 1.227, guess=0.6135)},
    rates=lambda x, m: [x.v, x.T / x.m - 1.0, -x.T / 2.349],
    running=lambda x, m: x.T,
    final_time=(1e-3, 1000.0, 1.5),
    intervals=50,
    theirs="Legendre, 50 nodes",
)
