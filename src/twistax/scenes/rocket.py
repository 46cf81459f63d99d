"""A rocket that burns its propellant: decreasing and gimballed thrust, drag and damping."""

import numpy as np

import twistax as tx

from .scene import Scene, about, newton_euler, placed, said, stored_end

#: Change of mass, kg/s.
MASS_FLOW = -0.1
#: Moments of inertia per mass, m2: the tank empties evenly.
RADII_SQUARED = (0.1, 0.8, 0.8)


def system() -> tx.System:
    """States g (pose, body to world, z up, at the centre of mass, x towards the nose), V (body twist), m (mass, kg).

        m v' = m v x w + f,   J w' = (J w) x w + tau - J' w,   J = m diag(k)

    f: thrust F = 30 (1 - 0.02 t) N along x, turned towards y by the gimbal G = 0.02 sin(1.3 t) rad and towards z by
    G cos(t) / 2 (small angles), drag -0.01 |v| v N, and weight. tau: the thrust acts 0.5 m behind the centre of mass;
    0.05 N m of roll; damping -(0.05, 0.3, 0.3) w N m; there are no fins, so that 1 m/s of sideways flight turns the
    nose further away from the velocity with 0.02 N m. The exhaust takes no angular momentum along, so that J' w stays
    with the body.
    """
    g, V, m = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.State("m")
    t, v, w = tx.Time(), tx.lie.linear(V), tx.lie.angular(V)
    k = np.array(RADII_SQUARED)

    F, gimbal = 30.0 * (1.0 - 0.02 * t), 0.02 * tx.Sin(1.3 * t)
    thrust = F * tx.Concat(1.0, gimbal, 0.5 * gimbal * tx.Cos(t))
    # The smallest of speeds keeps the root's derivative finite at rest.
    drag = -0.01 * tx.Sqrt(tx.linalg.Dot(v, v) + 1e-12) * v
    weight = m * (g[:3, :3].T @ np.array([0.0, 0.0, -9.81]))
    air = tx.Concat(0.05, 0.02 * v[2], -0.02 * v[1]) - np.array([0.05, 0.3, 0.3]) * w
    torque = tx.linalg.Cross(np.array([-0.5, 0.0, 0.0]), thrust) + air - MASS_FLOW * k * w

    M = m * tx.Concat(1.0, 1.0, 1.0, k)
    wrench = tx.lie.wrench(force=thrust + drag + weight, torque=torque)
    return tx.System(
        rates={g: V, V: newton_euler(M, V, wrench), m: tx.Constant(MASS_FLOW)},
        outputs={"speed": tx.linalg.Norm(v), "height": g[2, 3]},
    )


ROCKET = Scene(
    **said("rocket"),
    build=system,
    start={
        "g": placed(about((0.0, 1.0, 0.0), -1.4), [0.0, 0.0, 0.0]),
        "V": np.array([5.0, 0.0, 0.0, 0.0, 0.1, 0.0]),
        "m": 2.0,
    },
    duration=10.0,
    reference=stored_end("rocket"),
)
