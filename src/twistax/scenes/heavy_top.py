"""The Lagrange top: a symmetric body that turns about a fixed point on its axis, under gravity."""

from __future__ import annotations

import dataclasses

import numpy as np

import twistax as tx

from .lagrange_top import LagrangeTop
from .scene import Scene, about, stored_end

#: Moments of inertia about the fixed point, kg m2.
INERTIA = (1.0, 1.0, 0.5)
#: Weight times the distance of the centre of mass, which lies on the axis above the fixed point, N m.
MOMENT = 2.0


def system() -> tx.System:
    """R' = R [w]x and J w' = (J w) x w + (R' e_z) x (MOMENT e_z). States R (body to world, z up) and w (3,), rad/s.

    Outputs, constant in the true motion: energy, J; vertical_momentum and axial_momentum, N m s.
    """
    J = np.array(INERTIA)
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    L, up = J * w, R[2]
    return tx.System(
        rates={R: w, w: (tx.linalg.Cross(L, w) + tx.linalg.Cross(up, np.array([0.0, 0.0, MOMENT]))) / J},
        outputs={
            "energy": 0.5 * tx.linalg.Dot(w, L) + MOMENT * R[2, 2],
            "vertical_momentum": up @ L,
            "axial_momentum": L[2],
        },
    )


HEAVY_TOP = Scene(
    name="heavy-top",
    title="heavy top",
    summary=(
        "A top with moments 1, 1 and 0.5 kg m2 about its tip spins at 8 rad/s for 20 s, leaning by 0.6 rad: slow "
        "precession and quick nutation at once."
    ),
    source="Landau and Lifshitz, Mechanics, section 35, problem 1 (Lagrange's top)",
    build=system,
    start={"R": about((1.0, 0.0, 0.0), 0.6), "w": np.array([0.3, 0.1, 8.0])},
    duration=20.0,
    reference=stored_end("heavy-top"),
    invariants=("energy", "vertical_momentum", "axial_momentum"),
)

_TOP = LagrangeTop(INERTIA[0], INERTIA[2], MOMENT, HEAVY_TOP.start["R"], HEAVY_TOP.start["w"])

LONG_HEAVY_TOP = dataclasses.replace(
    HEAVY_TOP,
    name="long-heavy-top",
    title="heavy top for long",
    summary=(
        "The same top for 1000 s, a million steps of 1 ms: it turns by 8000 rad, so that what a step loses in energy "
        "or momentum shows as an angle that grows with the square of the time."
    ),
    duration=1e3,
    reference=None,
    exact=lambda t: dict(zip(("R", "w"), _TOP.at(t))),
)
