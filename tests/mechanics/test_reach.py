"""Inverse kinematics: poses that are reached, limits that stop it, distances that are left, and derivatives."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from joints_of_every_kind import mimicking_tree
from mechanics_oracles import pose

import twistax as tx
from twistax import mechanics
from twistax.errors import InputError, ModelError
from twistax.mechanics import Drive, Link, Mechanism, Mimic, ReachStatus, joints, reach

EXAMPLES = Path(__file__).parents[2] / "examples"
Z = (0.0, 0.0, 1.0)


def planar_arm(*limits: tuple[float, float]) -> Mechanism:
    """Links of 1 m in a plane, each with limits, and a tip."""

    def link(i, low, high):
        return Link(
            joints.Revolute(f"joint{i}", Z),
            None,
            tx.pose(position=[float(i > 0), 0.0, 0.0]),
            parent=f"joint{i - 1}" if i else None,
            drive=Drive(lower=low, upper=high),
        )

    tip = Link(joints.Fixed("tip"), None, tx.pose(position=[1.0, 0.0, 0.0]), parent=f"joint{len(limits) - 1}")
    return Mechanism([*(link(i, *ends) for i, ends in enumerate(limits)), tip])


def panda_poses(count: int) -> tuple[Mechanism, np.ndarray, np.ndarray]:
    """The Panda, random positions within its limits, and the poses of its flange there."""
    arm, rng = mechanics.load(EXAMPLES / "panda.urdf"), np.random.default_rng(0)
    q = rng.uniform(arm.q.min, arm.q.max, size=(count, 7))
    flange = tx.lower(arm.pose("flange"))
    return arm, q, np.asarray(jax.jit(jax.vmap(lambda value: flange(0.0, {"q": value})))(q))


def most_are_reached(count: int, share: float) -> None:
    pin = pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")
    arm, _, T = panda_poses(count)
    result = reach(arm, {"flange": T})
    status = np.asarray(result.status)
    assert np.mean(status == ReachStatus.REACHED) >= share
    model = pin.buildModelFromUrdf(str(EXAMPLES / "panda.urdf"))
    data, frame = model.createData(), model.getFrameId("flange", pin.FrameType.BODY)
    for i in np.flatnonzero(status == ReachStatus.REACHED)[:200]:
        q = np.asarray(result.x["q"][i])
        pin.framesForwardKinematics(model, data, q)
        assert np.abs(data.oMf[frame].homogeneous - T[i]).max() < 2e-5
        assert np.all((q >= model.lowerPositionLimit) & (q <= model.upperPositionLimit))
    missed = np.flatnonzero(status != ReachStatus.REACHED)
    assert all(max(result.distance[i, 0], result.angle[i, 0]) > 1e-5 for i in missed)
    assert all((status[i] == ReachStatus.LIMIT) == bool(result.stopped_by(i)) for i in missed)


def test_poses_of_a_panda() -> None:
    most_are_reached(300, 0.99)


def test_ten_thousand_poses_of_a_panda() -> None:
    most_are_reached(10_000, 0.995)


def test_a_limit_stops_the_nearest_position() -> None:
    arm = planar_arm((0.0, 1.0))
    target = np.array([np.cos(2.0), np.sin(2.0), 0.0])
    result = reach(arm, {"tip": target})
    assert result.status == ReachStatus.LIMIT
    assert result.stopped_by() == ("joint0",)
    assert np.allclose(result.x["q"], [1.0])
    assert np.allclose(result.distance, 2.0 * np.sin(0.5))  # a chord
    assert repr(result) == "ReachResult(LIMIT; 'tip' at most 0.96 m from its target)"
    turned = dataclasses.replace(result, angle=jnp.full(1, 0.25))
    assert repr(turned) == "ReachResult(LIMIT; 'tip' at most 0.96 m and 0.25 rad from its target)"
    inside = reach(arm, {"tip": np.array([np.cos(0.7), np.sin(0.7), 0.0])})
    assert inside.status == ReachStatus.REACHED
    assert inside.stopped_by() == ()
    assert np.allclose(inside.x["q"], [0.7])
    # A batch has the results of its members.
    beyond = reach(arm, {"tip": 3.0 * np.array([np.cos(0.4), np.sin(0.4), 0.0])})
    assert beyond.status == ReachStatus.UNREACHABLE
    single, kinds = (inside, result, beyond), np.array([0, 1, 2, 1, 0, 2, 2, 1, 0, 0])
    points = np.stack([[np.cos(0.7), np.sin(0.7), 0.0], target, [3.0 * np.cos(0.4), 3.0 * np.sin(0.4), 0.0]])
    mixed = reach(arm, {"tip": points[kinds].reshape(5, 2, 3)})
    for name in ("status", "distance", "at_limit", "minima", "seeds"):
        alone = np.stack([getattr(one, name) for one in single])
        values = np.asarray(getattr(mixed, name))
        np.testing.assert_allclose(values, alone[kinds].reshape(values.shape), atol=1e-9, err_msg=name)
    np.testing.assert_allclose(
        np.asarray(mixed.x["q"]).ravel(), np.concatenate([one.x["q"] for one in single])[kinds], atol=1e-9
    )


def test_what_is_too_far_is_a_minimum_of_all_seeds() -> None:
    arm = planar_arm((-3.0, 3.0), (-3.0, 3.0))
    # The reached target is first: the search goes on with the others before it.
    targets = np.array([[1.2, 0.3, 0.0], [2.0, 1.0, 0.0], [0.0, 2.5, 0.0], [1.0, 1.0, 0.5]])
    result = reach(arm, {"tip": targets})
    assert np.asarray(result.status).tolist() == [ReachStatus.REACHED] + [ReachStatus.UNREACHABLE] * 3
    assert np.allclose(result.distance[1:, 0], [np.sqrt(5.0) - 2.0, 0.5, 0.5], atol=1e-7)
    assert np.all(np.asarray(result.slope)[1:] <= 1e-4)
    assert np.all(np.asarray(result.minima)[1:] == 8)
    q = np.asarray(result.x["q"])
    x, y = np.cos(q[:, 0]) + np.cos(q.sum(axis=1)), np.sin(q[:, 0]) + np.sin(q.sum(axis=1))
    assert np.allclose([x[0], y[0]], targets[0, :2], atol=1e-5)


@pytest.mark.thorough
def test_an_arm_of_many_joints_reaches() -> None:
    """Its second derivatives have 144 entries, more than kernels of scalars have: it is one of matrices."""
    arm = planar_arm(*[(-0.5, 0.5)] * 12)
    targets = np.array([[9.0, 4.0, 0.0], [0.0, 15.0, 0.0], [11.5, -1.0, 0.0]])
    result = reach(arm, {"tip": targets})
    assert np.asarray(result.status).tolist() == [ReachStatus.REACHED, ReachStatus.LIMIT, ReachStatus.REACHED]
    angles = np.cumsum(np.asarray(result.x["q"]), axis=1)
    tips = np.stack([np.cos(angles).sum(axis=1), np.sin(angles).sum(axis=1)], axis=1)
    np.testing.assert_allclose(tips[[0, 2]], targets[[0, 2], :2], atol=1e-5)
    np.testing.assert_allclose(result.distance[1, 0], np.linalg.norm(tips[1] - targets[1, :2]), rtol=1e-9)
    alone = reach(arm, {"tip": targets[0]})
    np.testing.assert_allclose(alone.x["q"], result.x["q"][0], atol=1e-9)
    moved = jax.jacfwd(lambda p: reach(arm, {"tip": p}).x["q"])(targets[0])
    J = np.stack([np.cumsum(rows[::-1])[::-1] for rows in (-np.sin(angles[0]), np.cos(angles[0]))])
    np.testing.assert_allclose(J @ np.asarray(moved)[:, :2], np.eye(2), atol=1e-6)


def test_searches_of_what_is_out_of_reach_end_at_minima() -> None:
    """SciPy does not come nearer from the result, within the same limits. It does without the limit of a joint that is
    named, and without that of no other one.
    """
    arm, _, poses = panda_poses(60)
    T, u = poses.copy(), np.random.default_rng(1).normal(size=(60, 3))
    T[:, :3, 3] = u / np.linalg.norm(u, axis=1)[:, None] * np.linspace(1.5, 5.0, 60)[:, None]
    result = reach(arm, {"flange": T})
    status = np.asarray(result.status)
    assert set(status) == {ReachStatus.LIMIT, ReachStatus.UNREACHABLE}
    assert np.mean(result.minima) >= 7.9
    assert np.all(np.asarray(result.minima)[status == ReachStatus.UNREACHABLE] == 8)
    assert np.asarray(result.slope).max() <= 1e-4

    flange = tx.lower(arm.pose("flange"))

    def half_square(q: Any, goal: Any) -> Any:
        X = flange(0.0, {"q": q})
        turn = 0.3 * tx.SO3.log(X[:3, :3].T @ goal[:3, :3])
        return 0.5 * (jnp.sum((goal[:3, 3] - X[:3, 3]) ** 2) + jnp.sum(turn**2))

    value = jax.jit(jax.value_and_grad(half_square))

    def gain(i: int, *released: int) -> float:
        q, free = np.asarray(result.x["q"][i]), np.isin(range(7), released)
        bounds = np.stack([np.where(free, -7.0, arm.q.min), np.where(free, 7.0, arm.q.max)], axis=1)
        nearer = scipy.optimize.minimize(value, q, args=(T[i],), jac=True, bounds=bounds, method="L-BFGS-B")
        return float(1.0 - nearer.fun / value(q, T[i])[0])

    assert all(gain(i) < 1e-6 for i in range(0, 60, 12))
    at_limit = np.asarray(result.at_limit)
    for i in np.flatnonzero(status == ReachStatus.LIMIT)[:3]:
        assert all((gain(i, joint) > 2e-5) == at_limit[i, joint] for joint in range(7))


def test_a_search_without_enough_iterations_says_so() -> None:
    arm = planar_arm((-3.0, 3.0), (-3.0, 3.0))
    result = reach(arm, {"tip": np.array([0.0, 2.5, 0.0])}, iterations=2)
    assert result.status == ReachStatus.MAX_ITERATIONS
    assert result.minima < 8


def test_a_limit_that_does_not_keep_a_stretched_arm_from_its_target_is_not_named() -> None:
    """The flange is on the axis of a wrist at its limit, or nearly so."""
    arm = mechanics.load(EXAMPLES / "panda.urdf")
    result = reach(arm, {"flange": np.array([[5.0, 0.0, 0.0], [5.0, 5.0, 1.0], [0.0, 0.0, 3.0]])})
    assert np.asarray(result.status).tolist() == [ReachStatus.UNREACHABLE] * 3
    assert not np.asarray(result.at_limit).any()


def test_joints_on_groups_and_several_frames() -> None:
    tree = mimicking_tree().mechanism.replace(gravity=np.zeros(3))
    rng = np.random.default_rng(2)
    x = {
        "q": rng.uniform(-1.0, 1.0, size=tree.q["q"].shape),
        "root_position": pose(rng),
        "ball_position": pose(rng)[:3, :3],
    }
    frames = tx.lower({"tool": tree.pose("tool"), "hinge": tree.pose("hinge")})
    T = {name: np.asarray(value) for name, value in frames(0.0, x).items()}
    result = reach(tree, {"tool": T["tool"], "hinge": T["hinge"][:3, 3]}, seeds=4, candidates=8)
    assert result.status == ReachStatus.REACHED
    assert result.x.keys() == x.keys()
    there = frames(0.0, result.x)
    assert np.allclose(there["tool"], T["tool"], atol=1e-6)
    assert np.allclose(there["hinge"][:3, 3], T["hinge"][:3, 3], atol=1e-6)
    ball = np.asarray(result.x["ball_position"])
    assert np.allclose(ball.T @ ball, np.eye(3))


def test_the_limits_of_a_follower_are_those_of_its_leader() -> None:
    slide = Link(joints.Prismatic("slide", Z), None, np.eye(4), drive=Drive(lower=-1.0, upper=1.0))
    follower = Link(
        joints.Prismatic("other", Z),
        None,
        np.eye(4),
        mimic=Mimic("slide", ratio=-2.0),
        drive=Drive(lower=-1.0, upper=0.5),
    )
    result = reach(Mechanism([slide, follower]), {"slide": np.array([[0.0, 0.0, z] for z in (0.9, -0.9, 0.3)])})
    assert np.allclose(result.x["q"][:, 0], [0.5, -0.25, 0.3], atol=1e-6)
    assert np.asarray(result.status).tolist() == [ReachStatus.LIMIT, ReachStatus.LIMIT, ReachStatus.REACHED]
    assert repr(result).startswith("ReachResult(2 LIMIT, 1 REACHED; ")


def test_derivatives_are_those_of_the_solution() -> None:
    arm = planar_arm((-3.0, 3.0), (0.1, 3.0))  # one solution for a target
    target = np.array([1.2, 0.3, 0.0])
    position = jax.jit(lambda p: reach(arm, {"tip": p}).x["q"])
    J = jax.jacrev(position)(target)
    h = 1e-5
    for i in range(2):
        unit = np.eye(3)[i]
        assert np.allclose(J[:, i], (position(target + h * unit) - position(target - h * unit)) / (2.0 * h), atol=1e-6)
    assert np.allclose(jax.jacfwd(position)(target), J)
    both = jax.vmap(position)(jnp.stack([target, target + 0.1]))
    assert np.allclose(both[0], position(target), atol=1e-6)


def test_the_first_seed_is_the_start() -> None:
    arm, target = planar_arm((-3.0, 3.0), (-3.0, 3.0)), np.array([1.2, 0.3, 0.0])
    up, down = (reach(arm, {"tip": target}, start={"q": np.array([0.1, elbow])}).x["q"] for elbow in (1.5, -1.5))
    assert up[1] > 0.0 > down[1]
    assert np.allclose(up[1], -down[1])
    many = reach(arm, {"tip": np.tile(target, (2, 1))}, start={"q": np.array([[0.1, 1.5], [0.1, -1.5]])}, seeds=1)
    assert np.allclose(many.x["q"], np.stack([up, down]), atol=1e-6)


def test_precision_is_that_of_the_target() -> None:
    arm, targets = (
        planar_arm((-3.0, 3.0), (-3.0, 3.0)),
        np.array([[1.2, 0.3, 0.0]] + [[4.0, k, 0.0] for k in range(8)]),
    )
    result = reach(arm, {"tip": targets.astype(np.float32)})
    assert result.x["q"].dtype == np.float32
    assert np.asarray(result.status).tolist() == [ReachStatus.REACHED] + 8 * [ReachStatus.UNREACHABLE]


def test_traced_targets_that_are_not_poses_are_named() -> None:
    arm = planar_arm((-3.0, 3.0))
    status = jax.jit(lambda T: reach(arm, {"tip": T}).status)
    wrong = [np.diag([1.0, 1.0, -1.0, 1.0]), 2.0 * np.eye(4), np.full((4, 4), np.nan)]
    right = tx.pose(position=[np.cos(0.7), np.sin(0.7), 0.0], euler=[0.0, 0.0, 0.7])
    expected = [ReachStatus.INVALID_TARGET] * 3 + [ReachStatus.REACHED]
    assert np.asarray(status(np.stack([*wrong, right]))).tolist() == expected


def test_what_cannot_be_asked_for(unchecked: None) -> None:
    arm, T = mechanics.chain_models.equal_links(2), np.eye(4)
    wrong: list[tuple[Any, str]] = [
        ({"hand": T}, "no frame 'hand'"),
        ({}, "expects targets by the names of frames"),
        ({"joint1": np.eye(3)[0, :2]}, r"\(\.\.\., 4, 4\) or \(\.\.\., 3\)"),
        ({"joint1": np.full((4, 4), np.nan)}, "finite targets"),
        ({"joint1": np.diag([1.0, 1.0, -1.0, 1.0])}, "expects poses"),
        ({"joint1": np.zeros((2, 3)), "joint0": T}, "the same leading axes"),
    ]
    for targets, message in wrong:
        with pytest.raises((InputError, ModelError), match=message):
            reach(arm, targets)
    with pytest.raises(InputError, match="seeds"):
        reach(arm, {"joint1": T}, seeds=0)
    with pytest.raises(InputError, match="length"):
        reach(arm, {"joint1": T}, length=0.0)
    with pytest.raises(InputError, match="start expects 'q'"):
        reach(arm, {"joint1": T}, start={"x": np.zeros(2)})
    with pytest.raises(InputError, match="start expects 'q' with shape"):
        reach(arm, {"joint1": T}, start={"q": np.zeros(3)})
