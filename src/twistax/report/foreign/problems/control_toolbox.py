"""Further problems of `OptimalControlProblems.jl` of control-toolbox (ext/JuMPModels), and the sources it names."""

from __future__ import annotations

import math

from ..statement import Foreign, Points, Var

_FILE = "control-toolbox/OptimalControlProblems.jl, ext/JuMPModels/{}.jl"
_TILT = math.pi / 6.0
_STILL = Var(start=0.0, end=0.0)

DUCTED_FAN = Foreign(
    name="ducted fan",
    source=f"{_FILE.format('ducted_fan')}; Graichen and Petit, Optim. Control Appl. Methods 30 (2009)",
    states={
        "x1": Var(start=0.0, end=1.0, guess=0.0),
        "v1": _STILL,
        "x2": _STILL,
        "v2": _STILL,
        "angle": Var(-_TILT, _TILT, 0.0, 0.0),
        "spin": _STILL,
    },
    controls={"u1": Var(-5.0, 5.0, guess=0.0), "u2": Var(0.0, 17.0, guess=4.0)},
    rates=lambda x, m: [
        x.v1,
        (x.u1 * m.cos(x.angle) - x.u2 * m.sin(x.angle)) / 2.2,
        x.v2,
        (-4.0 + x.u1 * m.sin(x.angle) + x.u2 * m.cos(x.angle)) / 2.2,
        x.spin,
        4.0 * x.u1,
    ],
    running=lambda x, m: 2.0 * x.u1**2 + x.u2**2,
    cost=lambda x, m: 1000.0 * x.t,
    final_time=(1e-3, 100.0, 1.0),
    intervals=100,
    linear=True,
    theirs="trapezoid rule, cost summed over nodes",
)

MOONLANDER = Foreign(
    name="moonlander with two engines",
    source=f"{_FILE.format('moonlander')}; arXiv 2303.16746",
    states={
        "p1": Var(start=0.0, end=5.0, guess=0.0),
        "p2": Var(start=0.0, end=5.0, guess=0.0),
        "v1": _STILL,
        "v2": _STILL,
        "angle": Var(start=0.0),
        "spin": Var(start=0.0),
    },
    controls={"F1": Var(0.0, 19.62, guess=5.0), "F2": Var(0.0, 19.62, guess=5.0)},
    rates=lambda x, m: [
        x.v1,
        x.v2,
        -(x.F1 + x.F2) * m.sin(x.angle),
        (x.F1 + x.F2) * m.cos(x.angle) - 9.81,
        x.spin,
        5.0 * (x.F2 - x.F1),
    ],
    cost=lambda x, m: x.t,
    final_time=(1e-3, 100.0, 1.0),
    intervals=100,
    linear=True,
    theirs="trapezoid rule, no guess of the time",
)

PARTICLE = Foreign(
    name="dielectrophoretic particle",
    source=_FILE.format("dielectrophoretic_particle"),
    states={"x": Var(start=1.0, end=2.0, guess=1.0), "y": Var(start=0.0, guess=1.0)},
    controls={"u": Var(-1.0, 1.0, guess=0.0)},
    rates=lambda x, m: [x.y * x.u - 0.75 * x.u**2, x.u - x.y],
    cost=lambda x, m: x.t,
    final_time=(1e-3, 100.0, 1.0),
    intervals=300,
    linear=True,
    theirs="trapezoid rule",
)

DOUBLE_OSCILLATOR = Foreign(
    name="double oscillator with a controlled damper",
    source=_FILE.format("double_oscillator"),
    states={
        "x1": Var(start=0.0),
        "x2": Var(start=0.0),
        "v1": Var(guess=0.0),
        "v2": Var(guess=0.0),
    },
    controls={"u": Var(-1.0, 1.0, guess=0.0)},
    rates=lambda x, m: [
        x.v1,
        x.v2,
        -1.03 * x.x1 + 0.03 * x.x2 + 0.01 * m.sin(x.t),
        1.5 * x.x1 - 1.5 * x.x2 - 0.25 * (1.0 - x.u) * x.v2,
    ],
    running=lambda x, m: 0.5 * (x.x1**2 + x.x2**2 + x.u**2),
    final_time=2.0 * math.pi,
    intervals=100,
    linear=True,
    rule=Points(1),
    theirs="trapezoid rule, cost summed over nodes",
)
