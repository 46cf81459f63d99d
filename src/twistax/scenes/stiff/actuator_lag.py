"""A hovering vehicle whose thrust and gimbals follow their commands within microseconds."""

import numpy as np

import twistax as tx

from ..scene import Scene, about, newton_euler, placed, said, stored_end

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
    F_c = 9.81 * MASS * (1.0 + 0.1 * tx.Cos(0.7 * t)) - 2.0 * v[2]
    swing = 0.02 * tx.Concat(tx.Sin(t), tx.Cos(2.0 * t))
    a_c = tx.Concat(0.15 * w[1] - 0.3 * n[0], -0.15 * w[0] - 0.3 * n[1]) + swing
    return tx.System(
        rates={
            g: V,
            V: newton_euler(np.array([*3 * (MASS,), *INERTIA]), V, wrench),
            F: (F_c - F) / tau,
            a: (a_c - a) / tau,
        },
        outputs={"speed": tx.linalg.Norm(v), "tilt": tx.linalg.Norm(n - np.array([0.0, 0.0, 1.0]))},
    )


#: Values of tau for which the end is known, s.
LAGS = (1e-4, 1e-5, 1e-6)


def scene(lag: float = 1e-5) -> Scene:
    """The scene with this tau, s. The exact final state is known for those of `LAGS`."""
    return Scene(
        **said("actuator-lag", lag=f"{lag:.0e}"),
        build=system,
        start={
            "g": placed(about((0.6, 0.8, 0.0), 0.3), [0.0, 0.0, 10.0]),
            "V": np.array([1.0, -0.5, 0.2, 0.1, -0.2, 0.5]),
            "F": 0.0,
            "a": np.zeros(2),
        },
        duration=5.0,
        params={"tau": lag},
        reference=stored_end("actuator-lag", tau=lag),
    )


ACTUATOR_LAG = scene()
