"""Problems of PSOPT's examples with short horizons and low dimension."""

from __future__ import annotations

import math
from typing import Any

from ..statement import Foreign, Points, RungeKutta, Var

_FILE = "PSOPT, examples/{0}/{0}.cxx"


def _graded(s: float) -> float:
    return s - 0.9 * math.sin(2.0 * math.pi * s) / (2.0 * math.pi)


HYPERSENSITIVE = Foreign(
    name="hypersensitive",
    source=f"Rao and Mease, Optim. Control Appl. Methods 21 (2000); {_FILE.format('hypersensitive')}",
    published=1.330826,
    states={"x": Var(start=1.5, end=1.0)},
    controls={"u": Var(guess=0.0)},
    rates=lambda x, m: [x.u - x.x**3],
    running=lambda x, m: 0.5 * (x.x**2 + x.u**2),
    final_time=50.0,
    intervals=100,
    nodes=[_graded(k / 100) for k in range(101)],
    linear=True,
    rule=Points(2),
    theirs="Legendre, 25 and 50 nodes",
)

RAYLEIGH = Foreign(
    name="Rayleigh with a mixed constraint",
    source=_FILE.format("rayleigh"),
    published=44.77625,
    states={"x1": Var(-10.0, 10.0, -5.0), "x2": Var(-10.0, 10.0, -5.0)},
    controls={"u": Var(-10.0, 10.0, guess=0.0)},
    rates=lambda x, m: [x.x2, -x.x1 + x.x2 * (1.4 - 0.14 * x.x2**2) + 4.0 * x.u],
    running=lambda x, m: x.u**2 + x.x1**2,
    path=lambda x, m: {"mixed": (-100.0, x.u + x.x1 / 6.0, 0.0)},
    final_time=4.5,
    intervals=80,
    linear=True,
    rule=RungeKutta(1),
    theirs="Hermite-Simpson",
)


def _peaks(x: Any, m: Any) -> Any:
    """What the Alp rider must stay above."""
    peaks = ((3.0, 3.0, 12.0), (3.0, 6.0, 10.0), (3.0, 10.0, 6.0), (8.0, 15.0, 4.0))
    return sum(height * m.exp(-width * (x.t - centre) ** 2) for height, centre, width in peaks) + 0.01


def _square(x: Any) -> Any:
    return x.x1**2 + x.x2**2 + x.x3**2 + x.x4**2


ALP_RIDER = Foreign(
    name="Alp rider",
    source=f"Betts (2010), section 4.10; {_FILE.format('alpine')}",
    states={
        "x1": Var(-4.0, 4.0, 2.0, 2.0),
        "x2": Var(-4.0, 4.0, 1.0, 3.0),
        "x3": Var(-4.0, 4.0, 2.0, 1.0),
        "x4": Var(-4.0, 4.0, 1.0, -2.0),
    },
    controls={"u1": Var(-500.0, 500.0, guess=0.0), "u2": Var(-500.0, 500.0, guess=0.0)},
    rates=lambda x, m: [
        -10.0 * x.x1 + x.u1 + x.u2,
        -2.0 * x.x2 + x.u1 + 2.0 * x.u2,
        -3.0 * x.x3 + 5.0 * x.x4 + x.u1 - x.u2,
        5.0 * x.x3 - 3.0 * x.x4 + x.u1 + 3.0 * x.u2,
    ],
    running=lambda x, m: 100.0 * _square(x) + 0.01 * (x.u1**2 + x.u2**2),
    path=lambda x, m: {"above the peaks": (0.0, _square(x) - _peaks(x, m), 100.0)},
    final_time=20.0,
    intervals=120,
    linear=True,
    rule=RungeKutta(1),
    theirs="Radau, a refined mesh",
)

TWO_LINK_ARM = Foreign(
    name="two-link arm",
    source=_FILE.format("twolinkarm"),
    published=2.988662,
    states={
        "x1": Var(-2.0, 2.0, 0.0, 0.0),
        "x2": Var(-2.0, 2.0, 0.0, 0.0),
        "x3": Var(-2.0, 2.0, 0.5, 0.5),
        "x4": Var(-2.0, 2.0, 0.0, 0.522, 0.522),
    },
    controls={"u1": Var(-1.0, 1.0, guess=0.0), "u2": Var(-1.0, 1.0, guess=0.0)},
    rates=lambda x, m: (
        [rate / (31.0 / 36.0 + 2.25 * m.sin(x.x3) ** 2) for rate in _torques(x, m)] + [x.x2 - x.x1, x.x1]
    ),
    cost=lambda x, m: x.t,
    final_time=(1.0, 10.0, 3.0),
    intervals=40,
    theirs="Legendre",
)


def _torques(x: Any, m: Any) -> Any:
    """The right sides of the two accelerations, times the determinant of the mass matrix."""
    s, c = m.sin(x.x3), m.cos(x.x3)
    first = s * (2.25 * c * x.x1**2 + 2.0 * x.x2**2) + 4.0 / 3.0 * (x.u1 - x.u2) - 1.5 * c * x.u2
    second = -s * (3.5 * x.x1**2 + 2.25 * c * x.x2**2) + 7.0 / 3.0 * x.u2 - 1.5 * c * (x.u1 - x.u2)
    return first, second
