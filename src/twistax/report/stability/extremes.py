"""Inertias, masses and places far from one."""

from __future__ import annotations

import functools

import numpy as np

import twistax as tx

from ...scenes import SCENES, offset_tumble
from ...scenes.free_rotation import SymmetricBody
from ...scenes.scene import about, cross_matrix, rotation_angle
from ..checks import Check, Either, Ends, Section, at_most, simulated
from ..rows import plain

__all__ = ["EXTREMES"]

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
    m, c = offset_tumble.MASS, cross_matrix(offset_tumble.CENTER)
    M = np.block([[m * np.eye(3), -m * c], [m * c, offset_tumble.INERTIA - m * c @ c]])
    shift = np.zeros((4, 4))
    shift[:3, 3] = offset
    start = {"g": _TUMBLE.start["g"] + shift, "V": _TUMBLE.start["V"]}
    params = {"M": mass / m * M}
    sol = simulated(_tumbler(), start, t1=_TUMBLE.duration, params=params, dt=0.02, method=_DOP853)
    wanted, found = _TUMBLE.end["g"] + shift, np.asarray(sol.xs["g"][-1])
    return rotation_angle(wanted[:3, :3], found[:3, :3]), float(np.linalg.norm(wanted[:3, 3] - found[:3, 3]))


_TIGHT = at_most(1e-9, "rad")

EXTREMES = Section(
    "extremes",
    "Inertias, masses and places",
    "Free bodies with closed forms: a symmetric body, after 10 s, and the scene offset-tumble with its inertia (6, 6) "
    "scaled and its start moved.",
    {
        "With the differences of moments in front, the ratio enters as a factor alone.": [
            Check(
                "a needle: moments 1, 1 and 1e-12 kg m2, torque ((J1 - J2) w1 w2, ..), rtol 1e-11",
                "DOP853",
                lambda: _spun(*_NEEDLE, differences=True),
                _TIGHT,
            ),
        ],
        "J1 w1 w2 - J2 w2 w1 leaves round-off of 1e-17 N m where products are fused, 1e-5 rad/s2 for a needle. "
        "The integration sees the noise, and runs out of steps rather than go wrong.": [
            Check(
                "the same needle, torque J w x w",
                "DOP853",
                lambda: _spun(*_NEEDLE),
                Either(_TIGHT, Ends(tx.Result.MAX_STEPS)),
            ),
        ],
        "The ratio makes rates of 1e-12 rad/s into a nutation of 3 rad/s; no true body is so flat.": [
            Check(
                "a flywheel: moments 1e-12, 1e-12 and 1 kg m2, rtol 1e-11", "DOP853", lambda: _spun(*_FLYWHEEL), _TIGHT
            ),
        ],
        "The motion of a free body does not depend on its mass, and no tolerance or threshold here does.": [
            Check(
                f"mass {plain(mass)} kg, equal steps of 0.02 s",
                "DOP853",
                lambda mass=mass: max(_tumbled(mass, 0.0)),  # type: ignore[misc]
                at_most(1e-11, "rad or m"),
                slow=True,
            )
            for mass in (1e-9, 1e-3, 1e3, 1e12)
        ],
        "The rotation does not feel where the body is.": [
            Check(
                "rotation of a body 1.7e9 m from the origin",
                "DOP853",
                lambda: _tumbled(2.0, 1e9)[0],
                at_most(1e-11, "rad"),
                slow=True,
            ),
        ],
        "A double resolves 1e-7 m there; round-off of 500 steps adds up.": [
            Check(
                "position of a body 1.7e9 m from the origin, 500 steps",
                "DOP853",
                lambda: _tumbled(2.0, 1e9)[1],
                at_most(3e-5, "m"),
                slow=True,
            ),
        ],
    },
)
