"""A tree hung up by another link makes the same motions: energy, momentum, poses and accelerations."""

from typing import Any

import numpy as np
import pytest
from joints_of_every_kind import free_tree
from test_editing import four_bar, inputs, near, panda, random_state

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import ModelError
from twistax.mechanics import Drive, Mechanism


def physics(mechanism: Mechanism, frames: list[str]) -> dict[str, tx.Expr]:
    return {
        "T": mechanics.kinetic_energy(mechanism),
        "U": mechanics.potential_energy(mechanism),
        "momentum": mechanics.spatial_momentum(mechanism),
        "qdd": mechanics.forward_dynamics(mechanism, tau=np.zeros(mechanism.dofs)),
        **{name: mechanism.pose(name) for name in frames},
        **{f"V {name}": mechanism.twist(name) for name in frames},
    }


def same_physics(before: Mechanism, after: Mechanism, root: str, reversed_balls: list[str]) -> None:
    frames = sorted(before.frames.keys() - {before.base})
    positions, rates = random_state(before)
    expected = evaluated(physics(before, frames), inputs(before, positions, rates))
    positions, rates = dict(positions), dict(rates)
    for name in reversed_balls:
        R = positions[name]
        positions[name], rates[name] = R.T, -R @ rates[name]
    mount = np.asarray(before.link("root").mount.value)
    positions["root"], rates["root"] = np.linalg.inv(mount) @ expected[root], expected[f"V {root}"]
    values = evaluated(physics(after, frames), inputs(after, positions, rates))
    for name in ("T", "U", "momentum", *frames, *(f"V {frame}" for frame in frames)):
        near(values[name], expected[name], 1e-11)
    for name in before.joints:
        if name != "root" and name not in reversed_balls:
            entries = (m.segment_of(name).freedoms for m in (before, after))
            mine, theirs = (result["qdd"][list(at)] for result, at in zip((expected, values), entries, strict=True))
            near(theirs, mine, 1e-9)


def test_past_a_screw_a_ball_and_a_rod() -> None:
    tree = free_tree().mechanism
    after = tree.rerooted("screw")
    assert after.segments[0].link.name == "screw"
    assert after.links[0].joint.name == "root"
    same_physics(tree, after, "screw", ["ball"])


def test_past_a_hinge_a_slide_and_a_fixed_joint() -> None:
    tree = free_tree().mechanism
    positions, _ = random_state(tree)
    tree = tree.lock({"table": positions["table"]})
    same_physics(tree, tree.rerooted("hinge"), "hinge", [])


def test_there_and_back_again() -> None:
    tree = free_tree().mechanism
    back = tree.rerooted("screw").rerooted("root")
    positions, rates = random_state(tree)
    near(*(evaluated({"T": mechanics.kinetic_energy(m)}, inputs(m, positions, rates))["T"] for m in (back, tree)))


def test_of_an_arm_the_hand_is_fixed_and_the_old_base_moves() -> None:
    arm = panda()
    turned = arm.rerooted("flange")
    assert turned.base == "world"
    assert turned.notes[-1] == "gravity is in the axes of 'flange' now"
    assert [float(x) for x in turned.q.max[::-1]] == [float(x) for x in arm.q.max]
    q = np.linspace(-1.0, 1.0, 7)
    between = evaluated({"T": arm.pose("link0", relative_to="flange")}, {"q": q})["T"]
    near(evaluated({"T": turned.pose("link0")}, {"q": q[::-1]})["T"], between)
    # What is hung up by the old base again is the arm: it is the only link on its base.
    again = evaluated({"T": turned.rerooted("link0").pose("flange")}, {"q": q})["T"]
    near(again, evaluated({"T": arm.pose("flange")}, {"q": q})["T"])
    with pytest.raises(ModelError, match="'joint1' carries no mass"):
        mechanics.forward_dynamics(turned)
    # With a body for the old base it is that of the floating arm whose hand is held.
    body = arm.link("link1").body
    dynamics = turned.with_inertia({"link0": body}).replace(gravity=np.zeros(3))
    floating = arm.with_inertia({}).replace(gravity=np.zeros(3))
    rates = {"q": q[::-1], "qd": np.ones(7)}
    T = evaluated({"T": mechanics.kinetic_energy(dynamics)}, rates)["T"]
    twist = evaluated({"V": floating.twist("flange"), "P": floating.pose("flange")}, {"q": q, "qd": np.ones(7)})
    held = Mechanism_with_free_base(floating, body)
    state = inputs(held, {"float": np.eye(4), **dict(zip(arm.joints, q))}, {"float": zero_of(twist), **unit(arm)})
    near(T, evaluated({"T": mechanics.kinetic_energy(held)}, state)["T"])


def Mechanism_with_free_base(arm: Mechanism, body: Any) -> Mechanism:
    """The arm on a base of a body that floats."""
    base = Mechanism([mechanics.Link(mechanics.joints.Free("float"), body, np.eye(4))], (0.0, 0.0, 0.0), base="world")
    return base.attach(arm, "float")


def zero_of(twist: dict[str, np.ndarray]) -> np.ndarray:
    """The twist of the base at which the flange is at rest: -Ad_T V with V that of the flange on a base at rest."""
    R, p, V = twist["P"][:3, :3], twist["P"][:3, 3], twist["V"]
    w = R @ V[3:]
    return -np.concatenate([R @ V[:3] + np.cross(p, w), w])


def unit(arm: Mechanism) -> dict[str, Any]:
    return dict.fromkeys(arm.joints, 1.0)


def test_closures_and_followers_follow() -> None:
    linkage = four_bar()
    turned = linkage.rerooted("coupler")
    assert turned.loops[0].frame == "pin"
    assert turned.driven == ("crank",)
    assert set(linkage.frames) < set(turned.frames)
    q = np.array([-0.9, 0.4, -1.3])
    gap = evaluated({"gap": mechanics.loop_gap(linkage, "closure")}, {"q": q})["gap"]
    state = inputs(turned, dict(zip(linkage.joints, q, strict=True)), dict.fromkeys(linkage.joints, 0.0))
    near(evaluated({"gap": mechanics.loop_gap(turned, "closure")}, state)["gap"], gap)


def test_what_cannot_turn_round() -> None:
    tree = free_tree().mechanism
    assert tree.rerooted("base").joints == tree.joints
    with pytest.raises(ModelError, match=r"Planar\('table'\) cannot be reversed"):
        tree.rerooted("hinge")
    with pytest.raises(ModelError, match="no link 'hand'"):
        tree.rerooted("hand")
    with pytest.raises(ModelError, match="'ball' would be reversed, and its drive has 'armature'"):
        tree.replace(drives={"ball": Drive(armature=0.1)}).rerooted("screw")
