"""`check_joint` runs over every joint of the package, passes users' own, and sees each error that makes one wrong."""

from typing import Any

import numpy as np
import pytest

import twistax as tx
from registered import concrete_classes
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints
from twistax.testing import LawError, check_joint
from users_groups import SO2

Z = (0.0, 0.0, 1.0)
JOINTS = concrete_classes(joints.Joint)
CASES = [(cls, i) for cls in JOINTS for i in range(max(1, len(cls.cases)))]


@pytest.mark.parametrize(("cls", "number"), CASES, ids=lambda value: getattr(value, "__name__", str(value)))
def test_every_joint_keeps_the_laws(cls: type[joints.Joint], number: int) -> None:
    assert cls.cases, f"{cls.__name__} has no cases: give it cases = ({{argument: value}},)"
    check_joint(cls(f"the {cls.__name__}", **cls.cases[number]))


def test_all_joints_are_found() -> None:
    assert {cls.__name__ for cls in JOINTS} >= {"Fixed", "Revolute", "Helical", "Planar", "Spherical", "Free"}
    assert {f"{cls.__name__}" for cls in JOINTS} <= {*joints.__all__}


class Swapped(joints.Planar):
    """x and y in the pose exchanged."""

    def placement(self, position: tx.Expr) -> tx.Expr:
        q = position
        return tx.lie.Pose(tx.lie.AxisRotation(q[2], Z), tx.Concat(q[1], q[0], 0.0))


class Turned(joints.Revolute):
    """x and y of the child exchanged, by a quarter turn."""

    def placement(self, position: tx.Expr) -> tx.Expr:
        quarter = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
        return tx.lie.Compose(quarter, super().placement(position))


class OtherWay(joints.Revolute):
    def placement(self, position: tx.Expr) -> tx.Expr:
        return super().placement(-position)


class InDegrees(joints.Revolute):
    def placement(self, position: tx.Expr) -> tx.Expr:
        return super().placement(np.pi / 180.0 * position)


class InWorldAxes(joints.Planar):
    """The velocity in the parent's axes, where H is not constant in the child."""

    rate = joints.Joint.rate


class TwiceAsFast(joints.Spherical):
    def rate(self, position: tx.Expr, velocity: tx.Expr) -> tx.Expr:
        return 2.0 * velocity


class NotUndone(joints.Planar):
    def velocity_of(self, position: tx.Expr, rate: tx.Expr) -> tx.Expr:
        return self.rate(position, rate)


class Sprung(joints.Prismatic):
    def deflection(self, position: tx.Expr) -> tx.Expr:
        return position + 0.1


class Stretched(joints.Prismatic):
    def placement(self, position: tx.Expr) -> tx.Expr:
        scale = tx.Block([[np.eye(3) * (1.0 + position[0]), np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
        return super().placement(position) @ scale


class NoBearing(joints.Revolute):
    def __init__(self, name: str, axis: Any) -> None:
        super().__init__(name, axis)
        self.constraint_basis = tx.Constant(np.eye(6)[:, 1:])


class Reading(joints.Prismatic):
    def placement(self, position: tx.Expr) -> tx.Expr:
        return super().placement(position + tx.State("load"))


BROKEN: list[tuple[joints.Joint, str]] = [
    (Swapped("j"), r"T_pc' = T_pc hat\(H v\).*placement, rate and motion"),
    (Turned("j", Z), "the pose at zero.*at_zero"),
    (OtherWay("j", Z), r"T_pc' = T_pc hat\(H v\)"),
    (InDegrees("j", Z), r"T_pc' = T_pc hat\(H v\)"),
    (InWorldAxes("j"), "the twist changes by H v' alone.*several ones in a row"),
    (TwiceAsFast("j"), r"T_pc' = T_pc hat\(H v\)"),
    (NotUndone("j"), "velocity_of undoes rate"),
    (Sprung("j", Z), "springs feel nothing at zero"),
    (Stretched("j", Z), r"T_pc' = T_pc hat\(H v\)|the pose is one"),
    (NoBearing("j", Z), r"H\^T Hbar\* = 0"),
    (Reading("j", Z), r"the pose reads \['load'\]"),
]


@pytest.mark.parametrize(("joint", "words"), BROKEN, ids=lambda value: type(value).__name__)
def test_an_error_is_seen(joint: joints.Joint, words: str) -> None:
    with pytest.raises(LawError, match=f"(?s){words}"):
        check_joint(joint)


def test_a_joint_may_have_another_pose_at_zero() -> None:
    turned = Turned("j", Z)
    check_joint(turned, at_zero=tx.lower(turned.transform)(0.0, {"j_position": np.zeros(1)}))


class OnUsersGroup(joints.Joint):
    """A turn about z whose position is an element of a group of the user's."""

    group = SO2()

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.eye(6)[5])

    def placement(self, position: tx.Expr) -> tx.Expr:
        R = tx.Block([[position, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
        return tx.lie.Pose(R, np.zeros(3))


def test_a_joint_on_a_group_of_users_passes_and_moves_a_mechanism_as_the_hinge_it_is() -> None:
    check_joint(OnUsersGroup("wheel"))
    body = SpatialInertia(mass=2.0, center_of_mass=(0.3, 0.1, -0.6), inertia=np.diag([0.24, 0.3, 0.1]))
    angle, rates = 0.7, {}
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    positions = {"group": {"q": [0.4], "wheel_position": R}, "hinge": {"q": [0.4, angle]}}
    for name, wheel in (("group", OnUsersGroup("wheel")), ("hinge", joints.Revolute("wheel", Z))):
        arm = Link(joints.Revolute("arm", (0.0, 1.0, 0.0)), body, tx.pose())
        on = Link(wheel, body, tx.pose(position=[0.0, 0.2, 0.0]), parent="arm")
        dynamics = tx.compile(Mechanism([arm, on]).system())
        x = {key: np.asarray(value) for key, value in positions[name].items()} | {"qd": np.array([1.0, -2.0])}
        rates[name] = dynamics(0.0, x, {"tau": np.array([0.1, 0.2])})["qd"]
    np.testing.assert_allclose(rates["group"], rates["hinge"], atol=1e-12)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("wrong", [joints.Planar, tx.SE3], ids=["class", "group"])
def test_what_is_no_joint_is_refused(wrong: Any) -> None:
    with pytest.raises(tx.InputError, match="check_joint expects a joint such as"):
        check_joint(wrong)
