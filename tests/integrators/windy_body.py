"""A body for the tests of kernels: pose, twist and mass, a control, a parameter and the time all matter."""

import numpy as np

import twistax as tx

START = {"g": np.eye(4), "V": np.array([1.0, 0.5, -0.3, 0.4, 1.2, -0.7]), "m": np.array(2.0)}
U = {"F": np.array([1.0, -2.0, 0.5])}


def windy_body() -> tx.System:
    """A body that loses mass, pushed by a control, in wind that changes with time."""
    g, V, m = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.State("m")
    F, J, t = tx.Control("F", shape=(3,)), tx.Parameter("J", shape=(3,), value=np.array([1.0, 2.0, 3.0])), tx.Time()
    v, w = V[:3], V[3:]
    push = (F + 0.1 * tx.Sin(3.0 * t) * v) / m
    down = g[:3, :3].T @ np.array([0.0, 0.0, -9.81])
    return tx.System(
        rates={g: V, V: tx.Concat(push + down - tx.linalg.Cross(w, v), tx.linalg.Cross(J * w, w) / J), m: -0.05 * m}
    )
