"""Problems of acados' examples, and the chain of masses that its authors use."""

from __future__ import annotations

import itertools
import math
from typing import Any

from ..statement import Foreign, RungeKutta, Var

CRANE_INTERVALS = Foreign(
    name="crane with free interval lengths",
    source="acados, examples/acados_python/crane/time_optimal_example.py",
    states={
        "p1": Var(start=2.0, end=0.0),
        "v1": Var(start=0.0, end=0.0),
        "p2": Var(start=2.0, end=0.0),
        "v2": Var(start=0.0, end=0.0),
    },
    controls={"a": Var(-10.0, 10.0, guess=0.1), "dt": Var(1e-3, 2.0, guess=0.5)},
    rates=lambda x, m: [x.dt * x.v1, x.dt * x.a, x.dt * x.v2, x.dt * (-0.001 * x.v2 - 0.9 * (x.p2 - x.p1))],
    running=lambda x, m: x.dt,
    final_time=7.0,
    intervals=7,
    rule=RungeKutta(15),
)


def _furuta(x: Any, m: Any) -> list[Any]:
    inertia, arm, coupling = 7.653e-4 + 0.192 * 0.0955**2, 6.1375e-4 + 0.192 * 0.1035**2, 0.192 * 0.1035 * 0.0955
    s, c, double = -m.sin(x.th2), -m.cos(x.th2), m.sin(2.0 * x.th2)
    mass, cross = arm + inertia * s**2, coupling * c
    first = x.tau - (40e-4 + inertia * x.w2 * double / 2.0) * x.w1
    first -= (inertia * x.w1 * double / 2.0 - coupling * s * x.w2) * x.w2
    second = inertia * x.w1**2 * double / 2.0 - 2.0 * 0.098 * inertia * x.w2 - 9.81 * 0.192 * 0.0955 * s
    det = mass * inertia - cross**2
    return [x.w1, x.w2, (inertia * first - cross * second) / det, (mass * second - cross * first) / det]


FURUTA = Foreign(
    name="Furuta pendulum, first problem of a controller",
    source="acados, examples/acados_python/furuta_pendulum/furuta_common.py",
    states={
        "th1": Var(start=0.0),
        "th2": Var(start=math.pi),
        "w1": Var(start=0.0),
        "w2": Var(start=0.0),
    },
    controls={"tau": Var(-0.45, 0.45, guess=0.0)},
    rates=_furuta,
    running=lambda x, m: 25.0 * x.th1**2 + 250.0 * x.th2**2 + 0.5 * (x.w1**2 + x.w2**2) + 500.0 * x.tau**2,
    cost=lambda x, m: 25.0 * x.th1**2 + 250.0 * x.th2**2 + 0.5 * (x.w1**2 + x.w2**2),
    final_time=0.35,
    intervals=8,
    nodes=[0.0, *(0.025 / 0.35 + (0.325 / 0.35) * k / 7.0 for k in range(7)), 1.0],
    rule=RungeKutta(2),
    theirs="one step in the first interval, cost at the beginning of intervals",
)


def _cart(x: Any, m: Any) -> list[Any]:
    s, c = m.sin(x.th), m.cos(x.th)
    below = 1.1 - 0.1 * c**2
    cart = (-0.08 * s * x.w**2 + 0.981 * c * s + x.F) / below
    return [x.v, x.w, cart, (-0.08 * c * s * x.w**2 + x.F * c + 1.1 * 9.81 * s) / (0.8 * below)]


PENDULUM = Foreign(
    name="pendulum on a cart",
    source="acados, examples/acados_python/getting_started/minimal_example_ocp.py",
    states={"p": Var(start=0.0), "th": Var(start=math.pi), "v": Var(start=0.0), "w": Var(start=0.0)},
    controls={"F": Var(-80.0, 80.0, guess=0.0)},
    rates=_cart,
    running=lambda x, m: 2e3 * (x.p**2 + x.th**2) + 2e-2 * (x.v**2 + x.w**2 + x.F**2),
    cost=lambda x, m: 2e3 * (x.p**2 + x.th**2) + 2e-2 * (x.v**2 + x.w**2),
    final_time=1.0,
    intervals=20,
    rule=RungeKutta(2),
    theirs="an implicit integrator, cost at the beginning of intervals",
)

_MASSES, _AXES = 4, "xyz"


def _pulled(x: Any, m: Any) -> list[Any]:
    """Masses on springs between the wall at the origin and an end that is led."""
    at = lambda k: [getattr(x, f"{axis}{k}") for axis in _AXES]  # noqa: E731
    places: list[Any] = [[0.0] * 3, *map(at, range(_MASSES)), [x.ex, x.ey, x.ez]]
    pulls = []
    for one, other in itertools.pairwise(places):
        offset = [b - a for a, b in zip(one, other, strict=True)]
        length = m.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
        pulls.append([(1.0 - 0.033 / length) * d for d in offset])
    speeds = [getattr(x, f"v{axis}{k}") for k in range(_MASSES) for axis in _AXES]
    falls = [
        (after - before) / 0.033 - 9.81 * (axis == 2)
        for one, other in itertools.pairwise(pulls)
        for axis, (before, after) in enumerate(zip(one, other, strict=True))
    ]
    return [*speeds, *falls, x.ux, x.uy, x.uz]


def _unrest(x: Any) -> Any:
    speeds = sum(getattr(x, f"v{axis}{k}") ** 2 for k in range(_MASSES) for axis in _AXES)
    return 25.0 * ((x.ex - 1.0) ** 2 + x.ey**2 + x.ez**2) + speeds + 0.01 * (x.ux**2 + x.uy**2 + x.uz**2)


_LINE = {(axis, k): (k + 1.0) / (_MASSES + 1.0) if axis == "x" else 0.0 for k in range(_MASSES) for axis in _AXES}

CHAIN = Foreign(
    name="chain of four masses",
    source="Wirsching, Bock, Diehl, Fast NMPC of a chain of masses connected by springs (2006)",
    states={
        **{f"{axis}{k}": Var(start=at) for (axis, k), at in _LINE.items()},
        **{f"v{axis}{k}": Var(start=0.0) for axis, k in _LINE},
        "ex": Var(start=1.0),
        "ey": Var(start=0.5),
        "ez": Var(start=0.0),
    },
    controls={f"u{axis}": Var(-1.0, 1.0, guess=0.0) for axis in _AXES},
    rates=_pulled,
    running=lambda x, m: _unrest(x),
    final_time=4.0,
    intervals=20,
    rule=RungeKutta(2),
    theirs="nine masses, a horizon of a controller",
)
