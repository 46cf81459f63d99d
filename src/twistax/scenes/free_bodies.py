"""Free rigid bodies: the Euler top, a symmetric body that wobbles, and one that spins 160 times a second.

Attitude R on SO(3), body to world, and angular velocity w in body axes.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

import twistax as tx

from .free_rotation import SymmetricBody, TriaxialBody
from .scene import Scene, about


def system(inertia: Sequence[float] | tx.Parameter) -> tx.System:
    """R' = R [w]x and J w' = (J w) x w with J = diag(inertia), kg m2. States R and w (3,), rad/s.

    Outputs, constant in the true motion: energy, J; momentum (3,), in world axes, N m s.
    """
    J: Any = inertia if isinstance(inertia, tx.Parameter) else np.array(inertia, dtype=float)
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    L = J * w
    return tx.System(
        rates={R: w, w: tx.linalg.Cross(L, w) / J}, outputs={"energy": 0.5 * tx.linalg.Dot(w, L), "momentum": R @ L}
    )


def _scene(body: SymmetricBody | TriaxialBody, **said: Any) -> Scene:
    return Scene(
        build=functools.partial(system, tuple(body.inertia)),
        start={"R": body.rotation, "w": body.rate},
        exact=lambda t: dict(zip(("R", "w"), body.at(t))),
        invariants=("energy", "momentum"),
        **said,
    )


EULER_TOP = _scene(
    TriaxialBody(np.array([1.0, 2.0, 3.0]), about((1.0, 0.0, 0.0), 0.6), np.array([2.0, 0.0, 1.5])),
    name="euler-top",
    title="Euler top",
    summary=(
        "A free body with moments 1, 2 and 3 kg m2 tumbles for 20 s: the angular velocity changes direction and size "
        "all the time, so that no two steps commute."
    ),
    source="Landau and Lifshitz, Mechanics, section 37",
    duration=20.0,
)

SYMMETRIC_BODY = _scene(
    SymmetricBody(1.0, 1.5, about((1.0, 0.0, 0.0), 0.6), np.array([0.6, -0.4, 3.0])),
    name="symmetric-body",
    title="free symmetric body",
    summary=(
        "A free body with moments 1, 1 and 1.5 kg m2 spins at 3 rad/s and wobbles for 20 s: precession and spin are "
        "both steady, so that the phase of each shows every error."
    ),
    source="Landau and Lifshitz, Mechanics, section 33",
    duration=20.0,
)

#: A relative error of 1e-16 in the angular velocity is an angle of 1e-12 rad at the end.
FAST_SPIN = _scene(
    SymmetricBody(1.0, 1.5, about((1.0, 0.0, 0.0), 0.6), np.array([10.0, 0.0, 1000.0])),
    name="fast-spin",
    title="fast spin",
    summary=(
        "A free body with moments 1, 1 and 1.5 kg m2 spins at 1000 rad/s for 10 s: it turns by 1.5e4 rad about its "
        "momentum, and round-off in the rate alone is worth some 1e-12 rad of attitude."
    ),
    source="Landau and Lifshitz, Mechanics, section 33",
    duration=10.0,
)
