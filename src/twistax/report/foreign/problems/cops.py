"""Problems of COPS 3.0.

Source: Dolan, More, Munson, Benchmarking optimization software with COPS 3.0 (2004), problems 8, 9, 10 and 11; guesses
are those of its models, as `COPSBenchmark.jl` and `OptimalControlProblems.jl` of control-toolbox repeat them.
"""

from __future__ import annotations

import math
from typing import Any

from ..statement import Foreign, Var

_TRAPEZOID = "trapezoid rule"
_TURN = 2.0 * math.pi / 3.0


def _inertia(x: Any) -> Any:
    return ((5.0 - x.rho) ** 3 + x.rho**3) / 3.0


ROBOT_ARM = Foreign(
    name="robot arm",
    source="COPS 3.0, problem 8; 100 intervals",
    published=9.14093,
    states={
        "rho": Var(0.0, 5.0, 4.5, 4.5),
        "theta": Var(-math.pi, math.pi, 0.0, _TURN, lambda s: _TURN * s**2),
        "phi": Var(0.0, math.pi, math.pi / 4.0, math.pi / 4.0),
        "drho": Var(start=0.0, end=0.0),
        "dtheta": Var(start=0.0, end=0.0, guess=lambda s: 2.0 * _TURN * s),
        "dphi": Var(start=0.0, end=0.0),
    },
    controls={name: Var(-1.0, 1.0, guess=0.0) for name in ("u_rho", "u_theta", "u_phi")},
    rates=lambda x, m: [
        x.drho,
        x.dtheta,
        x.dphi,
        x.u_rho / 5.0,
        x.u_theta / (_inertia(x) * m.sin(x.phi) ** 2),
        x.u_phi / _inertia(x),
    ],
    cost=lambda x, m: x.t,
    final_time=(1e-3, 100.0, 1.0),
    intervals=100,
    linear=True,
    theirs=_TRAPEZOID,
)

PARTICLE_STEERING = Foreign(
    name="particle steering",
    source="COPS 3.0, problem 9; 100 intervals",
    published=0.554571,
    states={
        "x": Var(start=0.0),
        "y": Var(start=0.0, end=5.0),
        "vx": Var(start=0.0, end=45.0),
        "vy": Var(start=0.0, end=0.0),
    },
    controls={"angle": Var(-math.pi / 2.0, math.pi / 2.0, guess=0.0)},
    rates=lambda x, m: [x.vx, x.vy, 100.0 * m.cos(x.angle), 100.0 * m.sin(x.angle)],
    cost=lambda x, m: x.t,
    final_time=(1e-3, 100.0, 1.0),
    intervals=100,
    linear=True,
    theirs=_TRAPEZOID,
)

GODDARD = Foreign(
    name="Goddard's rocket",
    source="COPS 3.0, problem 10; 100 intervals",
    published=1.01283,
    states={
        "h": Var(1.0, start=1.0, guess=1.0),
        "v": Var(0.0, start=0.0, guess=lambda s: s * (1.0 - s)),
        "m": Var(0.6, 1.0, 1.0, 0.6),
    },
    controls={"T": Var(0.0, 3.5, guess=1.75)},
    rates=lambda x, m: [
        x.v,
        (x.T - 310.0 * x.v**2 * m.exp(500.0 - 500.0 * x.h)) / x.m - 1.0 / x.h**2,
        -2.0 * x.T,
    ],
    cost=lambda x, m: x.h,
    maximise=True,
    final_time=(1e-3, 100.0, 1.0),
    intervals=100,
    linear=True,
    theirs=_TRAPEZOID,
)


def _lifted(x: Any, m: Any) -> Any:
    """Accelerations of the glider in a thermal."""
    r = (x.x / 100.0 - 2.5) ** 2
    w = x.vy - 2.5 * (1.0 - r) * m.exp(-r)
    push = 1.13 * 14.0 / 2.0 * m.sqrt(x.vx**2 + w**2)
    drag, lift = (0.034 + 0.069662 * x.cL**2) * push, x.cL * push
    return [(-lift * w - drag * x.vx) / 100.0, (lift * x.vx - drag * w) / 100.0 - 9.81]


HANG_GLIDER = Foreign(
    name="hang glider",
    source="COPS 3.0, problem 11; Betts (2010), example 6.5; 100 intervals",
    published=1248.03,
    states={
        "x": Var(0.0, start=0.0, guess=lambda s: 13.23 * s),
        "y": Var(start=1000.0, end=900.0),
        "vx": Var(0.0, start=13.23, end=13.23),
        "vy": Var(start=-1.288, end=-1.288),
    },
    controls={"cL": Var(0.0, 1.4, guess=0.7)},
    rates=lambda x, m: [x.vx, x.vy, *_lifted(x, m)],
    cost=lambda x, m: x.x,
    maximise=True,
    final_time=(0.1, 1000.0, 1.0),
    intervals=100,
    linear=True,
    theirs=_TRAPEZOID,
)
