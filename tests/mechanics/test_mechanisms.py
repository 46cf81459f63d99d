"""Trees with joints of every kind against Lagrange's equations of point masses."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints_of_every_kind import GRAVITY, Tree, free_tree, mimicking_tree

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import ALIGNED, BODY, WORLD, Drive, Link, Mechanism, Mimic, SpatialInertia, joints, loops


@pytest.mark.parametrize("tree", [free_tree, mimicking_tree])
def test_trees_follow_lagrange(tree: Any) -> None:
    tree = tree()
    robot = tree.mechanism
    x = tx.State("x", (robot.dofs,))
    qd, other = np.random.default_rng(1).normal(size=(2, robot.dofs))
    found = evaluated(
        {
            "forces": mechanics.inverse_dynamics(robot, qdd=x),
            "accelerations": mechanics.forward_dynamics(robot, tau=x),
            "mass": mechanics.mass_matrix(robot),
            "bias": mechanics.bias_forces(robot),
            "gravity": mechanics.gravity_forces(robot),
            "coriolis": mechanics.coriolis_forces(robot),
        },
        tree.inputs(qd=qd, x=other),
    )
    expected = tree.lagrange(qd, other)
    np.testing.assert_allclose(found["forces"], expected, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(tree.lagrange(qd, found["accelerations"]), other, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(found["mass"] @ other + found["bias"], expected, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(found["gravity"], tree.lagrange(0.0 * qd, 0.0 * qd), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found["gravity"] + found["coriolis"], found["bias"], rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(found["mass"], found["mass"].T, rtol=0.0, atol=1e-13)


def test_momentum_and_energy_are_those_of_the_points() -> None:
    tree = mimicking_tree()
    robot = tree.mechanism
    qd = np.random.default_rng(2).normal(size=robot.dofs)
    found = evaluated(
        {
            "center": mechanics.center_of_mass(robot),
            "momentum": mechanics.centroidal_momentum(robot),
            "matrix": mechanics.centroidal_matrix(robot),
            "kinetic": mechanics.kinetic_energy(robot),
            "potential": mechanics.potential_energy(robot),
            "mass": mechanics.total_mass(robot),
        },
        tree.inputs(qd=qd),
    )
    masses, places = map(np.asarray, tree.points(jnp.zeros(robot.dofs)))
    _, velocities = jax.jvp(lambda d: tree.points(d)[1], (jnp.zeros(robot.dofs),), (jnp.asarray(qd),))
    velocities = np.asarray(velocities)
    center, carried = masses @ places / masses.sum(), masses[:, None] * velocities
    expected = np.concatenate([carried.sum(axis=0), np.cross(places - center, carried).sum(axis=0)])
    np.testing.assert_allclose(found["center"], center, rtol=1e-12)
    np.testing.assert_allclose(found["momentum"], expected, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(found["matrix"] @ qd, expected, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(found["kinetic"], 0.5 * masses @ np.sum(velocities**2, axis=1), rtol=1e-12)
    np.testing.assert_allclose(found["potential"], -masses @ places @ GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(found["mass"], masses.sum(), rtol=1e-14)


def test_frames_move_as_their_jacobians_say() -> None:
    tree = mimicking_tree()
    robot = tree.mechanism
    qd, qdd = np.random.default_rng(3).normal(size=(2, robot.dofs))
    kinds = {"body": BODY, "world": WORLD, "aligned": ALIGNED}
    wanted: dict[str, tx.Expr] = {"pose": robot.pose("tool"), "hinge": robot.pose("hinge", relative_to="tool")}
    for frame in ("tool", "hinge"):
        for name, axes in kinds.items():
            wanted[f"{frame} J {name}"] = mechanics.frame_jacobian(robot, frame, axes=axes)
            wanted[f"{frame} rate {name}"] = mechanics.frame_jacobian_rate(robot, frame, axes=axes)
            wanted[f"{frame} V {name}"] = mechanics.frame_twist(robot, frame, axes=axes)
    step = 1e-5
    times = jax.tree.map(lambda *own: np.stack(own), *(tree.moved(qd, time) for time in (0.0, step, -step)))
    three = {
        name: np.asarray(own) for name, own in jax.jit(jax.vmap(lambda x: tx.lower(wanted)(0.0, x)))(times).items()
    }
    found = {name: own[0] for name, own in three.items()}
    differences = {name: (own[1] - own[2]) / (2.0 * step) for name, own in three.items()}
    zero = jnp.zeros(robot.dofs)
    at = tree.poses(zero)
    np.testing.assert_allclose(found["pose"], at["tool"], atol=1e-13)
    np.testing.assert_allclose(found["hinge"], np.linalg.inv(at["tool"]) @ at["hinge"], atol=1e-12)

    def twists(d: jax.Array, rate: jax.Array, frame: str) -> dict[str, jax.Array]:
        T, dT = jax.jvp(lambda d: tree.poses(d)[frame], (d,), (rate,))
        turning = dT[:3, :3] @ T[:3, :3].T
        w = jnp.stack([turning[2, 1], turning[0, 2], turning[1, 0]])
        aligned = jnp.concatenate([dT[:3, 3], w])
        world = jnp.concatenate([dT[:3, 3] + jnp.cross(T[:3, 3], w), w])
        turned = jnp.concatenate([T[:3, :3].T @ dT[:3, 3], T[:3, :3].T @ w])
        return {"body": turned, "world": world, "aligned": aligned}

    for frame in ("tool", "hinge"):
        ours = jax.jit(functools.partial(twists, frame=frame))
        V, rate = jax.jvp(ours, (zero, jnp.asarray(qd)), (jnp.asarray(qd), jnp.asarray(qdd)))
        for name in kinds:
            J = found[f"{frame} J {name}"]
            np.testing.assert_allclose(J @ qd, V[name], rtol=1e-11, atol=1e-11)
            np.testing.assert_allclose(found[f"{frame} V {name}"], V[name], rtol=1e-11, atol=1e-11)
            expected = J @ qdd + found[f"{frame} rate {name}"] @ qd
            np.testing.assert_allclose(expected, rate[name], rtol=1e-10, atol=1e-9)
            # Along qd itself ad_V V = 0 hides how the frame turns: every column against differences.
            np.testing.assert_allclose(found[f"{frame} rate {name}"], differences[f"{frame} J {name}"], atol=1e-7)


def test_outer_wrenches_act_through_the_jacobian() -> None:
    tree = free_tree()
    robot = tree.mechanism
    qd, qdd, F = np.random.default_rng(4).normal(size=(3, robot.dofs))
    wrench = {"tool": F[:6], "hinge": F[6:12]}
    found = evaluated(
        {
            "with": mechanics.inverse_dynamics(robot, qdd=qdd, wrenches=wrench),
            "without": mechanics.inverse_dynamics(robot, qdd=qdd),
            "tool": mechanics.frame_jacobian(robot, "tool"),
            "hinge": mechanics.frame_jacobian(robot, "hinge"),
            "back": mechanics.forward_dynamics(
                robot, tau=mechanics.inverse_dynamics(robot, qdd=qdd, wrenches=wrench), wrenches=wrench
            ),
        },
        tree.inputs(qd=qd),
    )
    pushed = found["tool"].T @ F[:6] + found["hinge"].T @ F[6:12]
    np.testing.assert_allclose(found["without"] - found["with"], pushed, rtol=1e-11, atol=1e-10)
    np.testing.assert_allclose(found["back"], qdd, rtol=1e-9, atol=1e-8)


def test_wrench_of_a_joint_is_what_its_bodies_need() -> None:
    """Of the ball's link and all beyond it: rate of momentum less gravity, about the origin of the ball's frame."""
    tree = free_tree()
    robot = tree.mechanism
    qd, qdd = np.random.default_rng(5).normal(size=(2, robot.dofs))
    found = evaluated(
        {
            "own": mechanics.joint_wrench(robot, "ball", qdd=qdd),
            "base": mechanics.joint_wrench(robot, "ball", qdd=qdd, frame="base"),
        },
        tree.inputs(qd=qd),
    )

    def beyond(d: jax.Array) -> jax.Array:
        poses = tree.poses(d)
        parts = [
            (poses[joint.name], cloud) for joint, _, _, cloud in tree.plan if joint.name in ("ball", "screw", "tool")
        ]
        return jnp.concatenate([cloud.points @ T[:3, :3].T + T[:3, 3][None] for T, cloud in parts if cloud is not None])

    masses = np.concatenate([c.masses for joint, _, _, c in tree.plan if joint.name in ("ball", "screw", "tool") and c])
    zero = jnp.zeros(robot.dofs)
    velocity = lambda d, rate: jax.jvp(beyond, (d,), (rate,))[1]  # noqa: E731
    _, acceleration = jax.jvp(velocity, (zero, jnp.asarray(qd)), (jnp.asarray(qd), jnp.asarray(qdd)))
    force = masses[:, None] * (np.asarray(acceleration) - GRAVITY)
    places, T = np.asarray(beyond(zero)), np.asarray(tree.poses(zero)["ball"])
    np.testing.assert_allclose(
        found["base"], np.concatenate([force.sum(axis=0), np.cross(places, force).sum(axis=0)]), rtol=1e-10, atol=1e-9
    )
    local, arms = force @ T[:3, :3], (places - T[:3, 3]) @ T[:3, :3]
    np.testing.assert_allclose(
        found["own"], np.concatenate([local.sum(axis=0), np.cross(arms, local).sum(axis=0)]), rtol=1e-10, atol=1e-9
    )


DRIVES = {
    "rod": Drive(armature=0.4, damping=0.3, gear=3.0, effort=5.0, lower=-1.0, upper=2.0),
    "ball": Drive(armature=0.2),
    "hinge": Drive(stiffness=4.0, rest=0.3, friction=0.6, friction_speed=0.05, damping=0.1),
}


@pytest.mark.parametrize(
    "mimic",
    # Without a mimic its ratio is one and its offset zero.
    [pytest.param(None, marks=pytest.mark.slow), Mimic("slide", ratio=-1.7, offset=0.4)],
    ids=["none", "mimic"],
)
def test_drives_enter_the_dynamics(mimic: Mimic | None) -> None:
    tree = Tree(mimic, **DRIVES)
    robot, bare = tree.mechanism, Tree(mimic).mechanism
    dynamics = tx.compile(robot.system(controls=["slide", "rod"]), backend=tx.JAX())
    qd = np.random.default_rng(6).normal(size=robot.dofs)
    state, command = tree.inputs(qd=qd), {"tau": np.array([0.5, 0.7, -0.4])}
    rate = np.asarray(dynamics(0.0, state, command)["qd"])
    tau = np.zeros(robot.dofs)
    tau[robot.freedoms(["slide", "rod"])] = 0.5, 3.0 * 0.7, 3.0 * -0.4
    at = robot.freedoms(["rod"])
    tau[at] -= 0.3 * qd[at]
    (i,), where = robot.freedoms(["hinge"]), robot.segment_of("hinge").coordinates
    ratio, offset = (1.0, 0.0) if mimic is None else (mimic.ratio, mimic.offset)
    position, speed = ratio * tree.start["q"][where][0] + offset, ratio * qd[i]
    tau[i] -= ratio * (0.1 * speed + 0.6 * np.tanh(speed / 0.05) + 4.0 * (position - 0.3))
    rotors = np.zeros(robot.dofs)
    rotors[at], rotors[robot.freedoms(["ball"])] = 0.4, 0.2
    x = tx.State("x", (robot.dofs,))
    need = evaluated(
        {"tau": mechanics.inverse_dynamics(bare, qdd=x), "with": mechanics.inverse_dynamics(robot, qdd=x)},
        state | {"x": rate},
    )
    np.testing.assert_allclose(need["tau"] + rotors * rate, tau, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(need["with"], tau, rtol=1e-9, atol=1e-8)
    mass = evaluated({"a": mechanics.mass_matrix(robot), "b": mechanics.mass_matrix(bare)}, state)
    np.testing.assert_allclose(mass["a"] - mass["b"], np.diag(rotors), atol=1e-12)


def test_outputs_of_the_accelerations_of_the_motion() -> None:
    """The force in the bearing of a pendulum with spring and damper: m (a - g) of its centre of mass."""
    m, length, k, c, g = 2.0, 0.7, 5.0, 0.3, 9.81
    body = SpatialInertia(mass=m, center_of_mass=(0.0, 0.0, -length), inertia=0.1 * np.eye(3))
    hinge = Link(joints.Revolute("hinge", (0.0, 1.0, 0.0)), body, tx.pose(), drive=Drive(stiffness=k, damping=c))
    robot = Mechanism([hinge])

    def outputs(qdd: tx.Expr, tau: tx.Expr) -> dict[str, tx.Expr]:
        return {"load": mechanics.joint_wrench(robot, "hinge", qdd=qdd, frame="base"), "tau": tau}

    dynamics = tx.compile(robot.system(controls=[], outputs=outputs), backend=tx.JAX())
    q, w = 0.4, 1.5
    state = {"q": np.array([q]), "qd": np.array([w])}
    acceleration = (-m * g * length * np.sin(q) - k * q - c * w) / (0.1 + m * length**2)
    out, along = np.array([-np.sin(q), 0.0, -np.cos(q)]), np.array([-np.cos(q), 0.0, np.sin(q)])
    force = m * (length * (acceleration * along - w**2 * out) + np.array([0.0, 0.0, g]))
    found = dynamics.outputs(0.0, state)
    np.testing.assert_allclose(found["tau"], [-k * q - c * w], rtol=1e-14)
    np.testing.assert_allclose(found["load"], [*force, 0.0, -k * q - c * w, 0.0], atol=1e-12)
    with pytest.raises(tx.ModelError, match=r"outputs expects a function of \(qdd, tau\)"):
        robot.system(outputs=lambda qdd: {"qdd": qdd})  # type: ignore[arg-type, misc]


def test_a_copy_has_other_drives_and_the_rest_as_it_was() -> None:
    bar = SpatialInertia(mass=1.0, center_of_mass=(0.0, 0.0, -0.5), inertia=0.1 * np.eye(3))
    y, held = (0.0, 1.0, 0.0), Drive(damping=0.1, upper=1.0)
    links = [
        Link(joints.Revolute("a", y), bar, tx.pose(), drive=held),
        Link(joints.Revolute("b", y), bar, tx.pose(position=(0.0, 0.0, -1.0)), parent="a", drive=held),
        Link(joints.Fixed("tip"), None, tx.pose(position=(0.0, 0.0, -1.0)), parent="b"),
    ]
    whole = {"gravity": (0.0, 0.0, -1.6), "base": "moon", "keep": ["tip"], "notes": ["a file's"], "driven": ["b"]}
    arm = Mechanism(links, loops=[loops.PointLoop("shut", "tip", "moon")], **whole)  # type: ignore[arg-type]
    sprung = arm.replace(drives={"b": Drive(stiffness=5.0)})
    assert [link.drive.stiffness for link in sprung.links] == [0.0, 5.0, 0.0]
    assert sprung.links[0].drive == held
    assert (sprung.base, sprung.driven, sprung.loops, sprung.notes[0]) == ("moon", ("b",), arm.loops, "a file's")
    assert sprung.gravity.key() == arm.gravity.key()
    assert len(sprung.segments) == len(arm.segments) == 3
    assert not arm.replace(loops=()).loops
    shorter = arm.replace(links=links[:2], loops=(), drives={"b": Drive(stiffness=5.0)})
    assert [link.drive.stiffness for link in shorter.links] == [0.0, 5.0]
    assert repr(sprung.links[1].drive) == "Drive(stiffness=5.0)"
    assert repr(sprung.links[2]) == "Link(joint=Fixed('tip'), body=None, mount=Constant(4, 4), parent='b', name='tip')"
    with pytest.raises(tx.ModelError, match=r"there is no joint 'c'; known are 'a', 'b', 'tip'"):
        arm.replace(drives={"c": held})
    with pytest.raises(tx.ModelError, match=r"has no argument 'drive'.*\n.*did you mean 'drives'"):
        arm.replace(drive=held)


def test_limits_are_bounds_of_states_and_controls() -> None:
    robot = Tree(None, rod=DRIVES["rod"], hinge=Drive(speed=2.5)).mechanism
    system = robot.system(controls=["rod", "slide"])
    q, tau = (next(leaf for leaf in (*system.states, *system.controls) if leaf.name == name) for name in ("q", "tau"))
    at = robot.segment_of("rod").coordinates
    assert np.isneginf(q.min).sum() == len(q.min) - 2
    np.testing.assert_array_equal([q.min[at], q.max[at]], [[-1.0, -1.0], [2.0, 2.0]])
    np.testing.assert_array_equal(tau.max, [5.0, 5.0, np.inf])
    (i,) = robot.freedoms(["hinge"])
    assert robot.qd.max[i] == 2.5
    assert robot.qd.min[i] == -2.5


def test_what_is_no_tree_is_refused(unchecked: None) -> None:
    ball = SpatialInertia(mass=1.0, inertia=np.eye(3))

    def link(name: str, parent: str | None = None, body: SpatialInertia | None = ball, **other: Any) -> Link:
        return Link(joints.Revolute(name, (0.0, 0.0, 1.0)), body, np.eye(4), parent=parent, **other)

    with pytest.raises(tx.ModelError, match=r"'b' has the parent 'arm'(.|\n)*did you mean 'arm1'"):
        Mechanism([link("arm1"), link("b", "arm")])
    with pytest.raises(tx.ModelError, match=r"'a', 'b' are not connected to the base"):
        Mechanism([link("a", "b"), link("b", "a"), link("c")])
    with pytest.raises(tx.ModelError, match="two links are named 'a'"):
        Mechanism([link("a"), link("a")])
    with pytest.raises(tx.ModelError, match="joint 'b' carries no mass"):
        Mechanism([link("a"), link("b", "a", None)]).system()
    with pytest.raises(tx.ModelError, match="'b' mimics 'c'"):
        Mechanism([link("a"), link("b", "a", mimic=Mimic("c"))])
    with pytest.raises(tx.ModelError, match="a Mimic as mimic, and a joint with one degree of freedom"):
        Link(joints.Spherical("ball"), ball, np.eye(4), mimic=Mimic("a"))
    with pytest.raises(tx.ModelError, match="damping not to be negative, got -1"):
        Drive(damping=-1.0)
    with pytest.raises(tx.ModelError, match="lower to be at most upper"):
        Drive(lower=1.0, upper=-1.0)
    tree = free_tree().mechanism
    with pytest.raises(tx.ModelError, match="positions of 'root', 'ball' are on groups"):
        mechanics.mass_matrix(tree, np.zeros(3))
    with pytest.raises(tx.ModelError, match=r"no frame 'tol'(.|\n)*did you mean 'tool'"):
        tree.pose("tol")
    with pytest.raises(tx.ModelError, match=r"no moving joint 'tool'(.|\n)*keep="):
        mechanics.joint_wrench(tree, "tool")


def test_a_kept_joint_that_is_fixed_carries_the_wrench_of_what_is_beyond() -> None:
    ball = SpatialInertia(mass=2.0, center_of_mass=(0.1, 0.0, 0.0), inertia=np.eye(3))
    links = [
        Link(joints.Revolute("hinge", (0.0, 1.0, 0.0)), ball, np.eye(4)),
        Link(joints.Fixed("sensor"), ball, tx.pose(position=[0.5, 0.0, 0.0]), parent="hinge"),
    ]
    robot = Mechanism(links, keep=["sensor"])
    zero = np.zeros(1)
    F = tx.lower(mechanics.joint_wrench(robot, "sensor", zero, zero))(0.0)
    np.testing.assert_allclose(F, [0.0, 0.0, 2.0 * 9.81, 0.0, -0.1 * 2.0 * 9.81, 0.0], atol=1e-12)
    merged = Mechanism(links)
    x = np.array([0.7])
    both = [tx.lower(mechanics.forward_dynamics(each, x, x, x))(0.0) for each in (robot, merged)]
    np.testing.assert_allclose(*both, rtol=1e-13)
