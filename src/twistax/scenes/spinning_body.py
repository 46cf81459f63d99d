"""A rigid body that turns without torque: attitude R on SO(3), body to world, and angular velocity w in body axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import twistax as tx

__all__ = ["system"]


def system(inertia: Sequence[float]) -> tx.System:
    """R' = R [w]x and J w' = (J w) x w with J = diag(inertia), kg m2. States R and w (3,), rad/s.

    Outputs, constant in a true flight: energy, J; momentum (3,), in world axes, N m s.
    """
    J = np.array(inertia, dtype=float)
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    L = J * w
    return tx.System(
        rates={R: w, w: tx.linalg.Cross(L, w) / J},
        outputs={"energy": 0.5 * tx.linalg.Dot(w, L), "momentum": R @ L},
    )
