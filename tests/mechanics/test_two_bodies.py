"""Two bodies in a row, put together as docs/bodies.md does, against Lagrange's equations of their points."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from mechanics_oracles import Cloud, pose

import twistax as tx
from oracles import skew
from twistax.mechanics import SpatialInertia, joints

RNG = np.random.default_rng(3)
CLOUDS = (Cloud.random(RNG), Cloud.random(RNG))
#: From the joint of the second body to the first body's frame, at position zero.
MOUNT = pose(RNG)
GRAVITY = np.array([0.4, -0.3, -9.7])
HINGE_AXIS, OTHER_AXIS = np.array([2.0, -1.0, 2.0]) / 3.0, np.array([0.6, 0.0, -0.8])
HINGE = joints.Revolute("hinge", axis=HINGE_AXIS)
SECOND = {
    "hinge": joints.Revolute("second", axis=OTHER_AXIS),
    "slide": joints.Prismatic("second", axis=OTHER_AXIS),
}


def body_of(cloud: Cloud) -> SpatialInertia:
    return SpatialInertia(mass=cloud.mass, center_of_mass=cloud.center, inertia=cloud.tensor_about(cloud.center))


def accelerations(second: joints.Joint) -> tx.Expr:
    """q'' (2,), written with screws."""
    one, two = (body_of(cloud) for cloud in CLOUDS)
    T_1, T_12 = HINGE.transform, tx.lie.Compose(MOUNT, second.transform)
    X = tx.lie.SE3Adjoint(tx.lie.Inverse(T_12))
    V_1 = HINGE.twist
    V_2 = X @ V_1 + second.twist
    J_1 = tx.Block([[HINGE.motion_subspace, np.zeros((6, 1))]])
    J_2 = tx.Block([[X @ HINGE.motion_subspace, second.motion_subspace]])
    F_1 = tx.lie.AdjointDual(V_1, one.momentum(V_1)) - one.weight(T_1, GRAVITY)
    F_2 = tx.lie.AdjointDual(V_2, two.momentum(V_2)) - two.weight(tx.lie.Compose(T_1, T_12), GRAVITY)
    turned = two.matrix @ tx.lie.Adjoint(V_2, second.twist)
    inertia = J_1.T @ one.matrix @ J_1 + J_2.T @ two.matrix @ J_2
    return tx.linalg.Solve(inertia, -(J_1.T @ F_1 + J_2.T @ (F_2 + turned)))


def turn(axis: np.ndarray, angle: jax.Array) -> jax.Array:
    K = skew(axis)
    return np.eye(3) + jnp.sin(angle) * K + (1.0 - jnp.cos(angle)) * (K @ K)


def lagrange(kind: str, q: jax.Array, rate: jax.Array) -> jax.Array:
    """q'' from the kinetic and potential energy of the points alone."""

    def points(q: jax.Array) -> jax.Array:
        first = turn(HINGE_AXIS, q[0])
        points = CLOUDS[1].points
        local = points @ turn(OTHER_AXIS, q[1]).T if kind == "hinge" else points + (OTHER_AXIS * q[1])[None]
        return jnp.concatenate([CLOUDS[0].points, local @ MOUNT[:3, :3].T + MOUNT[None, :3, 3]]) @ first.T

    masses = np.concatenate([cloud.masses for cloud in CLOUDS])

    def lagrangian(q: jax.Array, rate: jax.Array) -> jax.Array:
        place, velocity = jax.jvp(points, (q,), (rate,))
        return masses @ (0.5 * jnp.sum(velocity**2, axis=1) + place @ GRAVITY)

    push = jax.grad(lagrangian, 0)(q, rate) - jax.jacfwd(jax.grad(lagrangian, 1), 0)(q, rate) @ rate
    return jnp.linalg.solve(jax.hessian(lagrangian, 1)(q, rate), push)


def test_two_bodies_follow_lagrange() -> None:
    q, rate = RNG.normal(size=(2, 10, 2))
    states = {"hinge_position": q[:, :1], "hinge_velocity": rate[:, :1]}
    states |= {"second_position": q[:, 1:], "second_velocity": rate[:, 1:]}
    found = tx.lower({kind: accelerations(second).canonicalize() for kind, second in SECOND.items()})
    for kind, values in jax.jit(jax.vmap(partial(found, 0.0)))(states).items():
        expected = jax.jit(jax.vmap(partial(lagrange, kind)))(q, rate)
        np.testing.assert_allclose(values, expected, rtol=1e-11, atol=1e-11)
