"""The Delta III ascent in four phases, and a step of a five-link biped."""

import math
from typing import Any

import numpy as np
from numpy import ndarray as Array

from .statement import Foreign, Phased, Points, Var

# ---- Delta III: lengths in radii of the Earth, speeds in circular ones, masses in those at lift-off ------------------

_MU, _RADIUS, _SPIN = 3.986012e14, 6378145.0, 7.29211585e-5
_SPEED = math.sqrt(_MU / _RADIUS)
_TIME = _RADIUS / _SPEED
_BOOSTER, _FIRST, _SECOND = (17_010.0 / 75.2, 628_500.0), (95_550.0 / 261.0, 1_083_100.0), (16_820.0 / 700.0, 110_094.0)
_WHOLE = 9.0 * 19_290.0 + 104_380.0 + 19_300.0 + 4164.0
_SIX = _WHOLE - 75.2 * (6.0 * _BOOSTER[0] + _FIRST[0]) - 6.0 * 2280.0
_THREE = _SIX - 75.2 * (3.0 * _BOOSTER[0] + _FIRST[0]) - 3.0 * 2280.0
#: Mass at the start, kg, flow, kg/s, thrust, N, and seconds of each phase.
_STAGES = (
    (_WHOLE, 6.0 * _BOOSTER[0] + _FIRST[0], 6.0 * _BOOSTER[1] + _FIRST[1], 75.2),
    (_SIX, 3.0 * _BOOSTER[0] + _FIRST[0], 3.0 * _BOOSTER[1] + _FIRST[1], 75.2),
    (_THREE, *_FIRST, 110.6),
    (23_464.0, *_SECOND, 700.0),
)
_AXIS, _ECCENTRICITY, _TILT, _NODE, _PERIGEE = 24_361_140.0 / _RADIUS, 0.7308, *np.deg2rad([28.5, 269.8, 130.5])


def _at_perigee() -> tuple[Array, Array]:
    """Place and velocity at the perigee of the orbit that is asked for."""
    c, s = np.cos, np.sin
    about_z = lambda angle: np.array([[c(angle), -s(angle), 0.0], [s(angle), c(angle), 0.0], [0.0, 0.0, 1.0]])  # noqa: E731
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c(_TILT), -s(_TILT)], [0.0, s(_TILT), c(_TILT)]])
    R, p = about_z(_NODE) @ about_x @ about_z(_PERIGEE), _AXIS * (1.0 - _ECCENTRICITY**2)
    return R[:, 0] * p / (1.0 + _ECCENTRICITY), R[:, 1] * (1.0 + _ECCENTRICITY) / math.sqrt(p)


def _norm(m: Any, a: Any) -> Any:
    return m.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)


def _cross(a: Any, b: Any) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _pushed(x: Any, m: Any, flow: float, thrust: float) -> list[Any]:
    """Gravity, thrust and drag of an atmosphere that turns with the Earth."""
    r, v, u, spin = [x.r1, x.r2, x.r3], [x.v1, x.v2, x.v3], [x.u1, x.u2, x.u3], _SPIN * _TIME
    wind, mass = [v[0] + spin * r[1], v[1] - spin * r[0], v[2]], _WHOLE * x.m
    size, scale = _norm(m, r), _TIME / _SPEED
    density = 1.225 * m.exp(-(size - 1.0) * _RADIUS / 7200.0)
    drag = 0.25 * 4.0 * math.pi * density * _SPEED**2 * m.sqrt(_dot(wind, wind) + 1e-6 / _SPEED**2)
    forces = [(thrust * a - drag * w) * scale / mass for a, w in zip(u, wind, strict=True)]
    return [*v, *(force - a / size**3 for force, a in zip(forces, r, strict=True)), -flow * _TIME / _WHOLE]


def _orbit(x: Any, m: Any, first: Any) -> list[Any]:
    """Five elements of the orbit at the end."""
    r, v = [x.r1, x.r2, x.r3], [x.v1, x.v2, x.v3]
    h, size = _cross(r, v), _norm(m, r)
    node = [-h[1], h[0], 0.0 * h[0]]
    e = [a - b / size for a, b in zip(_cross(v, h), r, strict=True)]
    return [
        1.0 / (2.0 / size - _dot(v, v)) - _AXIS,
        _norm(m, e) - _ECCENTRICITY,
        h[2] / _norm(m, h) - math.cos(_TILT),
        node[0] / _norm(m, node) - math.cos(_NODE),
        _dot(node, e) / (_norm(m, node) * _norm(m, e)) - math.cos(_PERIGEE),
    ]


def _stage(number: int) -> Foreign:
    begin, flow, thrust, seconds = _STAGES[number]
    latitude = math.radians(28.5)
    start = np.array([math.cos(latitude), 0.0, math.sin(latitude)])
    launch = (start, np.array([0.0, _SPIN * _TIME * start[0], 0.0]))
    place, speed = launch if number < 2 else _at_perigee()
    aim = np.array([0.0, 1.0, 0.0]) if number < 2 else speed / np.linalg.norm(speed)
    after = begin - flow * seconds
    fixed = [*launch[0], *launch[1]] if number == 0 else [None] * 6
    names = [*(f"r{i}" for i in (1, 2, 3)), *(f"v{i}" for i in (1, 2, 3))]
    guesses = [float(a) for a in (*place, *speed)]
    last = number == 3
    return Foreign(
        name=f"stage {number}",
        source="",
        states={
            **{n: Var(start=None if a is None else float(a), guess=g) for n, a, g in zip(names, fixed, guesses)},
            "m": Var(
                4164.0 / _WHOLE if last else -math.inf,
                start=begin / _WHOLE,
                guess=lambda s: (begin + (after - begin) * s) / _WHOLE,
            ),
        },
        controls={f"u{i + 1}": Var(-1.1, 1.1, guess=float(aim[i])) for i in range(3)},
        rates=lambda x, m: _pushed(x, m, flow, thrust),
        cost=(lambda x, m: _WHOLE * x.m) if last else None,
        maximise=last,
        path=lambda x, m: {
            "unit": (1.0, x.u1**2 + x.u2**2 + x.u3**2, 1.0),
            "above the ground": (1.0, x.r1**2 + x.r2**2 + x.r3**2, math.inf),
        },
        ends=_orbit if last else None,
        final_time=(1.0 / _TIME, seconds / _TIME, seconds / _TIME) if last else seconds / _TIME,
        intervals=15,
        linear=True,
        rule=Points(2),
    )


DELTA_III = Phased(
    name="Delta III ascent",
    source="Benson (2005), section 6.2; Betts (2010), example 6.15; yapss, examples/delta_iii_ascent.py",
    published=7529.712287,
    phases=[_stage(number) for number in range(4)],
    theirs="Legendre-Gauss-Lobatto, refined by hand",
)

# ---- a biped ---------------------------------------------------------------------------------------------------------

_MASS, _TURN = np.array([3.2, 6.8, 20.0, 6.8, 3.2]), np.array([0.93, 1.08, 2.22, 1.08, 0.93])
_LINK, _CENTRE = np.array([0.4, 0.4, 0.625, 0.4, 0.4]), np.array([0.128, 0.163, 0.2, 0.163, 0.128])
#: Row i: how much of each link's direction leads from the stance foot to the mass centre of link i.
_TO_CENTRE = np.array(
    [
        [_LINK[0] - _CENTRE[0], 0.0, 0.0, 0.0, 0.0],
        [_LINK[0], _LINK[1] - _CENTRE[1], 0.0, 0.0, 0.0],
        [_LINK[0], _LINK[1], _CENTRE[2], 0.0, 0.0],
        [_LINK[0], _LINK[1], 0.0, -_CENTRE[3], 0.0],
        [_LINK[0], _LINK[1], 0.0, -_LINK[3], -_CENTRE[4]],
    ]
)
_TO_FOOT = np.array([_LINK[0], _LINK[1], 0.0, -_LINK[3], -_LINK[4]])
_COUPLING, _LEVER = _TO_CENTRE.T @ (_MASS[:, None] * _TO_CENTRE), _MASS @ _TO_CENTRE
_LINKS, _STEP, _DURATION = range(5), 0.4, 0.8
_FIRST_POSE = (-0.3, 0.7, 0.0, -0.5, -0.6)


def _each(x: Any, name: str) -> list[Any]:
    return [getattr(x, f"{name}{j}") for j in _LINKS]


def _inertial(m: Any, q: Any, values: Any) -> list[Any]:
    coupled = lambda j: sum(float(_COUPLING[j, k]) * m.cos(q[j] - q[k]) * values[k] for k in _LINKS)  # noqa: E731
    return [coupled(j) + float(_TURN[j]) * values[j] for j in _LINKS]


def _balance(x: Any, m: Any) -> dict[str, tuple[float, Any, float]]:
    """Lagrange's equations; a torque acts between neighbours, the first from the ground."""
    q, w, u = _each(x, "q"), _each(x, "w"), [*_each(x, "u"), 0.0]
    heavy, rows = _inertial(m, q, _each(x, "a")), {}
    for j in _LINKS:
        turning = sum(float(_COUPLING[j, k]) * m.sin(q[j] - q[k]) * w[k] ** 2 for k in _LINKS if k != j)
        weight = 9.81 * float(_LEVER[j]) * m.sin(q[j])
        rows[f"link {j}"] = (0.0, heavy[j] + turning - weight - (u[j] - u[j + 1]), 0.0)
    return rows


def _landed(x: Any, m: Any, first: Any) -> list[Any]:
    """The swing foot lands at a step's length, without slip; what leaves the ground is the old stance foot."""
    q, w = _each(x, "q"), _each(x, "w")
    after = _each(first, "w")[::-1]
    change, foot, push = [a - b for a, b in zip(after, w, strict=True)], [x.sx, x.sy], [x.lx, x.ly]
    directions = [(-m.cos(angle), -m.sin(angle)) for angle in q]
    moved = lambda coefficients, values, axis: sum(  # noqa: E731
        float(coefficients[k]) * directions[k][axis] * values[k] for k in _LINKS if coefficients[k]
    )
    rows = [a - b for a, b in zip(_each(first, "q"), q[::-1], strict=True)]
    rows += [sum(-float(_TO_FOOT[k]) * m.sin(q[k]) for k in _LINKS if _TO_FOOT[k]) - _STEP]
    rows += [sum(float(_TO_FOOT[k]) * m.cos(q[k]) for k in _LINKS if _TO_FOOT[k])]
    rows += [foot[i] + moved(_TO_FOOT, after, i) for i in (0, 1)]
    rows += [float(_MASS.sum()) * foot[i] + moved(_LEVER, change, i) - push[i] for i in (0, 1)]
    heavy = _inertial(m, q, change)
    for j in _LINKS:
        lever, arm = float(_LEVER[j]), float(_TO_FOOT[j])
        rows.append(heavy[j] + sum((lever * foot[i] - arm * push[i]) * directions[j][i] for i in (0, 1)))
    return rows


BIPED = Foreign(
    name="step of a five-link biped",
    source="Kelly, SIAM Review 59 (2017), section 7; OptimTraj, demo/fiveLinkBiped",
    states={
        **{
            f"q{j}": Var(
                -math.pi / 2.0,
                math.pi / 2.0,
                guess=lambda s, a=a, b=b: a + (b - a) * s,
            )
            for j, (a, b) in enumerate(zip(_FIRST_POSE, _FIRST_POSE[::-1], strict=True))
        },
        **{
            f"w{j}": Var(-10.0, 10.0, guess=(b - a) / _DURATION)
            for j, (a, b) in enumerate(zip(_FIRST_POSE, _FIRST_POSE[::-1], strict=True))
        },
    },
    controls={
        **{f"a{j}": Var(guess=0.0) for j in _LINKS},
        **{f"u{j}": Var(-100.0, 100.0, guess=0.0) for j in _LINKS},
    },
    rates=lambda x, m: [*_each(x, "w"), *_each(x, "a")],
    running=lambda x, m: sum(u**2 for u in _each(x, "u")),
    path=_balance,
    ends=_landed,
    free={name: Var(guess=0.0) for name in ("sx", "sy", "lx", "ly")},
    final_time=_DURATION,
    intervals=24,
    linear=True,
    theirs="trapezoid rule",
)
