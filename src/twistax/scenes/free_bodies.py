"""Free rigid bodies: the Euler top, a symmetric body in nutation, and one that spins 160 times per second.

Attitude R on SO(3), body to world, and angular velocity w in body axes.
"""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

import twistax as tx

from .free_rotation import SymmetricBody, TriaxialBody
from .scene import Scene, about, said


def system(inertia: Sequence[float] | tx.Parameter) -> tx.System:
    """R' = R [w]x and J w' = (J w) x w with J = diag(inertia), kg m2. States R and w (3,), rad/s.

    Outputs, constant in the true motion: energy, J; momentum (3,), in world axes, N m s.
    """
    J: Any = inertia if isinstance(inertia, tx.Parameter) else np.array(inertia, dtype=float)
    R = tx.State("R", group=tx.SO3, kind=tx.kinds.Rotation("world", "body"))
    w = tx.State("w", shape=(3,), kind=tx.FreeVector("body"), unit="rad/s")
    L = J * w
    return tx.System(
        rates={R: w, w: tx.linalg.Cross(L, w) / J}, outputs={"energy": 0.5 * tx.linalg.Dot(w, L), "momentum": R @ L}
    )


def _scene(name: str, duration: float, body: SymmetricBody | TriaxialBody) -> Scene:
    return Scene(
        **said(name),
        build=functools.partial(system, tuple(body.inertia)),
        start={"R": body.rotation, "w": body.rate},
        exact=lambda t: dict(zip(("R", "w"), body.at(t))),
        invariants=("energy", "momentum"),
        duration=duration,
    )


EULER_TOP = _scene(
    "euler-top", 20.0, TriaxialBody(np.array([1.0, 2.0, 3.0]), about((1.0, 0.0, 0.0), 0.6), np.array([2.0, 0.0, 1.5]))
)

SYMMETRIC_BODY = _scene(
    "symmetric-body", 20.0, SymmetricBody(1.0, 1.5, about((1.0, 0.0, 0.0), 0.6), np.array([0.6, -0.4, 3.0]))
)

#: A relative error of 1e-16 in the angular velocity is an angle of 1e-12 rad at the end.
FAST_SPIN = _scene(
    "fast-spin", 10.0, SymmetricBody(1.0, 1.5, about((1.0, 0.0, 0.0), 0.6), np.array([10.0, 0.0, 1000.0]))
)
