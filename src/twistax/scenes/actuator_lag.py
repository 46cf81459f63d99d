"""A hovering vehicle whose thrust and gimbals follow their commands within microseconds."""

from __future__ import annotations

from typing import Any

import numpy as np

import twistax as tx

from .arrays import about, placed
from .scene import Scene

__all__ = ["ACTUATOR_LAG", "ARM", "INERTIA", "LAGS", "MASS", "scene", "system"]

#: Mass, kg, principal moments of inertia, kg m2, and how far below the centre of mass the thrust acts, m.
MASS, INERTIA, ARM = 2.0, (0.8, 1.0, 0.3), 0.5


def system() -> tx.System:
    """States g (pose, body to world, z up, at the centre of mass), V (body twist), F (thrust, N), a (2,) (gimbals).

        tau F' = F_c - F,   tau a' = a_c - a,   M V' = W - ad*_V(M V)

    W: the thrust f = F [a; 1] along the body's z, turned by small angles a, ARM below the centre of mass, and weight.
    Commands: F_c = m 9.81 (1 + 0.1 cos(0.7 t)) - 2 v_z N; a_c turns the body's z up and damps its turning,

        a_c = (-0.3 n_x + 0.15 w_y, -0.3 n_y - 0.15 w_x) + 0.02 (sin t, cos 2t),   n = R' e_z.

    Parameter tau, s. Outputs: speed, and tilt, |n - e_z|.
    """
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, a, tau, t = tx.State("F"), tx.State("a", shape=(2,)), tx.Parameter("tau"), tx.Time()
    v, w, n = tx.lie.linear(V), tx.lie.angular(V), g[2, :3]

    thrust = F * tx.Concat(a, 1.0)
    wrench = tx.lie.wrench(force=thrust - 9.81 * MASS * n, torque=tx.linalg.Cross(np.array([0.0, 0.0, -ARM]), thrust))
    # As ad*_V(M V), without the round-off of v x m v, which is zero.
    M, spin = np.array([*3 * (MASS,), *INERTIA]), tx.lie.twist(linear=np.zeros(3), angular=w)
    F_c = 9.81 * MASS * (1.0 + 0.1 * tx.Cos(0.7 * t)) - 2.0 * v[2]
    swing = 0.02 * tx.Concat(tx.Sin(t), tx.Cos(2.0 * t))
    a_c = tx.Concat(0.15 * w[1] - 0.3 * n[0], -0.15 * w[0] - 0.3 * n[1]) + swing
    return tx.System(
        rates={
            g: V,
            V: (wrench - tx.lie.AdjointDual(spin, M * V)) / M,
            F: (F_c - F) / tau,
            a: (a_c - a) / tau,
        },
        outputs={"speed": tx.linalg.Norm(v), "tilt": tx.linalg.Norm(n - np.array([0.0, 0.0, 1.0]))},
    )


#: Values of tau for which the end is known, s.
LAGS = (1e-4, 1e-5, 1e-6)
# fmt: off
#: As `python -m twistax.scenes.references actuator-lag` finds them, by tau.
_ENDS: dict[float, dict[str, Any]] = {
    1e-4: {
        "g": [
            [-0.7182022004329907, -0.6940959780042733, -0.04915661310039242, 4.059057751203069],
            [0.6934610053399847, -0.719794059587599, 0.03175446197405552, -11.749458396419902],
            [-0.05742328243898998, -0.011282069876374378, 0.998286172163692, 9.388643556358797],
            [0.0, 0.0, 0.0, 1.0],
        ],
        "V": [-2.064714653956661, 1.2897687893469338, -0.8882551280846477, -0.1176724115423568, 0.0935360240733081,
              0.4808286701919628],
        "F": 19.55912305785895,
        "a": [0.01207671842711979, 0.004250549595674939],
    },
    1e-5: {
        "g": [
            [-0.7182044703221406, -0.6940942104421494, -0.049148406281206605, 4.059758572535087],
            [0.6934591190218211, -0.7197958600872009, 0.0317548428874473, -11.749760195583702],
            [-0.05741767197277353, -0.011275940404950184, 0.9982865641253572, 9.389531323493651],
            [0.0, 0.0, 0.0, 1.0],
        ],
        "V": [-2.064764855768933, 1.2897681932679677, -0.8882167236274707, -0.11766033477876497, 0.0935183595251376,
              0.48082608436334184],
        "F": 19.559099509476358,
        "a": [0.012074351644132602, 0.004250051542199786],
    },
    1e-6: {
        "g": [
            [-0.7182046974219222, -0.6940940335557954, -0.04914758573248136, 4.059828653822395],
            [0.6934589302614738, -0.719796040258484, 0.03175488102354128, -11.74979037205049],
            [-0.0574171110532186, -0.01127532750979899, 0.9982866033098156, 9.38962009868934],
            [0.0, 0.0, 0.0, 1.0],
        ],
        "V": [-2.064769876274757, 1.2897681346089327, -0.888212883619709, -0.1176591270738713, 0.09351659345177761,
              0.48082582589154926],
        "F": 19.559097155048175,
        "a": [0.012074115002738809, 0.004250001711405589],
    },
}
# fmt: on


def scene(lag: float = 1e-5) -> Scene:
    """The scene with this tau, s. The true end is known for those of `LAGS`."""
    return Scene(
        name="actuator-lag",
        title="stiff actuators",
        summary=(
            "A vehicle of 2 kg hovers for 5 s on a thrust whose size and direction follow their commands within "
            f"{lag:.0e} s: the vehicle moves in seconds, its actuators start from rest."
        ),
        source="written for this scene; Newton-Euler with first-order lags",
        build=system,
        start={
            "g": placed(about((0.6, 0.8, 0.0), 0.3), [0.0, 0.0, 10.0]),
            "V": np.array([1.0, -0.5, 0.2, 0.1, -0.2, 0.5]),
            "F": 0.0,
            "a": np.zeros(2),
        },
        duration=5.0,
        params={"tau": lag},
        reference=_ENDS.get(lag),
    )


ACTUATOR_LAG = scene()
