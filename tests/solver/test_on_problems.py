"""The core finds what `tx.trajectory.Problem` finds, on the transcription that it solves itself."""

import numpy as np
import pytest
from transcribed_stages import ByCore

import twistax as tx


def pole() -> tx.trajectory.Problem:
    """A pole on a cart swings up; held controls, RK4."""
    q, v, u = tx.State("q", shape=(2,)), tx.State("v", shape=(2,)), tx.Control("u", min=-20.0, max=20.0)
    s, c = tx.Sin(q[1]), tx.Cos(q[1])
    d = 1 + 0.3 * s * s
    cart = (0.15 * s * v[1] ** 2 + u + 0.3 * 9.81 * c * s) / d
    angle = -(0.15 * c * s * v[1] ** 2 + u * c + 1.3 * 9.81 * s) / (0.5 * d)
    dynamics = tx.compile(tx.System(rates={q: v, v: tx.Concat(cart, angle)}))
    ends = {"initial": {q: [0.0, 0.0], v: [0.0, 0.0]}, "final": {q: [1.0, np.pi], v: [0.0, 0.0]}}
    return tx.trajectory.Problem(dynamics, tx.Minimize(running=u**2), nodes=31, final_time=2.0, **ends)


def turn() -> tx.trajectory.Problem:
    """A rotation of an asymmetric body with least effort, in a free time that costs."""
    inertia = np.array([1.0, 2.0, 3.0])
    rotation, rate = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    torque = tx.Control("u", shape=(3,), min=-2.0, max=2.0)
    moved = (torque - tx.linalg.Cross(rate, inertia * rate)) / inertia
    dynamics = tx.compile(tx.System(rates={rotation: rate, rate: moved}))
    goal = np.asarray(tx.lie.so3.exp(np.array([0.7, -1.2, 0.9])))
    ends = {"initial": {rotation: np.eye(3), rate: np.zeros(3)}, "final": {rotation: goal, rate: [0.0, 0.2, 0.0]}}
    objective = tx.Minimize(tx.Time(), running=torque @ torque)
    return tx.trajectory.Problem(dynamics, objective, nodes=11, final_time=(1.0, 9.0), **ends)


@pytest.mark.parametrize("make", [pole, turn])
def test_the_same_optimum(make: object) -> None:
    problem = make()
    usual, by_core = problem.solve(), problem.solve(solver=ByCore())
    assert usual.status is by_core.status is tx.trajectory.Status.SOLVED
    assert by_core.cost == pytest.approx(usual.cost, rel=1e-6)
    assert by_core.iterations <= 40
