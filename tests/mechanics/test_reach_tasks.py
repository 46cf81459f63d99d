"""Inverse kinematics with several frames, further tasks, priorities and constraints."""

import dataclasses
import logging
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.errors import InputError, ModelError
from twistax.mechanics import (
    CenterOfMassTask,
    FrameTask,
    ManipulabilityTask,
    MomentumTask,
    PositionTask,
    PostureTask,
    ReachStatus,
    reach,
    signed_distance,
)
from twistax.view import Box, Sphere

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_a_posture_is_of_the_second_priority() -> None:
    """Three links in a plane reach a point: the posture is the nearest of the circle of solutions."""
    from test_reach import planar_arm

    arm = planar_arm((-3.0, 3.0), (-3.0, 3.0), (-3.0, 3.0))
    target, wanted = np.array([1.5, 0.8, 0.0]), np.array([0.2, 0.4, 0.3])
    result = reach(arm, {"tip": target}, secondary=[PostureTask(wanted)], start={"q": np.array([0.1, 0.8, 0.5])})
    assert result.status == ReachStatus.REACHED
    q = np.asarray(result.x["q"])
    assert result.distance[0] < 1e-5
    # At an optimum the gradient has no part along the circle: it is a combination of the rows of J.
    J = np.asarray(evaluated(mechanics.frame_jacobian(arm, "tip", axes=mechanics.ALIGNED)[:2], {"q": q}))
    left = (wanted - q) - J.T @ np.linalg.lstsq(J.T, wanted - q, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-4
    alone = np.asarray(reach(arm, {"tip": target}, start={"q": np.array([0.1, 0.8, 0.5])}).x["q"])
    assert np.linalg.norm(q - wanted) < np.linalg.norm(alone - wanted) - 1e-3


def test_manipulability_is_of_the_second_priority() -> None:
    """Four joints reach a point: no solution nearby has a larger manipulability, whatever the weight is."""
    arm = mechanics.load(EXAMPLES / "panda.urdf").lock({"joint5": 0.0, "joint6": 1.0, "joint7": 0.0})
    target, start = np.array([0.4, 0.2, 0.5]), {"q": np.array([0.3, 0.3, 0.1, -2.0])}
    task = ManipulabilityTask("flange", target=1.0)
    alone = reach(arm, {"flange": target}, start=start).x
    result = reach(arm, {"flange": target}, secondary=[task], start=start)
    assert result.status == ReachStatus.REACHED
    before, after = (float(evaluated(task.error(arm), x)[0]) for x in (alone, result.x))
    assert after < before - 5e-3
    assert result.distance[0] < 1e-9
    J, slope = (
        np.asarray(a) for a in evaluated([mechanics.frame_jacobian(arm, "flange")[:3], task.jacobian(arm)], result.x)
    )
    q = np.asarray(result.x["q"])
    free = (q > arm.q.min) & (q < arm.q.max)
    J, slope = J[:, free], slope[0, free]
    along = slope - J.T @ np.linalg.lstsq(J.T, slope, rcond=None)[0]
    assert np.linalg.norm(along) < 1e-4 * np.linalg.norm(slope)
    for weight in (1e-3, 1e3):
        other = reach(arm, {"flange": target}, secondary=[dataclasses.replace(task, weight=weight)], start=start)
        np.testing.assert_allclose(other.x["q"], q, atol=1e-6)
    single = reach(
        arm, {"flange": target.astype(np.float32)}, secondary=[task], start={"q": start["q"].astype(np.float32)}
    )
    assert single.status == ReachStatus.REACHED
    np.testing.assert_allclose(single.x["q"], q, atol=2e-2)


def test_constraints_are_kept_or_named() -> None:
    from test_reach import planar_arm

    arm, target = planar_arm((-3.0, 3.0), (-3.0, 3.0)), np.array([1.2, 0.3, 0.0])
    elbow = arm.pose("joint1")
    up, down = (reach(arm, {"tip": target}, constraints={"side": sign * elbow[1, 3] <= 0.0}) for sign in (-1.0, 1.0))
    assert up.status == down.status == ReachStatus.REACHED
    assert up.x["q"][0] > 0.3 > -0.1 > down.x["q"][0]
    assert up.constraints[0] <= 1e-5
    both = reach(
        arm,
        {"tip": target},
        constraints={"above": elbow[1, 3] >= 0.1, "below": elbow[1, 3] <= -0.1, "wide": arm.q[0] <= 3.0},
    )
    assert both.status == ReachStatus.UNREACHABLE
    assert set(both.broken()) <= {"above", "below"}
    assert both.broken()
    assert all(f"constraint {name!r} violated by at most 0." in repr(both) for name in both.broken())


@pytest.mark.slow
def test_a_panda_reaches_over_a_shelf_in_batches() -> None:
    arm = mechanics.load(EXAMPLES / "panda.urdf")
    shelf = Box((0.4, 1.2, 0.04), at=(0.6, 0.0, 0.35))
    clear = {name: signed_distance(Sphere(0.09), shelf, arm.pose(name)) >= 0.02 for name in ("link4", "link5", "link7")}
    q = np.random.default_rng(1).uniform(arm.q.min, arm.q.max, size=(40, 7))
    flange = tx.lower(arm.pose("flange"))
    p = np.asarray(jax.jit(jax.vmap(lambda q: flange(0.0, {"q": q})))(q))[:, :3, 3]
    result = reach(arm, {"flange": p}, constraints=clear)
    reached = np.asarray(result.status) == ReachStatus.REACHED
    assert reached.mean() > 0.7
    assert np.asarray(result.constraints)[reached].max() < 1e-5
    assert np.asarray(result.distance)[reached].max() < 1e-5
    free = reach(arm, {"flange": p})
    values = tx.lower([constraint.residual() for constraint in clear.values()])
    hits = np.asarray(jax.jit(jax.vmap(lambda q: values(0.0, {"q": q})))(free.x["q"])).max(axis=0)
    assert (hits > 1e-3).sum() >= 2  # without constraints some positions are in the shelf


def test_tasks_without_targets_of_frames() -> None:
    arm = mechanics.chain_models.equal_links(3)
    there = {"q": np.array([0.4, -0.8, 0.5])}
    center, tip = evaluated([mechanics.center_of_mass(arm), arm.pose("joint2")[:3, 3]], there)
    result = reach(arm, {}, tasks=[CenterOfMassTask(center), PositionTask("joint2", tip)])
    assert result.status == ReachStatus.REACHED
    found = evaluated([mechanics.center_of_mass(arm), arm.pose("joint2")[:3, 3]], result.x)
    assert np.allclose(found[0], center, atol=1e-5)
    assert np.allclose(found[1], tip, atol=1e-5)


def test_other_numbers_do_not_compile_again(caplog: pytest.LogCaptureFixture) -> None:
    from test_reach import planar_arm

    arm, traces = planar_arm((-3.0, 3.0), (-3.0, 3.0), (-3.0, 3.0)), list[Any]()

    def height_of(T: Any) -> Any:
        traces.append(T)
        return T[1, 3]

    high = tx.Function(height_of, ())(arm.pose("joint1"))

    def search(k: float) -> mechanics.ReachResult:
        turned = tx.pose(position=[1.5, 0.8 * k, 0.0], euler=[0.0, 0.0, 0.9 * k])
        height = tx.Parameter("height", value=-0.1 * k)
        return reach(
            arm,
            {"tip": turned},
            tasks=[PositionTask("joint2", np.asarray(turned[:3, 3] - turned[:3, 0]), weight=2.0 * k)],
            secondary=[PostureTask(np.array([0.2 * k, 0.4, 0.3]), weight=0.1 * k)],
            constraints={"above": high >= height},
            length=0.3 * k,
            position_tolerance=1e-5 * k,
            angle_tolerance=1e-6 * k,
        )

    assert search(1.0).status == ReachStatus.REACHED
    assert len(traces) <= 2  # for the shape, and once for all parts of the search
    caplog.clear()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        result = search(0.9)
    assert [text for text in caplog.messages if text.startswith("Compiling")] == []
    assert result.status == ReachStatus.REACHED
    there, elbow = evaluated([arm.pose("tip"), arm.pose("joint1")[1, 3]], result.x)
    assert np.allclose(there, tx.pose(position=[1.5, 0.72, 0.0], euler=[0.0, 0.0, 0.81]), atol=2e-5)
    assert np.isclose(result.constraints[0], -0.09 - elbow, atol=1e-9)  # the number of this call


def test_what_cannot_be_asked_for(unchecked: None) -> None:
    arm, T = mechanics.chain_models.equal_links(2), np.eye(4)
    wrong: list[tuple[Any, str]] = [
        ({"tasks": [FrameTask("joint1")]}, "none for 'joint1_pose'"),
        ({"tasks": ["joint1"]}, "reach expects tasks"),
        ({"secondary": PostureTask(np.zeros(2))}, "reach: secondary expects a list of tasks"),
        ({"secondary": [MomentumTask(np.ones(6))]}, "errors depend on positions, got MomentumTask"),
        ({"constraints": [arm.q[0] == 0.0]}, "expects inequalities as constraints"),
        ({"constraints": [tx.Time() <= 0.0]}, "expects expressions of positions"),
    ]
    for arguments, message in wrong:
        with pytest.raises((InputError, ModelError), match=message):
            reach(arm, {"joint1": T}, **arguments)
