"""States on a manifold: the core sees tangent steps, the functions move points."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray as Array
from python_functions import PythonFunctions

import twistax as tx
from twistax.solver import CoreSolution, CoreStatus, Options, Stages, solve

so3 = tx.lie.so3
INTERVALS = 10
GOAL = np.asarray(so3.exp(jnp.array([0.9, -1.1, 1.4])))


H, ZERO = 1.0 / INTERVALS, jnp.zeros(3)


def defect(d: Any, u: Any, rotation: Any, after: Any, drift: Any) -> Any:
    return so3.log(after.T @ rotation @ so3.exp(d) @ so3.exp(H * (u + drift)))


def end(d: Any, rotation: Any) -> Any:
    return so3.log(GOAL.T @ rotation @ so3.exp(d))


def rows(u: Any, r: Any, a: Any, drift: Any) -> Any:
    """c = log(exp(-d_next) y) has the derivative -J_l(c)^-1 by d_next: rows are multiplied by J_l(c)."""
    return so3.left_jacobian(defect(ZERO, u, r, a, drift))


def slope(u: Any, r: Any, a: Any, drift: Any) -> Any:
    both = lambda z: defect(z[:3], z[3:], r, a, drift)  # noqa: E731
    return rows(u, r, a, drift) @ jax.jacfwd(both)(jnp.concatenate([ZERO, u]))


def bend(u: Any, r: Any, a: Any, m: Any, drift: Any) -> Any:
    weighted = lambda z, m: defect(z[:3], z[3:], r, a, drift) @ m  # noqa: E731
    return jax.hessian(weighted)(jnp.concatenate([ZERO, u]), rows(u, r, a, drift).T @ m)


DEFECTS = jax.jit(jax.vmap(functools.partial(defect, ZERO), (0, 0, 0, None)))
SLOPES, BENDS = jax.jit(jax.vmap(slope, (0, 0, 0, None))), jax.jit(jax.vmap(bend, (0, 0, 0, 0, None)))
END, END_SLOPE = jax.jit(functools.partial(end, ZERO)), jax.jit(lambda r: jax.jacfwd(end)(ZERO, r))
END_BEND = jax.jit(lambda r, m: jax.hessian(lambda d: end(d, r) @ m)(ZERO))
EXP = jax.jit(jax.vmap(so3.exp))
#: The inverse left Jacobian: how a multiplier of log(moved^-1 y) changes with the node that moves.
JACOBIANS_OF_LOG = jax.jit(jax.vmap(so3.left_jacobian_inv))


class Reorientation:
    """Body rates u turn I into GOAL: R' = R (u + drift), least sum of h u'u. States are rotations, points matrices."""

    stages = Stages(
        [3] * (INTERVALS + 1),
        [3] * INTERVALS + [0],
        [0] * (INTERVALS + 1),
        [0] * INTERVALS + [3],
        0,
        [9] * (INTERVALS + 1),
    )

    def __init__(self, drift: Array) -> None:
        self.drift = drift

    def split(self, z: Array) -> tuple[Array, Array]:
        inner = z[: 12 * INTERVALS].reshape(INTERVALS, 12)
        rotations = np.concatenate([inner[:, :9].ravel(), z[12 * INTERVALS :]]).reshape(-1, 3, 3)
        return rotations, inner[:, 9:]

    def values(self, z: Array) -> Any:
        r, u = self.split(z)
        return H * (u**2).sum(), DEFECTS(u, r[:-1], r[1:], self.drift), np.zeros(0), END(r[-1])

    def jacobians(self, z: Array) -> Any:
        r, u = self.split(z)
        gradient = np.concatenate([np.concatenate([np.zeros((INTERVALS, 3)), 2 * H * u], axis=1).ravel(), np.zeros(3)])
        of_end = [np.zeros((0, 6))] * INTERVALS + [np.asarray(END_SLOPE(r[-1]))]
        return gradient, [*np.asarray(SLOPES(u, r[:-1], r[1:], self.drift))], [np.zeros(0)], of_end

    def hessians(self, z: Array, weight: float, lam: Array, y: Array, ye: Array) -> Any:
        r, u = self.split(z)
        blocks = np.array(BENDS(u, r[:-1], r[1:], lam.reshape(-1, 3), self.drift))
        blocks[:, 3:, 3:] += 2 * weight * H * np.eye(3)
        return [*blocks, np.asarray(END_BEND(r[-1], ye))]

    def retract(self, z: Array, d: Array) -> Array:
        r, u = self.split(z)
        inner = d[: 6 * INTERVALS].reshape(INTERVALS, 6)
        steps = np.concatenate([inner[:, :3], d[None, 6 * INTERVALS :]])
        moved = r @ np.asarray(EXP(steps))
        return np.concatenate(
            [np.concatenate([moved[:-1].reshape(-1, 9), u + inner[:, 3:]], axis=1).ravel(), moved[-1].ravel()]
        )

    def transport(self, d: Array, lam: Array) -> Array:
        """c = log(R^-1 y) becomes log(exp(-d) R^-1 y), whose derivative by c is the inverse left Jacobian at d."""
        steps = np.concatenate([d[: 6 * INTERVALS].reshape(INTERVALS, 6)[1:, :3], d[None, 6 * INTERVALS :]])
        return np.concatenate([J.T @ m for J, m in zip(np.asarray(JACOBIANS_OF_LOG(steps)), lam.reshape(-1, 3))])

    def solve(self, with_transport: bool = True) -> CoreSolution:
        rng = np.random.default_rng(1)
        start = np.concatenate([np.tile(np.append(np.eye(3).ravel(), np.zeros(3)), INTERVALS), np.eye(3).ravel()])
        start = self.retract(start, 0.2 * rng.standard_normal(self.stages.variables))
        start[:9] = np.eye(3).ravel()
        functions = PythonFunctions(
            *(self.stages, self.values, self.jacobians, self.hessians, self.retract),
            self.transport if with_transport else None,
        )
        lower, upper = np.full(self.stages.variables, -np.inf), np.full(self.stages.variables, np.inf)
        lower[:3] = upper[:3] = 0.0
        coordinates = np.zeros(self.stages.variables)
        return solve(self.stages, functions.functions, lower, upper, start, coordinates, options=Options())


def test_the_shortest_turn_is_a_geodesic() -> None:
    """About one axis at a constant rate; the least cost is the square of the angle."""
    problem = Reorientation(np.zeros(3))
    solution = problem.solve()
    turn = np.asarray(so3.log(GOAL))
    assert solution.status is CoreStatus.SOLVED
    assert solution.statistics["cost"] == pytest.approx(turn @ turn, rel=1e-8)
    _, rates = problem.split(solution.z)
    np.testing.assert_allclose(rates, np.tile(turn, (INTERVALS, 1)), atol=1e-6)


@pytest.mark.parametrize("with_transport", [True, False])
def test_points_stay_rotations_and_reach_the_goal(with_transport: bool) -> None:
    """With a drift that does not commute. Multipliers about nodes that moved save steps and change no optimum."""
    problem = Reorientation(np.array([0.5, 1.0, -2.0]))
    solution = problem.solve(with_transport)
    rotations, _ = problem.split(solution.z)
    assert solution.status is CoreStatus.SOLVED
    np.testing.assert_allclose(rotations[-1], GOAL, atol=1e-8)
    squares = rotations @ rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=1e-12)
    assert solution.statistics["iterations"] <= 12
