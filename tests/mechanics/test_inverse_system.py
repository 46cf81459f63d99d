"""Systems by inverse dynamics: the motion of the forward system, its limits as constraints, the same optimum."""

import functools
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, given_forces, joints, loops
from twistax.trajectory import Collocation, Problem, Status

ROD = SpatialInertia(mass=2.0, center_of_mass=(0.2, 0.01, -0.03), inertia=np.diag([0.02, 0.05, 0.06]))
Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@functools.cache
def arm() -> Mechanism:
    """Gears, rotors, friction, a spring, a follower, a joint without a motor, and three without limits."""
    at = tx.pose(position=[0.4, 0.0, 0.1])
    geared = Drive(armature=0.3, damping=0.7, friction=1.5, gear=9.0, effort=(-2.0, 3.0))
    return Mechanism(
        [
            Link(joints.Revolute("base", Z), ROD, np.eye(4), drive=geared),
            Link(joints.Revolute("elbow", Y), ROD, at, parent="base", drive=Drive(stiffness=20.0, rest=0.3)),
            Link(joints.Prismatic("slide", Z), ROD, at, parent="elbow", drive=Drive(effort=(-9.0, 4.0))),
            Link(joints.Spherical("wrist"), ROD, at, parent="slide", drive=Drive(damping=0.1)),
        ],
        driven=["base", "slide", "wrist"],
    )


def drawn(mechanism: Mechanism, dynamics: tx.Dynamics, seed: int = 1) -> tuple[dict[str, Any], dict[str, Any]]:
    rng = np.random.default_rng(seed)
    x = {}
    for state in dynamics.states:
        flat = state.group.flat
        x[state.name] = (
            rng.normal(size=state.shape)
            if flat
            else np.asarray(state.group.exp(rng.normal(size=state.group.dimension)))
        )
    return x, {control.name: rng.normal(size=control.shape) for control in dynamics.controls}


def test_the_forward_system_moves_as_the_inverse_one_says() -> None:
    inverse, forward = tx.compile(arm().inverse_system()), tx.compile(arm().system())
    x, u = drawn(arm(), inverse)
    rates = inverse(0.0, x, u)
    np.testing.assert_array_equal(rates["qd"], u["qdd"])
    limited = inverse.constraints(0.0, x, u)
    tau = np.asarray(inverse.outputs(0.0, x, u)["tau"])
    assert tau.shape == (5,)  # base, slide, and three of the wrist
    np.testing.assert_allclose(
        limited["inequality"], [-2.0 - tau[0], -9.0 - tau[1], tau[0] - 3.0, tau[1] - 4.0], rtol=1e-12
    )
    # The elbow has no motor: what is left over there, a force on it would have to do.
    (left,) = np.asarray(limited["equality"])
    pushed = tx.compile(arm().system(forces=tx.Concat(0.0, float(left), 0.0, 0.0, 0.0, 0.0)))
    moved = pushed(0.0, x, {"tau": tau})
    for name, rate in rates.items():
        np.testing.assert_allclose(moved[name], rate, rtol=1e-9, atol=1e-9)
    moved = forward(0.0, x, {"tau": tau})
    assert abs(left) > 1.0
    assert np.abs(np.asarray(moved["qd"]) - u["qdd"]).max() > 0.1


def test_a_floating_base_has_six_equalities_that_contact_forces_meet() -> None:
    at = tx.pose(position=[0.1, 0.0, -0.1])
    foot = Link(joints.Fixed("foot"), None, tx.pose(position=[0.0, 0.0, -0.2]), parent="knee")
    links = [
        Link(joints.Free("trunk"), ROD, np.eye(4)),
        Link(joints.Revolute("hip", Y), ROD, at, parent="trunk"),
        Link(joints.Revolute("knee", Y), ROD, at, parent="hip"),
        foot,
    ]
    leg = Mechanism(links)
    contact = given_forces(leg, ["foot"], friction=0.6)
    rows = {**contact.cones, **contact.at_rest}
    inverse = tx.compile(leg.inverse_system(wrenches=contact.wrenches, constraints=rows))
    forward = tx.compile(leg.system(wrenches=contact.wrenches))
    x, _ = drawn(leg, inverse)
    x["trunk_position"] = np.asarray(tx.pose(position=[0.1, 0.2, 0.5], euler=[0.2, -0.3, 0.4]))
    pushes = {"tau": np.array([3.0, -2.0]), "force_foot": np.array([5.0, -4.0, 30.0])}
    qdd = forward(0.0, x, pushes)["qd"]
    u = {"qdd": qdd, "force_foot": pushes["force_foot"]}
    assert {control.name for control in inverse.controls} == set(u)
    np.testing.assert_allclose(inverse.outputs(0.0, x, u)["tau"], pushes["tau"], rtol=1e-9, atol=1e-9)
    equality = np.asarray(inverse.constraints(0.0, x, u)["equality"])
    assert equality.shape == (6 + 3,)
    np.testing.assert_allclose(equality[:6], 0.0, atol=1e-9)


@functools.cache
def two_links() -> Mechanism:
    drive = Drive(effort=60.0, speed=2.5)
    at = tx.pose(position=[0.4, 0.0, 0.0])
    return Mechanism(
        [
            Link(joints.Revolute("shoulder", Y), ROD, np.eye(4), drive=drive),
            Link(joints.Revolute("elbow", Y), ROD, at, parent="shoulder", drive=drive),
        ]
    )


def fastest(system: tx.System, nodes: int = 13) -> Any:
    """From hanging to the front, in the least time; rates are evaluated once an interval, by Euler's method."""
    ends: Any = {"initial": {"q": np.array([1.5, 0.2]), "qd": np.zeros(2)}}
    ends |= {"final": {"q": np.array([0.0, -0.4]), "qd": np.zeros(2)}}
    euler: Any = {"method": tx.RKMK(tx.tableaus.EULER), "substeps": 1}
    problem = Problem(tx.compile(system), tx.Minimize(tx.Time()), nodes=nodes, final_time=(0.1, 3.0), **ends, **euler)
    return problem.solve(max_iterations=500)


def test_the_optimum_is_that_of_the_forward_form() -> None:
    forward, inverse = fastest(two_links().system()), fastest(two_links().inverse_system())
    assert forward.status in (Status.SOLVED, Status.COARSE)
    assert inverse.status in (Status.SOLVED, Status.COARSE)
    assert float(inverse.final_time) == pytest.approx(float(forward.final_time), rel=1e-6)
    assert inverse.iterations < forward.iterations


def test_by_backward_euler_a_joint_without_a_motor_has_the_optimum_of_the_forward_form() -> None:
    cart = Link(joints.Prismatic("cart", (1.0, 0.0, 0.0)), ROD, np.eye(4))
    pole = Link(joints.Revolute("pole", Y), ROD, np.eye(4), parent="cart")
    cart_pole = Mechanism([cart, pole], driven=["cart"])
    inverse = cart_pole.inverse_system()
    costs = []
    for system, force in ((inverse, inverse.output("tau")), (cart_pole.system(), cart_pole.motors(["cart"]))):
        problem = Problem(
            tx.compile(system),
            tx.Minimize(running=force @ force),
            nodes=12,
            final_time=1.0,
            initial={"q": np.array([0.0, 1.2]), "qd": np.zeros(2)},
            final={"q": np.array([0.3, 1.6]), "qd": np.zeros(2)},
            transcription=Collocation(tx.tableaus.RADAU_IIA1),
        )
        result = problem.solve(mesh_tolerance=np.inf)
        assert result.solved, result.message
        assert not result.accuracy.exceeded
        costs.append(result.cost)
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)


def test_what_has_no_inverse_form_is_refused() -> None:
    loop = loops.Point("closed", "shoulder", "elbow")
    with pytest.raises(tx.ModelError, match="mechanism with loops"):
        two_links().replace(loops=[loop]).inverse_system()
    with pytest.raises(tx.ModelError, match="outputs names 'tau'"):
        two_links().inverse_system(outputs={"tau": two_links().energy()})
    with pytest.raises(tx.ModelError, match="no moving joint 'wrist'"):
        two_links().inverse_system(controls=["wrist"])
    kept = two_links().inverse_system(outputs=lambda qdd, tau: {"power": tau @ two_links().qd, "qdd": qdd})
    assert set(kept.outputs) == {"tau", "power", "qdd"}
