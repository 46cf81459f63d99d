"""A truck and a quadrotor of rockit, a car of opty, a landing of OpenSCvx."""

from __future__ import annotations

import math
from typing import Any

from ..statement import Foreign, Points, RungeKutta, Var

_HALF = math.pi / 2.0
_BENCH = "arXiv 2303.16746 (rockit); control-toolbox/OptimalControlProblems.jl, ext/JuMPModels/{}.jl"


def _towed(x: Any, m: Any) -> list[Any]:
    """The truck's kinematics in seconds: hitches are off the axles."""
    b01, b12 = x.th0 - x.th1, x.th1 - x.th2
    w0 = x.v0 / 0.4 * m.tan(x.d0)
    w1 = (x.v0 * m.sin(b01) - 0.1 * m.cos(b01) * w0) / 1.1
    v1 = x.v0 * m.cos(b01) + 0.1 * m.sin(b01) * w0
    w2 = (v1 * m.sin(b12) - 0.2 * m.cos(b12) * w1) / 0.8
    v2 = v1 * m.cos(b12) + 0.2 * m.sin(b12) * w1
    return [v2 * m.cos(x.th2), v2 * m.sin(x.th2), w0, w1, w2, x.rv0, x.rd0]


def _bends(x: Any) -> Any:
    return (x.th0 - x.th1) ** 2 + (x.th1 - x.th2) ** 2


TRUCK = Foreign(
    name="truck with two trailers",
    source=_BENCH.format("truck_trailer"),
    states={
        "x2": Var(start=0.0, end=0.0),
        "y2": Var(start=0.0, end=-2.0, guess=0.0),
        "th0": Var(-_HALF, _HALF, 0.0, guess=0.1),
        "th1": Var(-_HALF, _HALF, 0.0),
        "th2": Var(start=0.0, end=_HALF, guess=0.0),
        "v0": Var(-0.2, 0.2, guess=-0.2),
        "d0": Var(-math.pi / 6.0, math.pi / 6.0, guess=0.0),
    },
    controls={"rv0": Var(-1.0, 1.0, guess=0.0), "rd0": Var(-math.pi / 10.0, math.pi / 10.0, guess=0.0)},
    rates=lambda x, m: [x.T * rate for rate in _towed(x, m)],
    running=lambda x, m: 100.0 * _bends(x),
    cost=lambda x, m: x.T,
    free={"T": Var(1e-3, 1000.0, guess=20.0)},
    path=lambda x, m: {
        "first joint": (-_HALF, x.th0 - x.th1, _HALF),
        "second joint": (-_HALF, x.th1 - x.th2, _HALF),
    },
    ends=lambda x, m, first: [x.th0 - x.th1, x.th1 - x.th2],
    final_time=1.0,
    intervals=100,
    theirs="trapezoid rule, speed and steering at nodes with limited differences, cost summed over nodes",
)

_ANGLES = Var(-_HALF, _HALF, 0.0, guess=0.0)

QUADROTOR_TILT = Foreign(
    name="quadrotor with limits of tilt",
    source=_BENCH.format("quadrotor"),
    states={
        "p1": Var(start=0.0, end=0.01),
        "p2": Var(start=0.0, end=5.0),
        "p3": Var(start=2.5, end=2.5),
        **{f"v{i}": Var(start=0.0, end=0.0) for i in (1, 2, 3)},
        "a": Var(0.0, 45.9, guess=10.0),
        "phi": _ANGLES,
        "theta": _ANGLES,
        "psi": Var(-_HALF, _HALF, guess=0.0),
    },
    controls={
        "ra": Var(guess=0.0),
        "rphi": Var(-3.0, 3.0, guess=0.0),
        "rtheta": Var(-3.0, 3.0, guess=0.0),
        "rpsi": Var(guess=0.0),
    },
    rates=lambda x, m: [
        x.T * rate
        for rate in (
            x.v1,
            x.v2,
            x.v3,
            x.a * (m.cos(x.psi) * m.sin(x.theta) * m.cos(x.phi) + m.sin(x.psi) * m.sin(x.phi)),
            x.a * (m.sin(x.psi) * m.sin(x.theta) * m.cos(x.phi) - m.cos(x.psi) * m.sin(x.phi)),
            x.a * m.cos(x.theta) * m.cos(x.phi) - 9.81,
            x.ra,
            x.rphi,
            x.rtheta,
            x.rpsi,
        )
    ],
    running=lambda x, m: 60e-8 * (x.a**2 + x.phi**2 + x.theta**2 + x.psi**2) + 6e3 * x.psi**2,
    cost=lambda x, m: x.T,
    free={"T": Var(1e-3, 100.0, guess=2.0)},
    path=lambda x, m: {"tilt": (math.cos(0.55), m.cos(x.theta) * m.cos(x.phi), math.inf)},
    final_time=1.0,
    intervals=60,
    theirs="trapezoid rule, attitude at nodes with limited differences, cost summed over nodes",
)


def _parked(x: Any, m: Any) -> list[Any]:
    """A car whose front wheel has a mass and is turned by a torque; the two rolling constraints are solved for."""
    mass, inertia, wheel, spin, a, b = 1200.0, 1300.0, 200.0, 1300.0 / 32.0, 1.5, 1.5
    t = m.tan(x.delta) / (a + b)
    w, vy = x.v * t, b * x.v * t
    s = x.v * x.beta / (m.cos(x.delta) ** 2 * (a + b))  # w' without the part of v'
    side = mass * (b * s + w * x.v) + wheel * ((a + b) * s + w * x.v)
    heavy = mass * b * t + wheel * (a + b) * t
    weight = mass + wheel + b * t * heavy + t * (inertia * t + wheel * a * (a + b) * t)
    rest = -mass * w * vy - wheel * w * (vy + a * w) + b * t * side
    rest += t * (inertia * s + wheel * a * ((a + b) * s + w * x.v) + x.torque)
    dv = (x.force - rest) / weight
    heading = [x.v * m.cos(x.th) - vy * m.sin(x.th), x.v * m.sin(x.th) + vy * m.cos(x.th)]
    return [*heading, w, x.beta, dv, x.torque / spin - (dv * t + s)]


PARKING = Foreign(
    name="parallel parking",
    source="opty, examples-gallery/intermediate/plot_parallel_park.py",
    states={
        "x": Var(start=0.0, end=0.0, guess=lambda s: 3.0 - 6.0 * abs(s - 0.5)),
        "y": Var(start=0.0, end=2.0),
        "th": Var(start=0.0, end=0.0, guess=1.0),
        "delta": Var(-math.pi / 4.0, math.pi / 4.0, 0.0, 0.0, 1.0),
        "v": Var(start=0.0, end=0.0, guess=1.0),
        "beta": Var(start=0.0, end=0.0, guess=1.0),
    },
    controls={"force": Var(-300.0, 300.0, guess=1.0), "torque": Var(-50.0, 50.0, guess=1.0)},
    rates=_parked,
    running=lambda x, m: x.force**2 + x.torque**2,
    final_time=30.0,
    intervals=500,
    rule=Points(1, "radau"),
    theirs="eight states, rolling as algebraic equations",
)

_CANT = math.cos(math.radians(27.0))
_THRUST = 6.0 * 3100.0 * _CANT / 1e4


def _thrust(x: Any) -> Any:
    return x.u1**2 + x.u2**2 + x.u3**2


POWERED_DESCENT = Foreign(
    name="powered descent on Mars",
    source="Acikmese and Ploen, J. Guidance 30 (2007); OpenSCvx, examples/rocket/3DoF_pdg.py",
    states={
        **{f"r{i + 1}": Var(low, 3.0, at, 0.0) for i, (low, at) in enumerate(((-3.0, 2.0), (-3.0, 0.0), (0.0, 1.5)))},
        **{f"v{i + 1}": Var(-5.0 / 3.6, 5.0 / 3.6, at, 0.0) for i, at in enumerate((0.8, 0.3, -0.75))},
        "m": Var(1.505, 1.905, 1.905, guess=lambda s: 1.905 - 0.215 * s),
    },
    controls={"u1": Var(guess=0.0), "u2": Var(guess=0.0), "u3": Var(guess=0.4 * _THRUST)},
    rates=lambda x, m: [
        0.1 * x.v1,
        0.1 * x.v2,
        0.1 * x.v3,
        0.1 * x.u1 / x.m,
        0.1 * x.u2 / x.m,
        0.1 * x.u3 / x.m - 0.037114,
        -10.0 * m.sqrt(_thrust(x)) / (225.0 * 9.807 * _CANT),
    ],
    cost=lambda x, m: x.m,
    maximise=True,
    path=lambda x, m: {
        "thrust": ((0.3 * _THRUST) ** 2, _thrust(x), (0.8 * _THRUST) ** 2),
        "glide": (-math.inf, x.r1**2 + x.r2**2 - (math.tan(math.radians(86.0)) * x.r3) ** 2, 0.0),
    },
    final_time=(1.0, 100.0, 95.0),
    intervals=9,
    rule=RungeKutta(10),
    theirs="held thrust, an adaptive integrator, limits at nodes alone",
)
