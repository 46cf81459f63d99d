"""Bodies against clouds of point masses, and in flight against exact solutions."""

from typing import Any

import jax
import numpy as np
import pytest
from mechanics_oracles import Cloud, pose
from scipy.special import ellipj

import twistax as tx
from oracles import skew
from twistax.mechanics import SpatialInertia, joints, power

RNG = np.random.default_rng(11)
FIRST, SECOND = Cloud.random(RNG), Cloud.random(RNG)
#: The first cloud seen from its own centre of mass.
CENTERED = Cloud(FIRST.points - FIRST.center, FIRST.masses)
CLOUDS = {"offset": FIRST, "centered": CENTERED}

V, F = tx.State("V", shape=(6,)), tx.State("F", shape=(6,))
T, g = tx.State("T", group=tx.SE3), tx.State("g", shape=(3,))
VALUES = {"V": RNG.normal(size=6), "F": RNG.normal(size=6), "T": pose(RNG), "g": RNG.normal(size=3)}


def body_of(cloud: Cloud) -> SpatialInertia:
    center = np.zeros(3) if cloud is CENTERED else cloud.center
    return SpatialInertia(mass=cloud.mass, center_of_mass=center, inertia=cloud.tensor_about(cloud.center))


def value(expr: tx.Expr, **more: Any) -> np.ndarray:
    """The value of an expression, simplified, on the case of this page."""
    canonical = expr.canonicalize()
    names = {leaf.name for leaf in tx.expr.leaves_of(canonical) if isinstance(leaf, tx.State)}
    known = {**VALUES, **more}
    return np.asarray(tx.lower(canonical)(0.0, {name: known[name] for name in names}))


# ---- against points -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CLOUDS)
def test_a_body_is_the_cloud_it_was_made_of(name: str) -> None:
    cloud, body = CLOUDS[name], body_of(CLOUDS[name])
    xi = VALUES["V"]
    np.testing.assert_allclose(value(body.matrix), cloud.mass_matrix(), atol=1e-12)
    np.testing.assert_allclose(value(body.momentum(V)), cloud.momentum(xi), atol=1e-12)
    np.testing.assert_allclose(value(body.kinetic_energy(V)), cloud.kinetic_energy(xi), rtol=1e-13)
    np.testing.assert_allclose(value(body.weight(T, g)), cloud.weight(VALUES["T"], VALUES["g"]), atol=1e-12)


@pytest.mark.parametrize("name", CLOUDS)
def test_the_rate_of_momentum_of_the_points_is_the_wrench(name: str) -> None:
    """World momentum of the points a moment later and before, under the acceleration found: their change is F."""
    cloud = CLOUDS[name]
    rate = value(body_of(cloud).acceleration(V, F))
    frame, xi = VALUES["T"], VALUES["V"]

    def world_momentum(s: float) -> np.ndarray:
        moved = frame @ np.asarray(tx.lie.se3.exp(s * xi + 0.5 * s**2 * rate))
        carried = cloud.masses[:, None] * (cloud.velocities(xi + s * rate) @ moved[:3, :3].T)
        points = cloud.moved(moved).points
        return np.concatenate([carried.sum(axis=0), np.cross(points, carried).sum(axis=0)])

    h = 1e-3
    change = (world_momentum(-2 * h) - 8 * world_momentum(-h) + 8 * world_momentum(h) - world_momentum(2 * h)) / (
        12 * h
    )
    force = frame[:3, :3] @ VALUES["F"][:3]
    torque = frame[:3, :3] @ VALUES["F"][3:] + np.cross(frame[:3, 3], force)
    np.testing.assert_allclose(change, np.concatenate([force, torque]), atol=1e-8)


def test_a_change_of_frame_moves_the_points() -> None:
    moved = body_of(FIRST).in_frame(VALUES["T"])
    np.testing.assert_allclose(value(moved.matrix), FIRST.moved(VALUES["T"]).mass_matrix(), atol=1e-11)
    np.testing.assert_allclose(value(body_of(FIRST).in_frame(T).matrix), value(moved.matrix), atol=1e-12)
    assert isinstance(moved.inertia, tx.Constant)
    back = moved.in_frame(tx.lie.Inverse(VALUES["T"]))
    np.testing.assert_allclose(value(back.matrix), FIRST.mass_matrix(), atol=1e-12)


def test_two_bodies_joined_are_the_cloud_of_both() -> None:
    both = FIRST.with_other(SECOND)
    joined = body_of(FIRST) + body_of(SECOND)
    np.testing.assert_allclose(joined.mass.value, both.mass, rtol=1e-15)
    np.testing.assert_allclose(joined.center_of_mass.value, both.center, atol=1e-14)
    np.testing.assert_allclose(joined.inertia.value, both.tensor_about(both.center), atol=1e-13)
    np.testing.assert_allclose(value(body_of(SECOND).merge(body_of(FIRST)).matrix), value(joined.matrix), atol=1e-13)
    with pytest.raises(TypeError):
        _ = body_of(FIRST) + 1.0


def test_point_masses_join_to_the_cloud() -> None:
    points = [
        SpatialInertia(mass=m, center_of_mass=r, inertia=np.zeros((3, 3)))
        for m, r in zip(FIRST.masses, FIRST.points, strict=True)
    ]
    body = points[0]
    for point in points[1:]:
        body = body + point
    np.testing.assert_allclose(value(body.matrix), FIRST.mass_matrix(), atol=1e-12)


def test_a_tensor_about_the_origin() -> None:
    origin = FIRST.tensor_about(np.zeros(3))
    body = SpatialInertia.about_origin(mass=FIRST.mass, center_of_mass=FIRST.center, inertia=origin)
    np.testing.assert_allclose(value(body.matrix), FIRST.mass_matrix(), atol=1e-12)
    with pytest.raises(tx.ModelError, match="not negative"):
        SpatialInertia.about_origin(mass=10.0, center_of_mass=[0.0, 0.0, 1.0], inertia=np.eye(3))


def test_values_may_be_expressions() -> None:
    """Parameters and states in place of numbers give the same body."""
    body, tensor = body_of(FIRST), FIRST.tensor_about(FIRST.center)
    free = SpatialInertia(
        mass=tx.State("m"),
        center_of_mass=tx.Parameter("c", value=FIRST.center),
        inertia=tx.State("scale") * tx.Constant(tensor),
    )
    for one, other in (
        (free.matrix, body.matrix),
        (free.acceleration(V, F), body.acceleration(V, F)),
        ((free + body_of(SECOND)).in_frame(T).momentum(V), (body + body_of(SECOND)).in_frame(T).momentum(V)),
    ):
        np.testing.assert_allclose(value(one, m=FIRST.mass, scale=1.0), value(other), atol=1e-11)


def test_power_is_force_times_velocity_in_every_frame() -> None:
    forces = RNG.normal(size=FIRST.points.shape)
    wrench = np.concatenate([forces.sum(axis=0), np.cross(FIRST.points, forces).sum(axis=0)])
    there, turned = FIRST.moved(VALUES["T"]).points, forces @ VALUES["T"][:3, :3].T
    moved = np.concatenate([turned.sum(axis=0), np.cross(there, turned).sum(axis=0)])
    twist = tx.lie.se3.vee(VALUES["T"] @ np.asarray(tx.lie.se3.hat(VALUES["V"])) @ np.linalg.inv(VALUES["T"]))
    exact = np.sum(forces * FIRST.velocities(VALUES["V"]))
    np.testing.assert_allclose(value(power(F, V), F=wrench), exact, rtol=1e-12)
    np.testing.assert_allclose(value(power(F, V), F=moved, V=np.asarray(twist)), exact, rtol=1e-12)
    in_frame = power(tx.lie.SE3AdjointDual(T) @ F, tx.lie.SE3Adjoint(T) @ V)
    np.testing.assert_allclose(value(in_frame, F=wrench), exact, rtol=1e-12)


# ---- what is just a body ------------------------------------------------------------------------------------------


def test_limits_of_bodies_are_bodies() -> None:
    """A plate, a rod, a point: on the edge, not beyond. Only the rod and the point cannot be turned freely."""
    plate = SpatialInertia(mass=1.0, inertia=np.diag([0.1, 0.2, 0.3]))
    assert np.isfinite(value(plate.acceleration(V, F))).all()
    turned = VALUES["T"][:3, :3] @ np.diag([0.0, 0.2, 0.2]) @ VALUES["T"][:3, :3].T
    for tensor in (turned, np.zeros((3, 3))):
        thin = SpatialInertia(mass=1.0, inertia=tensor)
        assert np.isfinite(value((thin + plate).acceleration(V, F))).all()
        with pytest.raises(tx.ModelError, match="three positive principal moments"):
            thin.acceleration(V, F)


@pytest.mark.usefixtures("unchecked")
def test_only_bodies_can_be_merged() -> None:
    with pytest.raises(tx.ModelError, match=r"merge expects another SpatialInertia, got 3\.0"):
        body_of(FIRST).merge(3.0)  # type: ignore[arg-type]
    body = body_of(FIRST)
    assert None + body is body, "None is the body of a link without mass"
    with pytest.raises(tx.OperationError, match=r"functools\.reduce"):
        sum([body, body])


# ---- in flight ----------------------------------------------------------------------------------------------------


def test_a_thrown_body_keeps_its_world_momentum() -> None:
    """Gravity aside; spinning, moving, with its centre of mass off the origin. The points are summed in the world."""
    free, body = joints.Free("body"), body_of(FIRST)
    assert free.velocity is not None
    system = tx.System(rates={**free.rates, free.velocity: body.acceleration(free.velocity, np.zeros(6))})
    start = {"body_position": VALUES["T"], "body_velocity": np.array([1.0, 0.5, -0.3, 0.4, 2.0, -0.7])}
    sol = tx.integrate(tx.compile(system), start, t1=5.0, dt=2e-3, save_at=np.linspace(0.0, 5.0, 6))

    def world_momentum(T: np.ndarray, xi: np.ndarray) -> np.ndarray:
        carried = FIRST.masses[:, None] * (FIRST.velocities(xi) @ T[:3, :3].T)
        return np.concatenate([carried.sum(axis=0), np.cross(FIRST.moved(T).points, carried).sum(axis=0)])

    found = [
        world_momentum(T, xi)
        for T, xi in zip(np.asarray(sol.xs["body_position"]), np.asarray(sol.xs["body_velocity"]), strict=True)
    ]
    energies = [FIRST.kinetic_energy(xi) for xi in np.asarray(sol.xs["body_velocity"])]
    assert np.ptp(np.asarray(sol.xs["body_velocity"])[:, 0]) > 0.5
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (6, 6)), atol=1e-8)
    np.testing.assert_allclose(energies, energies[0], rtol=1e-9)


def test_a_rocket_reaches_the_velocity_of_its_formula() -> None:
    """Mass as a state: v = v_e ln(m0 / m), Tsiolkovsky."""
    free, mass = joints.Free("rocket"), tx.State("mass")
    assert free.velocity is not None
    flow, exhaust = 0.3, 20.0
    body = SpatialInertia(mass=mass, inertia=0.2 * mass * tx.Constant(np.eye(3)))
    thrust = np.array([flow * exhaust, 0.0, 0.0, 0.0, 0.0, 0.0])
    rates = {**free.rates, free.velocity: body.acceleration(free.velocity, thrust), mass: -flow}
    start = {"rocket_position": np.eye(4), "rocket_velocity": np.zeros(6), "mass": np.array(2.0)}
    end = tx.integrate(tx.compile(tx.System(rates=rates)), start, t1=5.0, dt=1e-2).xs
    np.testing.assert_allclose(end["rocket_velocity"][0, 0], exhaust * np.log(2.0 / 0.5), rtol=1e-9)


class Swing:
    """A physical pendulum: a body on an oblique hinge in an oblique mount, so that its axis lies level in the world."""

    axis = np.array([1.0, -2.0, 2.0]) / 3.0  # in the body
    arm = 0.6 * np.array([2.0, 2.0, 1.0]) / 3.0  # m, in the body, across the axis
    mass, gravity = 1.7, 9.81
    tensor = np.array([[0.30, 0.04, -0.02], [0.04, 0.25, 0.05], [-0.02, 0.05, 0.20]])
    angle = 2.2  # rad, where it is let go

    def __init__(self) -> None:
        self.hinge = joints.Revolute("hinge", axis=self.axis)
        self.body = SpatialInertia(mass=self.mass, center_of_mass=self.arm, inertia=self.tensor)
        # Level axis along world y, arm along -z at angle zero.
        down = self.arm / np.linalg.norm(self.arm)
        self.mount = np.eye(4)
        self.mount[:3, :3] = np.stack([np.cross(self.axis, -down), self.axis, -down])
        about_axis = self.axis @ self.tensor @ self.axis + self.mass * self.arm @ self.arm
        self.frequency = np.sqrt(self.mass * self.gravity * np.linalg.norm(self.arm) / about_axis)

    def system(self) -> tx.System:
        hinge, body = self.hinge, self.body
        assert hinge.velocity is not None
        H, V = hinge.motion_subspace, hinge.twist
        weight = body.weight(tx.lie.Compose(self.mount, hinge.transform), [0.0, 0.0, -self.gravity])
        carried = tx.lie.AdjointDual(V, body.momentum(V))
        rate = tx.linalg.Solve(H.T @ body.matrix @ H, hinge.actuation(weight - carried))
        bearing = body.matrix @ (H @ rate) + carried - weight
        energy = (
            body.kinetic_energy(V)
            + self.mass * self.gravity * tx.lie.Act(tx.lie.Compose(self.mount, hinge.transform), self.arm)[2]
        )
        return tx.System(
            rates={**hinge.rates, hinge.velocity: rate},
            outputs={"bearing": bearing, "reaction": hinge.reaction(bearing), "energy": energy},
        )

    def exact(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angle, rate and acceleration: sin(angle / 2) = k cd(frequency t), with the Jacobian elliptic functions."""
        k = np.sin(0.5 * self.angle)
        sn, cn, dn, _ = ellipj(self.frequency * t, k**2)
        half = k * cn / dn
        rate = -2.0 * k * self.frequency * (1.0 - k**2) * sn / dn**2 / np.sqrt(1.0 - half**2)
        angle = 2.0 * np.arcsin(half)
        return angle, rate, -(self.frequency**2) * np.sin(angle)

    def bearing(self, angle: float, rate: float, acceleration: float) -> np.ndarray:
        """Force and torque of the bearing in body axes: Newton for the centre of mass, Euler about the hinge."""
        w, dw = rate * self.axis, acceleration * self.axis
        c, s = np.cos(angle), np.sin(angle)
        K = skew(self.axis)
        turned = self.mount[:3, :3] @ (np.eye(3) + s * K + (1.0 - c) * K @ K)
        weight = turned.T @ np.array([0.0, 0.0, -self.mass * self.gravity])
        force = self.mass * (np.cross(dw, self.arm) + np.cross(w, np.cross(w, self.arm))) - weight
        about = self.tensor + self.mass * (self.arm @ self.arm * np.eye(3) - np.outer(self.arm, self.arm))
        torque = about @ dw + np.cross(w, about @ w) - np.cross(self.arm, weight)
        return np.concatenate([force, torque])


def test_a_physical_pendulum_swings_as_the_elliptic_functions_say() -> None:
    swing = Swing()
    dynamics = tx.compile(swing.system())
    start = {"hinge_position": np.array([swing.angle]), "hinge_velocity": np.zeros(1)}
    sol = tx.integrate(dynamics, start, t1=4.0, dt=1e-3, save_at=np.linspace(0.0, 4.0, 9))
    angle, rate, acceleration = swing.exact(np.asarray(sol.ts))
    np.testing.assert_allclose(sol.xs["hinge_position"][:, 0], angle, atol=1e-9)
    np.testing.assert_allclose(sol.xs["hinge_velocity"][:, 0], rate, atol=1e-9)
    outputs = jax.jit(jax.vmap(dynamics.outputs))(sol.ts, sol.xs)
    expected = np.stack([swing.bearing(*state) for state in zip(angle, rate, acceleration, strict=True)])
    np.testing.assert_allclose(outputs["bearing"], expected, atol=1e-9)
    # No motor: the bearing carries all of it, and nothing about the axis.
    np.testing.assert_allclose(outputs["reaction"], outputs["bearing"], atol=1e-12)
    np.testing.assert_allclose(outputs["bearing"][:, 3:] @ swing.axis, np.zeros(9), atol=1e-12)
    assert np.abs(outputs["bearing"][:, 3:]).max() > 0.5
    np.testing.assert_allclose(outputs["energy"], outputs["energy"][0], rtol=1e-10)
