"""A chain of masses, and heat conduction along a rod by the method of lines."""

import itertools
import math
from typing import Any

from .statement import Foreign, Points, RungeKutta, Var

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
    source="Betts (2010), example 4.6.10; PSOPT, examples/heat/heat.cxx",
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
