"""Serial chains against Lagrange's equations of point masses, a double pendulum on paper, and their own energy."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_oracles import Cloud, pose

import twistax as tx
from evaluated import evaluated
from oracles import skew
from twistax.mechanics import (
    Chain,
    Link,
    SpatialInertia,
    aba,
    chain_models,
    forward_dynamics,
    inverse_dynamics,
    joints,
    mass_matrix,
    rnea,
)


def lowered(chain: Chain, **others: Callable[[tx.Expr, tx.Expr], tx.Expr]) -> Callable[..., dict[str, jax.Array]]:
    """f(q, qd, x): the dynamics, with x as accelerations or forces, and others of q and qd."""
    q, qd, x = (tx.State(name, shape=(chain.dofs,)) for name in ("q", "qd", "x"))
    dynamics = {"forces": inverse_dynamics(chain, q, qd, x), "accelerations": forward_dynamics(chain, q, qd, x)}
    found = tx.lower(dynamics | {name: function(q, qd) for name, function in others.items()})
    return lambda q, qd, x: found(0.0, {"q": q, "qd": qd, "x": x})


# ---- Lagrange --------------------------------------------------------------------------------------------------------


class Helical(joints.Joint):
    """A screw: it mixes turning and sliding, and the torque that works on it is not along its motion."""

    def __init__(self, name: str, axis: Any, pitch: float) -> None:
        self.axis, self.pitch = np.asarray(axis) / np.linalg.norm(axis), pitch
        working = np.concatenate([np.zeros(3), self.axis])
        super().__init__(name, motion=np.concatenate([pitch * self.axis, self.axis]), actuation_basis=working)

    def placement(self, position: tx.Expr) -> tx.Expr:
        return tx.lie.Pose(tx.lie.AxisRotation(position[0], self.axis), self.pitch * position[0] * self.axis)


def turn(axis: np.ndarray, angle: jax.Array) -> jax.Array:
    K = skew(axis)
    return np.eye(3) + jnp.sin(angle) * K + (1.0 - jnp.cos(angle)) * (K @ K)


def mixed_chain() -> tuple[Chain, Callable[[jax.Array], tuple[np.ndarray, jax.Array]], np.ndarray]:
    """A chain of hinges, a slide and a screw; where its points are, with plain matrices; and gravity."""
    rng = np.random.default_rng(5)
    #: Name, axis, rad and m for each unit of q.
    kinds: list[tuple[str, np.ndarray, float, float]] = [
        ("against y", np.array([0.0, -1.0, 0.0]), 1.0, 0.0),
        ("slide", np.array([2.0, -1.0, 2.0]) / 3.0, 0.0, 1.0),
        ("screw", np.array([0.6, 0.0, -0.8]), 1.0, 0.3),
        ("along z", np.array([0.0, 0.0, 1.0]), 1.0, 0.0),
    ]
    mounts, clouds = [pose(rng) for _ in kinds], [Cloud.random(rng, 4) for _ in kinds]
    gravity = np.array([0.7, -1.1, -9.6])
    links = []
    for (name, axis, angle, shift), mount, cloud in zip(kinds, mounts, clouds, strict=True):
        joint = Helical(name, axis, shift) if angle and shift else None
        joint = joint or (joints.Revolute(name, axis) if angle else joints.Prismatic(name, axis))
        tensor = cloud.tensor_about(cloud.center)
        body = SpatialInertia(mass=cloud.mass, center_of_mass=cloud.center, inertia=tensor)
        links.append(Link(joint, body, mount))

    def points(q: jax.Array) -> tuple[np.ndarray, jax.Array]:
        R, p, found = jnp.eye(3), jnp.zeros(3), []
        for i, ((_, axis, angle, shift), mount, cloud) in enumerate(zip(kinds, mounts, clouds, strict=True)):
            p = p + R @ mount[:3, 3] + R @ mount[:3, :3] @ (shift * q[i] * axis)
            R = R @ mount[:3, :3] @ turn(axis, angle * q[i])
            found.append(cloud.points @ R.T + p[None])
        return np.concatenate([cloud.masses for cloud in clouds]), jnp.concatenate(found)

    return Chain(links, gravity), points, gravity


def lagrange(points: Any, gravity: np.ndarray, q: jax.Array, qd: jax.Array, qdd: jax.Array) -> jax.Array:
    """d/dt dL/dq' - dL/dq of point masses."""
    masses, _ = points(q)

    def lagrangian(q: jax.Array, qd: jax.Array) -> jax.Array:
        place, velocity = jax.jvp(lambda q: points(q)[1], (q,), (qd,))
        return masses @ (0.5 * jnp.sum(velocity**2, axis=1) + place @ gravity)

    momentum = jax.grad(lagrangian, 1)
    return jax.jvp(momentum, (q, qd), (qd, qdd))[1] - jax.grad(lagrangian, 0)(q, qd)


def test_mixed_joints_follow_lagrange() -> None:
    chain, points, gravity = mixed_chain()
    q, qd, x = np.random.default_rng(1).normal(size=(3, 8, chain.dofs))
    found = jax.jit(jax.vmap(lowered(chain)))(q, qd, x)
    expected = jax.jit(jax.vmap(partial(lagrange, points, gravity)))
    np.testing.assert_allclose(found["forces"], expected(q, qd, x), rtol=1e-11, atol=1e-10)
    np.testing.assert_allclose(expected(q, qd, found["accelerations"]), x, rtol=1e-10, atol=1e-10)


def test_the_mass_matrix_is_the_hessian_of_lagrange_s_kinetic_energy() -> None:
    chain, points, _ = mixed_chain()
    q = tx.State("q", shape=(chain.dofs,))
    found = tx.lower(mass_matrix(chain, q))

    def kinetic(qd: jax.Array, q: jax.Array) -> jax.Array:
        masses, _ = points(q)
        return 0.5 * masses @ jnp.sum(jax.jvp(lambda q: points(q)[1], (q,), (qd,))[1] ** 2, axis=1)

    hessian = jax.jit(jax.hessian(kinetic))
    for at in np.random.default_rng(8).normal(size=(3, chain.dofs)):
        expected = hessian(np.zeros(chain.dofs), at)
        np.testing.assert_allclose(found(0.0, {"q": at}), expected, rtol=1e-11, atol=1e-11)


# ---- the arm ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def arm() -> tuple[Callable[..., dict[str, jax.Array]], np.ndarray]:
    """The Panda's functions for a batch, and states and forces or accelerations of it."""
    panda = chain_models.panda()
    functions = lowered(
        panda, energy=panda.energy, tip=lambda q, qd: panda.poses(q)[-1], mass=lambda q, qd: mass_matrix(panda, q)
    )
    return jax.jit(jax.vmap(functions)), np.random.default_rng(2).normal(size=(3, 8, 7))


def test_forward_and_inverse_dynamics_undo_each_other(arm: Any) -> None:
    f, (q, qd, tau) = arm
    back = f(q, qd, f(q, qd, tau)["accelerations"])["forces"]
    np.testing.assert_allclose(back, tau, rtol=0.0, atol=1e-12)


def test_mass_matrix_is_symmetric_and_positive(arm: Any) -> None:
    f, (q, qd, _) = arm
    zero = np.zeros((8, 7))
    bias = f(q, qd, zero)["forces"]
    M = np.stack([f(q, qd, zero + unit)["forces"] - bias for unit in np.eye(7)], axis=-1)
    np.testing.assert_allclose(M, np.swapaxes(M, 1, 2), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(f(q, qd, zero)["mass"], M, rtol=0.0, atol=1e-12)
    assert np.linalg.eigvalsh(M).min() > 1e-4
    kinetic = f(q, qd, zero)["energy"] - f(q, zero, zero)["energy"]
    np.testing.assert_allclose(kinetic, 0.5 * np.einsum("bi,bij,bj->b", qd, M, qd), rtol=1e-12)


def test_short_names_are_the_same_functions() -> None:
    assert rnea is inverse_dynamics
    assert aba is forward_dynamics


def test_power_of_the_motors_goes_into_the_energy(arm: Any) -> None:
    f, (q, qd, tau) = arm
    h, qdd = 1e-4, np.asarray(f(q, qd, tau)["accelerations"])

    def energy(t: float) -> np.ndarray:
        return np.asarray(f(q + t * qd + 0.5 * t**2 * qdd, qd + t * qdd, tau)["energy"])

    # Fourth order: the error of the quotient is some 1e-11 of the energy's higher derivatives.
    rate = (8.0 * (energy(h) - energy(-h)) - (energy(2.0 * h) - energy(-2.0 * h))) / (12.0 * h)
    np.testing.assert_allclose(rate, np.sum(qd * tau, axis=1), rtol=0.0, atol=1e-6)


def test_panda_stands_where_its_table_says(arm: Any) -> None:
    f, _ = arm
    q = np.zeros((8, 7))
    q[1, 3] = -0.5 * np.pi  # the elbow, so that the forearm is level
    tip = f(q, 0.0 * q, 0.0 * q)["tip"]
    np.testing.assert_allclose(tip[0, :3, 3], [0.088, 0.0, 0.333 + 0.316 + 0.384], atol=1e-15)
    np.testing.assert_allclose(tip[0, :3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    level = [0.0825 + 0.384, 0.0, 0.333 + 0.316 + 0.0825 - 0.088]
    np.testing.assert_allclose(tip[1, :3, 3], level, atol=1e-15)


# ---- on paper --------------------------------------------------------------------------------------------------------


def double_pendulum() -> Chain:
    """Two points on rods of no mass, 1.1 m and 0.7 m, swinging about y; at q = 0 they hang down."""
    links = []
    for name, mass, length, above in (("upper", 1.3, 1.1, 0.0), ("lower", 0.4, 0.7, 1.1)):
        bob = SpatialInertia(mass=mass, center_of_mass=(0.0, 0.0, -length), inertia=np.zeros((3, 3)))
        links.append(Link(joints.Revolute(name, (0.0, 1.0, 0.0)), bob, tx.pose(position=[0.0, 0.0, -above])))
    return Chain(links)


def test_double_pendulum_in_closed_form() -> None:
    (m1, l1), (m2, l2), g = (1.3, 1.1), (0.4, 0.7), 9.81
    q, qd, qdd = np.random.default_rng(3).normal(size=(3, 2))
    # The textbook's angles are both from the vertical.
    a, b = q[0], q[0] + q[1]
    ad, bd, add, bdd = qd[0], qd[0] + qd[1], qdd[0], qdd[0] + qdd[1]
    c, s = m2 * l1 * l2 * np.cos(a - b), m2 * l1 * l2 * np.sin(a - b)
    of_a = (m1 + m2) * l1**2 * add + c * bdd + s * bd**2 + (m1 + m2) * g * l1 * np.sin(a)
    of_b = m2 * l2**2 * bdd + c * add - s * ad**2 + m2 * g * l2 * np.sin(b)
    f = jax.jit(lowered(double_pendulum()))
    forces = f(q, qd, qdd)["forces"]
    np.testing.assert_allclose(forces, [of_a + of_b, of_b], rtol=1e-13)
    np.testing.assert_allclose(f(q, qd, forces)["accelerations"], qdd, rtol=1e-12)


def test_precision_follows_the_arrays() -> None:
    q, qd, x = np.random.default_rng(3).normal(size=(3, 2)).astype(np.float32)
    f = jax.jit(lowered(double_pendulum()))
    single, double = f(q, qd, x), f(*(v.astype(np.float64) for v in (q, qd, x)))
    for name, value in single.items():
        assert value.dtype == np.float32
        np.testing.assert_allclose(value, double[name], rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_thirty_equal_links() -> None:
    chain = chain_models.equal_links(30)
    q, qd, tau = np.random.default_rng(4).normal(size=(3, 30))
    x = tx.State("x", shape=(30,))
    accelerations = evaluated(forward_dynamics(chain, q, qd, x), {"x": tau})
    forces = evaluated(inverse_dynamics(chain, q, qd, x), {"x": accelerations})
    np.testing.assert_allclose(forces, tau, rtol=0.0, atol=1e-11)


# ---- what is refused -------------------------------------------------------------------------------------------------
