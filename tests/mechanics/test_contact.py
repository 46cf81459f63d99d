"""A ground that gives way, and given forces at contacts."""

import dataclasses
import functools
from typing import Any, cast

import jax
import numpy as np
import pytest

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import Ground, Link, Mechanism, SpatialInertia, joints

GROUND = Ground(stiffness=1e4, damping=0.3, friction=0.6, height=0.2, sharpness=1e-5, slip=0.02)


@functools.cache
def block() -> Mechanism:
    """A body of 2 kg with a point 0.1 m below its centre."""
    body = SpatialInertia(mass=2.0, inertia=np.diag([0.02, 0.03, 0.04]))
    low = tx.pose(position=[0.0, 0.0, -0.1], euler=[0.3, -0.2, 0.4])
    return Mechanism(
        [Link(joints.Free("block"), body, np.eye(4)), Link(joints.Fixed("low"), None, low, parent="block")]
    )


def test_the_ground_pushes_and_rubs() -> None:
    place, velocity = tx.State("p", (3,)), tx.State("v", (3,))
    force = jax.jit(tx.lower(GROUND.force(place, velocity)))

    def of(z: float, v: list[float]) -> np.ndarray:
        return np.asarray(force(0.0, {"p": np.array([3.0, 4.0, z]), "v": np.array(v)}))

    np.testing.assert_allclose(of(0.19, [0.0, 0.0, 0.0]), [0.0, 0.0, 100.0], rtol=1e-6)
    np.testing.assert_allclose(of(0.19, [0.0, 0.0, -1.0])[2], 130.0, rtol=1e-6)
    np.testing.assert_allclose(of(0.19, [3.0, -4.0, 0.0])[:2], [-36.0, 48.0], rtol=1e-4)
    np.testing.assert_allclose(of(0.19, [0.02, 0.0, 0.0])[0], -60.0 / np.sqrt(2.0), rtol=1e-6)
    # It does not pull: not above, and not where the point leaves fast.
    assert 0.0 < of(0.25, [0.0, 0.0, 0.0])[2] < 1e-4
    assert 0.0 < of(0.19, [0.0, 0.0, 10.0])[2] < 1e-3


def test_the_force_acts_at_the_point_in_the_bases_axes() -> None:
    robot = block()
    x = {
        "block_position": tx.pose(position=[0.1, 0.2, 0.29], euler=[0.2, 0.1, -0.5]),
        "qd": np.array([0.3, -0.2, -0.4, 0.5, 0.1, -0.3]),
    }
    wrenches = GROUND.wrenches(robot, ["low"])
    F = mechanics.inverse_dynamics(robot, wrenches=wrenches) - mechanics.inverse_dynamics(robot)
    found = evaluated({"tau": F, "F": wrenches["low"]}, x)
    R, p = x["block_position"][:3, :3], x["block_position"][:3, 3]
    arm, w = np.array([0.0, 0.0, -0.1]), x["qd"][3:]
    velocity = R @ (x["qd"][:3] + np.cross(w, arm))
    f = np.asarray(evaluated(GROUND.force(tx.Constant(p + R @ arm), tx.Constant(velocity))))
    assert f[2] > 10.0
    np.testing.assert_allclose(-found["tau"], np.concatenate([R.T @ f, np.cross(arm, R.T @ f)]), rtol=1e-9, atol=1e-9)


def test_given_forces_have_cones_and_points_at_rest() -> None:
    robot = block()
    given = mechanics.given_forces(robot, ["low"], friction=0.5)
    system = robot.system(controls=[], wrenches=given.wrenches, constraints=given.cones | given.at_rest)
    dynamics = tx.compile(system, backend=tx.JAX())
    R = tx.pose(position=[0.1, 0.2, 0.29], euler=[0.2, 0.1, -0.5])[:3, :3]
    V, f = np.array([0.3, -0.2, -0.4, 0.5, 0.1, -0.3]), np.array([3.0, -4.0, 8.0])
    x = {"block_position": tx.pose(position=[0.1, 0.2, 0.29], euler=[0.2, 0.1, -0.5]), "qd": V}
    found = dynamics.constraints(0.0, x, {"force_low": f})
    np.testing.assert_allclose(found["inequality"], [5.0 - 4.0], atol=1e-12)
    np.testing.assert_allclose(found["equality"], R @ (V[:3] + np.cross(V[3:], [0.0, 0.0, -0.1])), atol=1e-12)
    rate = np.asarray(dynamics(0.0, x, {"force_low": f})["qd"])
    np.testing.assert_allclose(
        R @ (rate[:3] + np.cross(V[3:], V[:3])), f / 2.0 + np.array([0.0, 0.0, -9.81]), atol=1e-12
    )


SLOPE = np.deg2rad(20.0)


@functools.cache
def on_a_slope(friction: float) -> tx.Dynamics:
    """A block of 2 kg on a slope of 20 degrees, whose normal is z, that slides along x and y and sinks along z."""
    body = SpatialInertia(mass=2.0, inertia=np.eye(3))
    x, y, z = (joints.Prismatic(name, axis) for name, axis in zip("xyz", np.eye(3), strict=True))
    links = [Link(x, None, np.eye(4)), Link(y, None, np.eye(4), parent="x"), Link(z, body, np.eye(4), parent="y")]
    robot = Mechanism(links, gravity=9.81 * np.array([np.sin(SLOPE), 0.0, -np.cos(SLOPE)]))
    grip = Ground(stiffness=1e4, damping=1.0, friction=friction).bristles(robot, ["z"])
    return tx.compile(robot.system(controls=[], rates=grip.rates, wrenches=grip.wrenches))


@pytest.mark.parametrize("friction", [0.5, 0.2])
def test_a_block_on_a_slope_rests_within_its_friction_cone_alone(friction: float) -> None:
    """By Coulomb's law: it stays where mu exceeds tan 20 degrees, else a = g (sin 20 - mu cos 20)."""
    sunk = 2.0 * 9.81 * np.cos(SLOPE) / 1e4
    rests = friction > np.tan(SLOPE)
    bend = np.zeros(2) if rests else np.array([1e-3 * np.cos(SLOPE), 0.0])  # where the slider moves from the start
    x0 = {"q": np.array([0.0, 0.0, -sunk]), "qd": np.zeros(3), "bristle_z": bend}
    times = np.array([1.0, 1.5, 2.0])
    sol = tx.integrate(on_a_slope(friction), x0, t1=2.0, dt=2e-4, save_at=times)
    along, speed = np.asarray(sol.xs["q"])[:, 0], np.asarray(sol.xs["qd"])[:, 0]
    if rests:
        # The bristle bends until it carries the weight, by d sin 20 / mu, and the block moves by no more than that.
        bent = 1e-3 * np.sin(SLOPE) / friction
        np.testing.assert_allclose(sol.xs["bristle_z"][-1], [bent, 0.0], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(along[-1], bent, rtol=1e-8)
        np.testing.assert_allclose(speed[-1], 0.0, atol=1e-10)
    else:
        expected = 9.81 * (np.sin(SLOPE) - friction * np.cos(SLOPE))
        np.testing.assert_allclose(speed, expected * times, rtol=1e-5)
        np.testing.assert_allclose(along, expected * times**2 / 2.0, rtol=1e-5)


@pytest.mark.parametrize(
    "height", [0.0, lambda x, y: 0.3 * x + 0.2 * tx.Sin(3.0 * y) + 0.5 * x * y], ids=["level", "hills"]
)
def test_bristles_store_or_dissipate_what_a_point_supplies_under_any_normal_force(height: Any) -> None:
    """-f v = d/dt (k |z|^2 / 2) + c |z'|^2 + (power of the slider), the last two not negative, at random states."""
    mu, load, d, sigma = 0.5, 30.0, 2e-3, 15.0
    place = joints.Prismatic("z", np.eye(3)[2])
    links = [Link(joints.Prismatic(n, a), None, np.eye(4), parent=q) for n, a, q in zip("xy", np.eye(3), [None, "x"])]
    links.append(Link(place, SpatialInertia(mass=2.0, inertia=np.eye(3)), np.eye(4), parent="y"))
    robot, ground = Mechanism(links), Ground(stiffness=1e4, damping=1.0, friction=mu, height=height)
    grip = ground.bristles(robot, ["z"], deflection=d, damping=sigma, load=load)
    (z, rate), k, c = next(iter(grip.rates.items())), mu * load / d, mu * load * sigma
    place = robot.pose("z")[:3, 3]
    normal = dataclasses.replace(ground, friction=0.0).force(place, robot.qd)
    n, f = tx.linalg.Norm(normal), grip.wrenches["z"][:3] - normal
    slider = -(f @ robot.qd) - k * (z @ rate) - c * (rate @ rate)
    every = tx.lower(tx.Concat(slider, tx.linalg.Norm(k * z + c * rate), f @ normal / n, n, f))
    random, count = np.random.default_rng(0), 4000
    size = 10.0 ** random.uniform(-3.0, 1.0, (2, count, 1))
    x = {
        "q": np.stack([np.zeros(count), np.zeros(count), random.uniform(-0.01, 0.002, count)], axis=1),
        "qd": size[0] * random.normal(size=(count, 3)) * 0.1,
        "bristle_z": size[1] * random.normal(size=(count, 2)) * d,
    }
    slider, size, across, n, *f = np.asarray(jax.jit(jax.vmap(lambda x: every(0.0, x)))(x)).T
    friction = np.linalg.norm(f, axis=0)
    np.testing.assert_allclose(friction, size, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(across, 0.0, atol=1e-9 * n.max())
    assert slider.min() >= -1e-12 * slider.max()
    assert friction.max() > 20.0
    assert (friction <= mu * n * (1.0 + 1e-9) + 1e-7).all()
    y = np.linalg.norm(k * x["bristle_z"] + c * x["qd"][:, :2], axis=1)
    if callable(height):  # v is not along x and y
        return
    for here, expected in ((y > 1.02 * mu * n + 1e-6, mu * n), (y < 0.98 * mu * n, y)):
        assert here.sum() > 200
        np.testing.assert_allclose(friction[here], expected[here], rtol=1e-6, atol=1e-6)


@pytest.mark.thorough
def test_a_block_on_its_edges_comes_to_rest_on_a_slope() -> None:
    """With the default damping of the ground, and friction that follows the normal force at once, its rocking grows."""
    x, z = (joints.Prismatic(name, axis) for name, axis in (("x", [1.0, 0.0, 0.0]), ("z", [0.0, 0.0, 1.0])))
    body = SpatialInertia(mass=2.0, inertia=0.02 * np.eye(3))
    links = [Link(x, None, np.eye(4)), Link(z, None, np.eye(4), parent="x")]
    links.append(Link(joints.Revolute("pitch", [0.0, 1.0, 0.0]), body, np.eye(4), parent="z"))
    edges = {name: tx.pose(position=[at, 0.0, -0.05]) for name, at in (("back", -0.1), ("front", 0.1))}
    links += [Link(joints.Fixed(name), None, at, parent="pitch") for name, at in edges.items()]
    block = Mechanism(links, gravity=9.81 * np.array([np.sin(SLOPE), 0.0, -np.cos(SLOPE)]))
    grip = Ground(stiffness=4e4, friction=0.5).bristles(block, list(edges))
    system = tx.compile(block.system(controls=[], rates=grip.rates, wrenches=grip.wrenches))
    x0 = {"q": np.array([0.0, 0.05 - 2e-4, 0.0]), "qd": np.zeros(3)} | {f"bristle_{n}": np.zeros(2) for n in edges}
    method = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)
    sol = tx.integrate(system, x0, t1=4.0, rtol=1e-6, method=method, save_at=np.array([0.1, 2.0, 4.0]))
    q, speed = np.asarray(sol.xs["q"]), np.abs(np.asarray(sol.xs["qd"])).max(axis=1)
    assert speed[0] > 1e-3
    assert speed[-1] < 1e-6
    np.testing.assert_allclose(q[2], q[1], atol=1e-6)
    deflection = sum(np.asarray(sol.xs[f"bristle_{name}"])[2, 0] for name in edges)
    np.testing.assert_allclose(deflection, 2.0 * 1e-3 * np.sin(SLOPE) / 0.5, rtol=1e-6)  # they carry the weight


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ground(stiffness=0.0), "Ground: stiffness must be a positive number, got 0.0"),
        (lambda: Ground(friction=-1.0), "Ground: friction must be a number not below zero"),
        (lambda: Ground(friction=tx.Parameter("mu", value=-0.5)), "friction must be a number not below zero, got -0.5"),
        (lambda: Ground(friction=tx.Parameter("mu") > 0.5), "friction must be a number not below zero, got the condit"),
        (lambda: Ground(height=np.nan), "height must be a finite number, got nan"),
        (lambda: Ground(height=tx.State("h")), "height to be constant during the motion"),
        (lambda: Ground(friction=tx.State("mu")).bristles(block(), ["low"]), "friction to be constant during the mot"),
        (lambda: GROUND.bristles(block(), {"low": cast(Any, tx.view.Box((0.1, 0.1, 0.1)))}), "a Sphere or a Capsule"),
        (lambda: GROUND.wrenches(block(), cast(Any, [1])), "frames expects names"),
        (lambda: mechanics.given_forces(block(), ["low"], friction=-0.1), "friction must be a number not below zero"),
        (lambda: mechanics.given_forces(block(), ["foot"], friction=0.1), "no frame 'foot'"),
        (lambda: GROUND.wrenches(block(), ["foot"]), "no frame 'foot'"),
        (lambda: GROUND.bristles(block(), ["low"], deflection=0.0), "deflection must be a positive number, got 0.0"),
        (lambda: GROUND.bristles(block(), ["low"], damping=0.0), "damping must be a positive number, got 0.0"),
        (lambda: GROUND.bristles(block(), ["low"], load=-1.0), "load must be a positive number, got -1.0"),
        (lambda: Ground(friction=0.0).bristles(block(), ["low"]), "a ground with friction"),
    ],
)
def test_what_makes_no_sense_is_refused(make: object, message: str, unchecked: None) -> None:
    with pytest.raises(tx.ModelError, match=message):
        make()  # type: ignore[operator]


def test_a_height_field_that_is_a_tilted_plane_pushes_along_its_normal() -> None:
    slope, rate = np.array([0.3, -0.2]), np.array([0.4, 0.3, -0.5])
    field = Ground(stiffness=1e4, damping=0.3, friction=0.6, height=lambda x, y: 0.3 * x - 0.2 * y + 0.1, slip=0.02)
    level = Ground(stiffness=1e4, damping=0.3, friction=0.6, slip=0.02)
    up = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope)
    across = np.cross(up, [1.0, 0.0, 0.0])
    R = np.stack([np.cross(across, up) / np.linalg.norm(across), across / np.linalg.norm(across), up])
    p = np.array([1.0, 2.0, 0.3 - 0.4 + 0.1]) - 0.01 * up  # 1 cm below the plane
    found = np.asarray(evaluated(field.force(tx.Constant(p), tx.Constant(rate))))
    flat = np.asarray(evaluated(level.force(tx.Constant([0.0, 0.0, -0.01]), tx.Constant(R @ rate))))
    np.testing.assert_allclose(found, R.T @ flat, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "shape", [None, tx.view.Sphere(0.05), tx.view.Capsule(0.03, 0.1, at=(0.02, 0.0, 0.0))], ids=repr
)
def test_bristles_over_a_tilted_plane_are_those_over_level_ground_in_its_axes(shape: Any, unchecked: None) -> None:
    robot, n = block(), np.array([-0.3, 0.2, 1.0]) / np.sqrt(1.13)
    axis = np.cross([0.0, 0.0, 1.0], n)
    R = np.asarray(tx.lie.so3.exp(axis * np.arcsin(np.linalg.norm(axis)) / np.linalg.norm(axis)))
    frames = ["block"] if shape is None else {"block": shape}
    heights: Any = (0.0, lambda x, y: 0.3 * x - 0.2 * y)
    T = tx.pose(position=[0.01, 0.02, -0.002 if shape is None else 0.045], euler=[0.3, 0.2, -0.5])
    turned, results = np.eye(4), []
    turned[:3, :3] = R
    for height, at in zip(heights, (T, turned @ T), strict=True):
        grip = Ground(stiffness=1e4, friction=0.6, height=height).bristles(robot, frames)
        (state, rate), (wrench,) = next(iter(grip.rates.items())), grip.wrenches.values()
        x = {"block_position": at, "qd": np.array([0.3, -0.2, -0.1, 0.5, 0.1, -0.3])}
        bend = np.linspace(1e-4, 4e-4, state.shape[0])
        results.append(np.asarray(evaluated(tx.Concat(rate, wrench), x | {state.name: bend})))
        bend[-2:] *= 2.0  # the last point alone
        other = np.asarray(evaluated(tx.Concat(rate, wrench), x | {state.name: bend}))
        moved = np.abs(other - results[-1])[:-6] > 1e-9
        assert list(moved) == [False] * (len(moved) - 2) + [True, True]
    assert np.linalg.norm(results[0][-6:-3]) > 10.0
    np.testing.assert_allclose(results[1], results[0], rtol=1e-9, atol=1e-9)


def test_a_ball_rolls_with_five_sevenths_of_the_slope_for_each_friction() -> None:
    """I = 2/5 m r^2: a = 5/7 g sin s while mu > 2/7 tan s, else a = g (sin s - mu cos s). One kernel for all mu."""
    m, radius, mu = 2.0, 0.1, tx.Parameter("mu")
    body = SpatialInertia(mass=m, inertia=0.4 * m * radius**2 * np.eye(3))
    gravity = 9.81 * np.array([np.sin(SLOPE), 0.0, -np.cos(SLOPE)])
    ball = Mechanism([Link(joints.Free("ball"), body, np.eye(4))], gravity=gravity)
    grip = Ground(stiffness=1e5, damping=1.0, friction=mu).bristles(ball, {"ball": tx.view.Sphere(radius)}, 1e-5, 200.0)
    rolling = tx.compile(ball.system(controls=[], rates=grip.rates, wrenches=grip.wrenches))
    height = radius - m * 9.81 * np.cos(SLOPE) / 1e5
    x0 = {"ball_position": tx.pose(position=[0.0, 0.0, height]), "qd": np.zeros(6), "bristle_ball": np.zeros(2)}

    def path(friction: Any) -> Any:
        return tx.integrate(rolling, x0, t1=0.5, dt=1e-4, params={"mu": friction}).last["ball_position"][0, 3]

    found = np.asarray(jax.vmap(path)(np.array([0.05, 0.3])))
    expected = 9.81 * np.array([np.sin(SLOPE) - 0.05 * np.cos(SLOPE), 5.0 / 7.0 * np.sin(SLOPE)])
    np.testing.assert_allclose(found, expected * 0.5**2 / 2.0, rtol=2e-3)


def test_the_normal_force_of_hills_has_a_potential() -> None:
    """Without damping F = -dV/dp by differences, V the integral of k s(d), d the depth below the tangent plane."""
    k, width = 1e3, 1e-3
    hills = Ground(
        stiffness=k, damping=0.0, friction=0.0, height=lambda x, y: tx.Sin(3.0 * x) * tx.Cos(2.0 * y), sharpness=width
    )

    def potential(p: np.ndarray) -> float:
        sx, cx, sy, cy = np.sin(3.0 * p[0]), np.cos(3.0 * p[0]), np.sin(2.0 * p[1]), np.cos(2.0 * p[1])
        d = (sx * cy - p[2]) / np.sqrt(1.0 + (3.0 * cx * cy) ** 2 + (2.0 * sx * sy) ** 2)
        size = np.hypot(d, width)
        return float(k * (d * d + d * size + width**2 * np.arcsinh(d / width)) / 4.0)

    for p in ([0.3, 0.2, 0.7], [0.5, -0.4, 0.6], [-0.2, 1.0, 0.2]):
        F = np.asarray(evaluated(hills.force(tx.Constant(np.array(p)), tx.Constant(np.zeros(3)))))
        expected = [(potential(p - e) - potential(p + e)) / 2e-6 for e in 1e-6 * np.eye(3)]
        assert np.linalg.norm(F) > 0.1
        np.testing.assert_allclose(F, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.thorough
def test_a_capsule_tips_over_as_in_mujoco(unchecked: None) -> None:
    """A capsule on one end, inclined by 10 degrees, rolls and falls on its side; MuJoCo's contacts are as stiff."""
    mujoco = pytest.importorskip("mujoco")
    radius, length, mass, tilt = 0.05, 0.4, 1.2, np.deg2rad(10.0)
    inertia = np.array([mass * length**2 / 12.0 + mass * radius**2 / 4.0] * 2 + [mass * radius**2 / 2.0])
    text = f"""<mujoco><option timestep="2e-4" cone="elliptic" impratio="100" integrator="implicitfast"/>
    <default><geom solref="0.002 1" solimp="0.99 0.999 0.001" condim="3" friction="0.8 0 0"/></default>
    <worldbody><geom type="plane" size="5 5 .1"/><body><freejoint/>
    <inertial pos="0 0 0" mass="{mass}" diaginertia="{" ".join(map(str, inertia))}"/>
    <geom type="capsule" size="{radius} {length / 2.0}"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data, high = mujoco.MjData(model), length / 2.0 * np.cos(tilt) + radius
    data.qpos[:] = [0.0, 0.0, high, np.cos(tilt / 2.0), 0.0, np.sin(tilt / 2.0), 0.0]
    body = SpatialInertia(mass=mass, inertia=np.diag(inertia))
    robot = Mechanism([Link(joints.Free("rod"), body, np.eye(4))])
    ground = Ground(stiffness=1e5, damping=1.0, friction=0.8, slip=1e-3)
    shapes = {"rod": tx.view.Capsule(radius, length)}
    falling = tx.compile(robot.system(controls=[], wrenches=ground.wrenches(robot, shapes)))
    times = np.array([0.15, 0.3, 0.45, 1.5])
    start = {"rod_position": tx.pose(position=[0.0, 0.0, high - 1e-4], euler=[0.0, tilt, 0.0]), "qd": np.zeros(6)}
    poses = np.asarray(tx.integrate(falling, start, t1=1.5, dt=2e-5, save_at=times).xs["rod_position"])
    for t, T in zip(times, poses, strict=True):
        while data.time < t - 1e-9:
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(np.arccos(T[2, 2]), np.arccos(data.xmat[1].reshape(3, 3)[2, 2]), atol=1e-3)
        np.testing.assert_allclose(T[:3, 3], data.qpos[:3], atol=1e-3)


def test_balls_and_capsules_touch_the_ground_with_their_surface(unchecked: None) -> None:
    robot, ball, rod = block(), tx.view.Sphere(0.05), tx.view.Capsule(0.05, 0.4, at=(0.0, 0.0, 0.1))
    lying = tx.pose(position=[0.0, 0.0, 0.24], rotation=np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))
    x = {"block_position": lying, "qd": np.zeros(6)}
    contact = GROUND.wrenches(robot, {"block": rod})["block"], GROUND.wrenches(robot, {"block": ball})["block"]
    of_rod, of_ball = (np.asarray(evaluated(F, x)) for F in contact)
    np.testing.assert_allclose(lying[:3, :3] @ of_ball[:3], [0.0, 0.0, 100.0], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(lying[:3, :3] @ of_rod[:3], [0.0, 0.0, 200.0], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(lying[:3, :3] @ of_rod[3:], [0.0, -20.0, 0.0], rtol=1e-4, atol=1e-9)  # 0.1 m off
    with pytest.raises(tx.errors.ModelError, match="Sphere or a Capsule"):
        GROUND.wrenches(robot, {"block": cast(Any, tx.view.Box((0.1, 0.1, 0.1)))})


def test_a_ball_in_a_bowl_is_pushed_through_its_centre() -> None:
    """A bowl x^2 + y^2 with the radius of curvature 0.5 m; the ball's centre is off its axis and at rest."""
    bowl = Ground(stiffness=1e4, height=lambda x, y: x * x + y * y)
    ball = bowl.wrenches(block(), {"block": tx.view.Sphere(0.05)})["block"]
    x = {"block_position": tx.pose(position=[0.02, 0.0, 0.0495], euler=[0.4, 0.1, 0.3]), "qd": np.zeros(6)}
    F = np.asarray(evaluated(ball, x)).reshape(2, 3) @ x["block_position"][:3, :3].T
    slope = -F[0, 0] / F[0, 2]
    assert F[0, 2] > 5.0
    np.testing.assert_allclose(slope, 0.02 / 0.45, rtol=2e-2)  # of the line from the centre of curvature
    np.testing.assert_allclose(F[1] / (0.05 * F[0, 2]), 0.0, atol=0.02 * slope)


@pytest.mark.parametrize("height", [tx.Parameter("rise", value=2.0), tx.Time(), tx.State("w", (2,))], ids=repr)
def test_a_height_field_of_more_than_x_and_y_is_refused(height: Any) -> None:
    with pytest.raises(tx.errors.ModelError, match="scalar expression of x and y alone"):
        Ground(height=lambda x, y: height * x).upward(tx.State("p", (3,)))
