"""Inertias, masses and places far from one, and a million steps."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

import twistax as tx

from ...integrators import Method
from ...scenes import SCENES, heavy_top, offset_tumble
from ...scenes.free_rotation import SymmetricBody
from ...scenes.scene import about, rotation_angle
from ..checks import Check, Expected, Section, at_most, either, ends, simulated
from ..figures.keeping import Motion, changes, constant_twist, free_body, spatial_inertia, top
from ..rows import plain

_DOP853 = tx.RKMK(tx.tableaus.DOP853)
_TUMBLE = SCENES["offset-tumble"]
_START = about((1.0, 0.0, 0.0), 0.6)
_NEEDLE, _FLYWHEEL = (1.0, 1e-12, (0.3, 0.2, 2.0)), (1e-12, 1.0, (1e-9, 0.0, 3e-12))


@functools.cache
def _spinner(differences: bool) -> tx.Dynamics:
    """A free body with moments that are a parameter; J w x w as it is, or with the differences of moments in front."""
    R, w, J = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Parameter("J", shape=(3,))
    torque: tx.Expr = tx.linalg.Cross(J * w, w)
    if differences:
        torque = tx.Concat((J[1] - J[2]) * w[1] * w[2], (J[2] - J[0]) * w[2] * w[0], (J[0] - J[1]) * w[0] * w[1])
    return tx.compile(tx.System(rates={R: w, w: torque / J}))


def _spun(transverse: float, axial: float, w: tuple[float, float, float], differences: bool = False) -> float:
    """The error of a symmetric body after 10 s, rad."""
    rate = np.array(w)
    params = {"J": np.array([transverse, transverse, axial])}
    sol = simulated(_spinner(differences), {"R": _START, "w": rate}, t1=10.0, params=params, rtol=1e-11, method=_DOP853)
    R, _ = SymmetricBody(transverse, axial, _START, rate).at(10.0)
    return rotation_angle(R, np.asarray(sol.xs["R"][-1]))


@functools.cache
def _tumbler() -> tx.Dynamics:
    """A free body whose frame is off its centre of mass, with an inertia (6, 6) that is a parameter."""
    g, V, M = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.Parameter("M", shape=(6, 6))
    return tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))}))


def _tumbled(mass: float, offset: float) -> tuple[float, float]:
    """The errors of rotation, rad, and position, m, of the scene offset-tumble with another mass and place."""
    M = spatial_inertia(offset_tumble.MASS, offset_tumble.CENTER, offset_tumble.INERTIA)
    shift = np.zeros((4, 4))
    shift[:3, 3] = offset
    start, params = {**_TUMBLE.start, "g": _TUMBLE.start["g"] + shift}, {"M": mass / offset_tumble.MASS * M}
    sol = simulated(_tumbler(), start, t1=_TUMBLE.duration, params=params, dt=0.02, method=_DOP853)
    wanted, found = _TUMBLE.end["g"] + shift, np.asarray(sol.xs["g"][-1])
    return rotation_angle(wanted[:3, :3], found[:3, :3]), float(np.linalg.norm(wanted[:3, 3] - found[:3, 3]))


def _dop853(what: str, measure: Callable[[], float], expected: Expected, slow: bool = True) -> Check:
    return Check(what, "DOP853", measure, expected, slow)


_TIGHT = at_most(1e-9, "rad")

EXTREMES = Section(
    "extremes",
    [
        "With the differences of moments in front, the ratio enters as a factor alone.",
        Check(
            "a needle: moments 1, 1 and 1e-12 kg m2, torque ((J1 - J2) w1 w2, ..), rtol 1e-11",
            "DOP853",
            lambda: _spun(*_NEEDLE, differences=True),
            _TIGHT,
        ),
        (
            "J1 w1 w2 - J2 w2 w1 leaves round-off of 1e-17 N m where products are fused, 1e-5 rad/s2 for a needle. "
            "The integration sees the noise, and runs out of steps rather than go wrong."
        ),
        Check(
            "the same needle, torque J w x w",
            "DOP853",
            lambda: _spun(*_NEEDLE),
            either(_TIGHT, ends(tx.Result.MAX_STEPS)),
        ),
        "The ratio makes rates of 1e-12 rad/s into a nutation of 3 rad/s; no true body is so flat.",
        Check("a flywheel: moments 1e-12, 1e-12 and 1 kg m2, rtol 1e-11", "DOP853", lambda: _spun(*_FLYWHEEL), _TIGHT),
        "The motion of a free body does not depend on its mass, and no tolerance or threshold here does.",
        *(
            _dop853(
                f"mass {plain(mass)} kg, equal steps of 0.02 s",
                lambda mass=mass: max(_tumbled(mass, 0.0)),  # type: ignore[misc]
                at_most(1e-11, "rad or m"),
            )
            for mass in (1e-9, 1e-3, 1e3, 1e12)
        ),
        "The rotation does not feel where the body is.",
        _dop853("rotation of a body 1.7e9 m from the origin", lambda: _tumbled(2.0, 1e9)[0], at_most(1e-11, "rad")),
        "A double resolves 1e-7 m there; round-off of 500 steps adds up.",
        _dop853(
            "position of a body 1.7e9 m from the origin, 500 steps", lambda: _tumbled(2.0, 1e9)[1], at_most(3e-5, "m")
        ),
    ],
)


# ---- a million steps ------------------------------------------------------------------------------------------------

_FEW, _MANY = (1_000, 10_000), (100_000, 1_000_000)
_RK4 = tx.RKMK(tx.tableaus.RK4)
_SPLITTING = tx.Splitting(tx.compositions.KAHAN_LI8, tx.FreeBody("R", "w", inertia=heavy_top.INERTIA))
_BY = {_RK4: "RK4", _DOP853: "DOP853", _SPLITTING: "Kahan-Li 8 splitting"}
_ROUND_OFF = at_most(1e-14)


def _runs(
    motion: Callable[[], Motion], name: str, method: Method, dt: float, few: Expected, many: Expected, slow: bool = True
) -> list[Check]:
    """Changes after each number of steps; the bars are for up to 1e4 and up to 1e6 of them."""
    what = f"{name}, {motion.__name__.replace('_', ' ').replace('top', 'heavy top')}"

    def check(counts: tuple[int, ...], count: int, bar: Expected) -> Check:
        measure = lambda: changes(motion(), method, dt, counts)[name].absolute[counts.index(count)]  # noqa: E731
        place = f"{what}, {_BY[method]}", float(count)
        return Check(f"{what}, {plain(float(count))} steps", _BY[method], measure, bar, slow or counts is _MANY, place)

    return [check(counts, count, bar) for counts, bar in ((_FEW, few), (_MANY, many)) for count in counts]


LONG_RUNS = Section(
    "long",
    [
        "A quaternion put back to length one in every step cannot drift, even where every step rounds alike.",
        *_runs(constant_twist, "R'R - I", _RK4, 1e-2, _ROUND_OFF, _ROUND_OFF),
        "A method without structure loses energy in every step: the drift is linear, and that of its order.",
        *_runs(free_body, "energy", _RK4, 1e-2, at_most(5e-7, "J"), at_most(5e-5, "J")),
        "The same for momentum, which lives in the body's axes here.",
        *_runs(free_body, "linear momentum", _RK4, 1e-2, at_most(1e-5, "N s"), at_most(1e-3, "N s")),
        "Short steps lose little, in every one of them.",
        *_runs(top, "energy", _RK4, 1e-3, at_most(1e-11, "J"), at_most(1e-9, "J"), slow=False),
        "At order eight the drift of a million steps is near round-off.",
        *_runs(top, "energy", _DOP853, 1e-2, at_most(5e-13, "J"), at_most(5e-11, "J"), slow=False),
        "A symplectic method has no drift of its own; what grows is round-off, some 1e-16 J a step.",
        *_runs(top, "energy", _SPLITTING, 1e-2, at_most(2e-11, "J"), at_most(2e-9, "J")),
        "Momenta are stored in world axes: what no torque changes stays to the last bit or two.",
        *_runs(top, "vertical momentum", _SPLITTING, 1e-2, at_most(1e-14, "N m s"), at_most(1e-14, "N m s")),
        "The group is kept as by every method here.",
        *_runs(top, "R'R - I", _SPLITTING, 1e-2, _ROUND_OFF, _ROUND_OFF),
    ],
    axes=("steps", "change since the start"),
)
