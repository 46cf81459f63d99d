"""Problems of Bocop, as `OptimalControlProblems.jl` of control-toolbox states them (ext/JuMPModels)."""

from __future__ import annotations

from ..statement import Foreign, Points, Var

_FILE = "control-toolbox/OptimalControlProblems.jl, ext/JuMPModels/{}.jl"
_SUM = "trapezoid rule, cost summed over nodes"

JACKSON = Foreign(
    name="Jackson's reactor",
    source=_FILE.format("jackson"),
    states={
        "a": Var(0.0, 1.1, 1.0, guess=0.1),
        "b": Var(0.0, 1.1, 0.0, guess=0.1),
        "c": Var(0.0, 1.1, 0.0, guess=0.1),
    },
    controls={"u": Var(0.0, 1.0, guess=0.1)},
    rates=lambda x, m: [
        -x.u * (x.a - 10.0 * x.b),
        x.u * (x.a - 10.0 * x.b) - (1.0 - x.u) * x.b,
        (1.0 - x.u) * x.b,
    ],
    cost=lambda x, m: x.c,
    maximise=True,
    final_time=4.0,
    intervals=100,
    linear=True,
    theirs="trapezoid rule",
)

ROBBINS = Foreign(
    name="Robbins, third order",
    source=_FILE.format("robbins"),
    states={
        "x1": Var(0.0, start=1.0, end=0.0, guess=0.1),
        "x2": Var(start=-2.0, end=0.0, guess=0.1),
        "x3": Var(start=0.0, end=0.0, guess=0.1),
    },
    controls={"u": Var(guess=0.1)},
    rates=lambda x, m: [x.x2, x.x3, x.u],
    running=lambda x, m: 3.0 * x.x1 + 0.5 * x.u**2,
    final_time=10.0,
    intervals=100,
    linear=True,
    theirs=_SUM,
)

BEAM = Foreign(
    name="clamped beam",
    source=_FILE.format("beam"),
    states={"x1": Var(0.0, 0.1, 0.0, 0.0, 0.0), "x2": Var(start=1.0, end=-1.0, guess=0.0)},
    controls={"u": Var(-10.0, 10.0, guess=0.0)},
    rates=lambda x, m: [x.x2, x.u],
    running=lambda x, m: x.u**2,
    final_time=1.0,
    intervals=100,
    linear=True,
    theirs=_SUM,
)

ELECTRIC_VEHICLE = Foreign(
    name="electric vehicle",
    source=_FILE.format("electrical_vehicle"),
    states={"x": Var(start=0.0, end=10.0, guess=0.0), "v": Var(start=0.0, end=0.0)},
    controls={"u": Var(guess=0.0)},
    rates=lambda x, m: [x.v, x.u - 1e-3 * x.v**2 - 0.1 - (3.0 + 0.4 * x.x - x.x**2 + 0.1 * x.x**3)],
    running=lambda x, m: 1e3 * x.u * x.v + 1e3 * x.u**2,
    final_time=1.0,
    intervals=100,
    linear=True,
    rule=Points(1),
    theirs=_SUM,
)
