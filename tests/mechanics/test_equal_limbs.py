"""Limbs of equal structure: their expressions are built once, as a map over the limbs."""

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints

pytest.importorskip("llvmlite", reason="functions of limbs are in native kernels")


def quadruped(*, shared: bool, limbs: int = 4, size: int = 3) -> Mechanism:
    """A free body with mirrored limbs; a Parameter in each makes them unlike."""
    r = np.random.default_rng(1)
    links = [Link(joints.Free("base"), _body(r, 8.0), np.eye(4))]
    bodies = [_body(r, 1.0 + k) for k in range(size)]
    for limb in range(limbs):
        side, before = (-1.0) ** limb, "base"
        for k, body in enumerate(bodies):
            mount, mass = np.eye(4), body.mass
            mount[:3, 3] = (0.3 * np.cos(limb), 0.1 * side, 0.0) if k == 0 else (0.02, 0.05 * side, -0.2)
            if not shared and k == size - 1:
                mass = tx.Parameter("mass", value=1.0 + k)
            center = body.center_of_mass * np.array([1.0, side, 1.0])
            body = SpatialInertia(mass=mass, center_of_mass=center, inertia=body.inertia)
            drive = Drive(armature=0.02, damping=0.1) if k == 1 else Drive()
            joint = joints.Revolute(f"joint {limb} {k}", np.eye(3)[k % 3])
            links.append(Link(joint, body, mount, parent=before, drive=drive))
            before = joint.name
    return Mechanism(links)


def _body(r: np.random.Generator, mass: float) -> SpatialInertia:
    a = 0.1 * r.normal(size=(3, 3))
    return SpatialInertia(mass=mass, center_of_mass=0.05 * r.normal(size=3), inertia=a @ a.T + 0.1 * np.eye(3))


def nodes_of(expr: tx.Expr) -> list[tx.Expr]:
    nodes = list[tx.Expr]()
    tx.traverse(expr, nodes.append)
    return nodes


def _arguments(system: tx.System):
    r = np.random.default_rng(2)
    x = {s.name: np.asarray(s.group.exp(0.3 * r.normal(size=s.group.dimension))) for s in system.states}
    return x, {c.name: r.normal(size=c.shape) for c in system.controls}


@pytest.mark.parametrize("wrenches", [False, True])
def test_they_have_the_accelerations_and_derivatives_of_unlike_limbs(wrenches):
    """Also with wrenches at two of the feet, and along a tangent of JAX."""
    feet = {f"joint {limb} 2": tx.Control(f"foot {limb}", (6,)) for limb in range(2)} if wrenches else None
    results = []
    for shared in (True, False):
        system = quadruped(shared=shared).system(wrenches=feet)
        dynamics = tx.compile(system)
        assert any(isinstance(node, tx.Vmap) for node in nodes_of(system.rates["qd"])) == shared
        x, u = _arguments(system)
        slopes = dynamics.jacobian(0.0, x, u)
        tangents = jax.jvp(lambda u: dynamics(0.0, x, u)["qd"], (u,), (u,))[1]  # noqa: B023
        results.append([dynamics(0.0, x, u)["qd"], slopes["x"], slopes["u"], tangents])
    for value, expected in zip(*results, strict=True):
        np.testing.assert_allclose(value, expected, atol=1e-12 * np.abs(expected).max())
