"""Armatures of joints that slide and turn: the forces that turn the momentum of the rotors.

On the base and without gravity a rotor of the inertia a on all freedoms of a joint is a body of the mass a and the
moments a at the origin of the link: Newton and Euler know that one.
"""

from typing import Any

import jax
import numpy as np
import pytest
from mechanics_oracles import pose

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints

A = 0.7


def robot(joint: joints.Joint, rotor: bool) -> Mechanism:
    """A joint with a rotor, or with a body in its place, and a hinge on it."""
    rng = np.random.default_rng(5)
    first = SpatialInertia(mass=2.0, center_of_mass=(0.1, -0.2, 0.3), inertia=np.diag([0.3, 0.4, 0.5]))
    second = SpatialInertia(mass=1.2, center_of_mass=(0.0, 0.2, 0.1), inertia=np.diag([0.02, 0.03, 0.04]))
    ball = SpatialInertia(mass=A, inertia=A * np.eye(3))
    links = [
        Link(joint, first if rotor else first + ball, pose(rng), drive=Drive(armature=A if rotor else 0.0)),
        Link(joints.Revolute("hinge", (0.0, 0.6, 0.8)), second, pose(rng), parent=joint.name),
    ]
    return Mechanism(links, gravity=(0.0, 0.0, 0.0))


def state_of(mechanism: Mechanism) -> dict[str, Any]:
    rng = np.random.default_rng(8)
    x: dict[str, Any] = {"qd": rng.normal(size=mechanism.dofs), "x": rng.normal(size=mechanism.dofs)}
    if "root" in mechanism.joints:
        (element,) = (leaf for name, leaf in mechanism.q.items() if name == "root")
        n = element.shape[0]
        return x | {"root_position": pose(rng)[:n, :n], "q": rng.normal(size=1)}
    return x | {"q": rng.normal(size=mechanism.dofs)}


def compared(joint: joints.Joint, *functions: Any) -> None:
    found = []
    for mechanism in (robot(joint, rotor=True), robot(joint, rotor=False)):
        x, state = tx.State("x", (mechanism.dofs,)), state_of(mechanism)
        found.append(evaluated([function(mechanism, x) for function in functions], state))
    for with_rotor, with_body in zip(*map(jax.tree.leaves, found), strict=True):
        np.testing.assert_allclose(with_rotor, with_body, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("joint", [joints.Free("root"), joints.Planar("table"), joints.Spherical("root")])
def test_forces_are_those_of_a_body_in_its_place(joint: joints.Joint) -> None:
    compared(joint, lambda m, x: mechanics.inverse_dynamics(m, qdd=x), lambda m, x: mechanics.coriolis_forces(m))


@pytest.mark.parametrize("joint", [joints.Free("root"), joints.Planar("table")])
def test_accelerations_are_those_of_a_body_in_its_place(joint: joints.Joint) -> None:
    compared(joint, lambda m, x: mechanics.forward_dynamics(m, tau=x))


@pytest.mark.parametrize("joint", [joints.Free("root"), joints.Planar("table")])
@pytest.mark.parametrize("by", ["inverse", "forward"])
def test_derivatives_are_those_of_a_body_in_its_place(joint: joints.Joint, by: str) -> None:
    function = getattr(mechanics, f"{by}_dynamics_derivatives")
    third = {"inverse": "qdd", "forward": "tau"}[by]
    compared(joint, lambda m, x: function(m, **{third: x}))
