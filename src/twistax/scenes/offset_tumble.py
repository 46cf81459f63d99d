"""A free body whose frame is not at its centre of mass: translation and rotation are coupled by M (6, 6)."""

from typing import Any

import numpy as np

import twistax as tx
from twistax.mechanics import SpatialInertia

from .free_rotation import TriaxialBody
from .scene import Scene, about, placed, said, total_momentum

#: Mass, kg.
MASS = 2.0
#: Centre of mass in the body's frame, m.
CENTER = np.array([0.3, -0.2, 0.1])
#: Principal moments about the centre of mass, kg m2, and the rotation from principal axes to the body's.
_MOMENTS = np.array([1.0, 1.5, 2.0])
_PRINCIPAL = about((1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0), 0.8)
#: Inertia tensor about the centre of mass in the body's axes, kg m2.
INERTIA = _PRINCIPAL @ np.diag(_MOMENTS) @ _PRINCIPAL.T


#: The inertia (6, 6) of the body, order [v; w].
BODY = SpatialInertia(mass=MASS, center_of_mass=CENTER, inertia=0.5 * (INERTIA + INERTIA.T)).matrix


def system(M: Any = BODY) -> tx.System:
    """g' = g V^ and M V' = -ad*_V(M V). States g (pose, body to world) and V (body twist of the frame's origin).

    Outputs, constant in the true motion: energy, J; linear_momentum (3,), N s, and angular_momentum (3,) about the
    world's origin, N m s, in world axes.
    """
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    return tx.System(
        rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))},
        outputs={"energy": 0.5 * tx.linalg.Dot(V, M @ V), **total_momentum([g], [M @ V])},
    )


_START = {"g": placed(about((1.0, 0.0, 0.0), 0.6), [1.0, -2.0, 0.5]), "V": np.array([0.5, -1.0, 0.3, 2.0, 0.2, 1.5])}
_R0, _v0, _w0 = _START["g"][:3, :3], _START["V"][:3], _START["V"][3:]
_TOP = TriaxialBody(_MOMENTS, _R0 @ _PRINCIPAL, _PRINCIPAL.T @ _w0)


def _exact(t: float) -> dict[str, Any]:
    """The centre of mass goes straight ahead; about it the body is an Euler top in its principal axes."""
    velocity = _R0 @ (_v0 + np.cross(_w0, CENTER))
    center = _START["g"][:3, 3] + _R0 @ CENTER + velocity * t
    R, w = _TOP.at(t)
    R, w = R @ _PRINCIPAL.T, _PRINCIPAL @ w
    return {"g": placed(R, center - R @ CENTER), "V": np.concatenate([R.T @ velocity - np.cross(w, CENTER), w])}


OFFSET_TUMBLE = Scene(
    **said("offset-tumble"),
    build=system,
    start=_START,
    duration=10.0,
    exact=_exact,
    invariants=("energy", "linear_momentum", "angular_momentum"),
)
