"""Closed loops: against trees with a joint in place of the closure, against a linkage by hand, and in motion."""

import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanics_oracles import Cloud, body_of, pose

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints, loops

GRAVITY = np.array([0.7, -1.1, -9.6])
AXIS = np.array([0.6, 0.0, -0.8])


class Both:
    """Two bodies on a joint, and the same two, each free, with a closure in the joint's place."""

    def __init__(self, joint: joints.Joint, closures: list[loops.Loop]) -> None:
        rng = np.random.default_rng(3)
        one, two = (body_of(Cloud.random(rng, 4)) for _ in range(2))
        self.at, self.joint, self.rng = pose(rng), joint, rng
        first = Link(joints.Free("one"), one, np.eye(4))
        self.tree = Mechanism([first, Link(joint, two, self.at, parent="one", name="two")], GRAVITY, keep=[joint.name])
        frame, far = Link(joints.Fixed("mount"), None, self.at, parent="one"), pose(rng)
        pair = [
            Link(joints.Fixed("far_one"), None, self.at @ far, parent="one"),
            Link(joints.Fixed("far_two"), None, far, parent="two"),
        ]
        self.closed = Mechanism(
            [first, frame, Link(joints.Free("two"), two, np.eye(4)), *pair], GRAVITY, loops=closures
        )

    def compared(self) -> tuple[Any, ...]:
        """Accelerations of the second body and the wrench it gets, from the tree and from the closed loop."""
        n = self.joint.dofs
        x = {"one_position": pose(self.rng), "qd": self.rng.normal(size=6 + n)}
        if self.joint.group is not None:
            x["pin_position"] = pose(self.rng)[:3, :3]
        elif n:
            x["q"] = self.rng.normal(size=n)
        tau, push = self.rng.normal(size=6 + n), self.rng.normal(size=6)
        tau[6:] = 0.0
        qdd = mechanics.forward_dynamics(self.tree, tau=tau, wrenches={"two": push})
        found: dict[str, Any] = {
            "pose": self.tree.pose("two"),
            "V": self.tree.twist("two"),
            "A": mechanics.frame_jacobian(self.tree, "two") @ qdd
            + mechanics.frame_jacobian_rate(self.tree, "two") @ self.tree.qd,
            "one": qdd[:6],
            "F": mechanics.joint_wrench(self.tree, "pin", qdd=qdd, wrenches={"two": push}),
        }
        tree = evaluated(found, x)
        state = {
            "one_position": x["one_position"],
            "two_position": tree["pose"],
            "qd": np.concatenate([x["qd"][:6], tree["V"]]),
        }
        forces = np.concatenate([tau[:6], np.zeros(6)])
        qdd, carried = mechanics.closed_dynamics(self.closed, tau=forces, wrenches={"two": push})
        everything = mechanics.loop_wrenches(self.closed, tau=forces, wrenches={"two": push})
        closed = evaluated(
            {
                "qdd": qdd,
                "carried": carried,
                "needed": mechanics.inverse_dynamics(self.closed, qdd=qdd, wrenches=everything),
                "gaps": [mechanics.loop_gap(self.closed, loop.name) for loop in self.closed.loops],
            },
            state,
        )
        return tree, closed, forces, self.closed


KINDS = {
    "point": lambda: Both(joints.Spherical("pin"), [loops.PointLoop("c", "mount", "two")]),
    "axis": lambda: Both(joints.Revolute("pin", AXIS), [loops.AxisLoop("c", "mount", "two", AXIS)]),
    "pose": lambda: Both(joints.Fixed("pin"), [loops.PoseLoop("c", "mount", "two")]),
}


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_closure_does_what_a_joint_does(kind: str) -> None:
    tree, closed, forces, _ = KINDS[kind]().compared()
    np.testing.assert_allclose(closed["qdd"][:6], tree["one"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(closed["qdd"][6:], tree["A"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(closed["carried"]["c"], tree["F"], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(closed["needed"], forces, atol=1e-8)
    np.testing.assert_allclose(closed["gaps"][0], 0.0, atol=1e-13)


def test_closures_that_say_one_thing_twice() -> None:
    """Welded in two places: the motion is that of one weld, and the two carry together what it does."""
    both = Both(joints.Fixed("pin"), [loops.PoseLoop("c", "mount", "two"), loops.PoseLoop("d", "far_one", "far_two")])
    tree, closed, forces, mechanism = both.compared()
    np.testing.assert_allclose(closed["qdd"][:6], tree["one"], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(closed["qdd"][6:], tree["A"], rtol=1e-8, atol=1e-8)
    other: Any = mechanism.frame("far_two").T
    second = tx.lie.se3.Ad_dual(jnp.asarray(other.value)) @ closed["carried"]["d"]
    np.testing.assert_allclose(closed["carried"]["c"] + second, tree["F"], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(closed["needed"], forces, atol=1e-7)
    assert mechanism.redundant_closures == 6
    assert any("6 of 12 loop constraints are redundant" in note for note in mechanism.notes)


# ---- a four-bar linkage ----------------------------------------------------------------------------------------------

CRANK, COUPLER, ROCKER, GROUND = 0.4, 1.0, 0.8, 0.9


def rod(length: float) -> SpatialInertia:
    across = length**3 / 12.0
    return SpatialInertia(
        mass=length, center_of_mass=(0.5 * length, 0.0, 0.0), inertia=np.diag([0.01, 0.01 + across, across])
    )


def along(x: float) -> Any:
    return tx.pose(position=[x, 0.0, 0.0])


@functools.cache
def four_bar() -> Mechanism:
    """In the plane of x and z; a turn about y is from z to x: a rod at the angle q has x = cos q, z = -sin q."""
    y = (0.0, 1.0, 0.0)
    links = [
        Link(joints.Revolute("crank", y), rod(CRANK), along(0.0)),
        Link(joints.Revolute("coupler", y), rod(COUPLER), along(CRANK), parent="crank"),
        Link(joints.Fixed("pin"), None, along(COUPLER), parent="coupler"),
        Link(joints.Revolute("rocker", y), rod(ROCKER), along(GROUND)),
        Link(joints.Fixed("tip"), None, along(ROCKER), parent="rocker"),
    ]
    return Mechanism(links, loops=[loops.AxisLoop("closure", "pin", "tip", y)])


@functools.cache
def moving() -> tx.Dynamics:
    robot = four_bar()
    outputs = {
        "energy": robot.energy(),
        "gap": mechanics.loop_gap(robot, "closure"),
        "F": mechanics.loop_wrench(robot, "closure", frame="base"),
    }
    return tx.compile(robot.system(controls=[], outputs=outputs))


@jax.jit
def angles(a: jax.Array) -> jax.Array:
    """Of the coupler and the rocker, from the x axis, by the triangle between crank and rocker; above the ground."""
    reach = jnp.array([GROUND - CRANK * jnp.cos(a), CRANK * jnp.sin(a)])
    d = jnp.sqrt(reach @ reach)
    bend = jnp.arccos((COUPLER**2 + d**2 - ROCKER**2) / (2.0 * COUPLER * d))
    b = jnp.arctan2(-reach[1], reach[0]) - bend
    x, z = CRANK * jnp.cos(a) + COUPLER * jnp.cos(b), -CRANK * jnp.sin(a) - COUPLER * jnp.sin(b)
    return jnp.array([a, b, jnp.arctan2(-z, x - GROUND)])


def start() -> dict[str, Any]:
    q, qd = jax.jit(lambda a, rate: jax.jvp(angles, (a,), (rate,)))(-0.9, 3.0)
    relative = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return {"q": relative @ q, "qd": relative @ qd}


def test_a_four_bar_linkage_by_its_one_angle() -> None:
    """Lagrange's equation of the crank alone, with the other angles from the triangle."""

    def energies(a: jax.Array, rate: jax.Array) -> tuple[jax.Array, jax.Array]:
        q, qd = jax.jvp(angles, (a,), (rate,))
        kinetic = potential = jnp.zeros(())
        before, v = jnp.zeros(2), jnp.zeros(2)
        for i, length in enumerate((CRANK, COUPLER, ROCKER)):
            if i == 2:
                before, v = jnp.array([GROUND, 0.0]), jnp.zeros(2)
            u, n = jnp.array([jnp.cos(q[i]), -jnp.sin(q[i])]), jnp.array([-jnp.sin(q[i]), -jnp.cos(q[i])])
            middle = v + 0.5 * length * qd[i] * n
            inertia = length**3 / 12.0 + 0.01
            kinetic += 0.5 * length * middle @ middle + 0.5 * inertia * qd[i] ** 2
            potential += 9.81 * length * (before + 0.5 * length * u)[1]
            before, v = before + length * u, v + length * qd[i] * n
        return kinetic, potential

    def lagrangian(a: jax.Array, rate: jax.Array) -> jax.Array:
        kinetic, potential = energies(a, rate)
        return kinetic - potential

    a, rate = jnp.asarray(-0.9), jnp.asarray(3.0)

    @jax.jit
    def acceleration(a: jax.Array, rate: jax.Array) -> jax.Array:
        moment = jax.grad(lagrangian, 1)
        turned = jax.grad(lagrangian)(a, rate) - jax.grad(moment)(a, rate) * rate
        return turned / jax.grad(moment, 1)(a, rate)

    expected = acceleration(a, rate)
    x = start()
    found = moving()(0.0, x)["qd"]
    np.testing.assert_allclose(found[0], expected, rtol=1e-10)
    # The force in the pin turns the rocker, with its weight; and the coupler about its other end.
    F = moving().outputs(0.0, x)["F"]
    q, absolute = np.asarray(angles(a)), np.array([0.0, 0.0, 0.0])
    absolute[2] = found[2]
    tip = np.array([GROUND + ROCKER * np.cos(q[2]), 0.0, -ROCKER * np.sin(q[2])])
    arm = tip - np.array([GROUND, 0.0, 0.0])
    weight = np.cross(0.5 * arm, [0.0, 0.0, -9.81 * ROCKER])[1]
    force = F[:3] if np.allclose(F[3:] - np.cross(tip, F[:3]), 0.0, atol=1e-9) else np.full(3, np.nan)
    np.testing.assert_allclose(
        (ROCKER**3 / 3.0 + 0.01) * found[2], weight + np.cross(arm, force)[1], rtol=1e-9, atol=1e-10
    )
    assert abs(force[1]) < 1e-12


def off(x: dict[str, Any], by: float) -> dict[str, Any]:
    return {name: value + by * np.array([1.0, -0.5, 0.7]) for name, value in x.items()}


def test_a_linkage_stays_closed_and_keeps_its_energy() -> None:
    dynamics, x = moving(), start()
    sol = tx.integrate(dynamics, x, t1=3.0, rtol=1e-10, atol=1e-10, save_at=np.linspace(0.0, 3.0, 31))
    found = sol.outputs
    assert np.abs(found["gap"]).max() < 1e-13
    energy = np.asarray(found["energy"])
    assert np.ptp(energy) < 1e-9 * np.abs(energy).max()


def test_states_are_brought_to_the_manifold() -> None:
    dynamics, x = moving(), start()
    with pytest.raises(tx.InputError, match=r"from the manifold of the system is 0\.(.|\n)*dynamics.project"):
        tx.integrate(dynamics, off(x, 0.1), t1=1.0, dt=0.1)
    near = dynamics.project(0.0, off(x, 0.1))
    found = dynamics.outputs(0.0, near)
    assert np.abs(found["gap"]).max() < 1e-14
    assert np.abs(np.asarray(near["q"]) - x["q"]).max() < 0.3
    # Nothing is left to correct, and the velocities keep the loop closed: in a short time it opens by its square.
    h = 1e-4
    moved = {**near, "q": near["q"] + h * near["qd"]}
    assert np.abs(dynamics.outputs(0.0, moved)["gap"]).max() < 1e-6
    with pytest.raises(tx.InputError, match="does not converge to the manifold"):
        dynamics.project(0.0, {"q": np.full(3, np.nan), "qd": np.zeros(3)})


def test_corrections_are_saved_with_the_system(tmp_path: Path) -> None:
    moving().save(tmp_path / "linkage.twistax")
    again = tx.load(tmp_path / "linkage.twistax")
    assert list(again.system.corrections) == ["q", "qd"]
    assert [e.key() for e in again.system.corrections.values()] == [
        e.key() for e in moving().system.corrections.values()
    ]


def test_systems_of_ones_own_have_corrections_too() -> None:
    """A point on a circle, in the plane: the exact motion keeps its distance, and so do the steps."""
    p, radius = tx.State("p", (2,)), 2.0
    turning = tx.System({p: tx.Concat(-p[1], p[0])}, corrections={p: 0.5 * p * (radius**2 / tx.linalg.Dot(p, p) - 1.0)})
    dynamics = tx.compile(turning)
    kept = tx.integrate(dynamics, {"p": np.array([2.0, 0.0])}, t1=50.0, dt=0.5).xs["p"][-1]
    free = tx.integrate(tx.compile(tx.System(turning.rates)), {"p": np.array([2.0, 0.0])}, t1=50.0, dt=0.5).xs["p"][-1]
    assert abs(np.linalg.norm(kept) - 2.0) < 1e-9 < 1e-3 < abs(np.linalg.norm(free) - 2.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda p: {p: np.ones(3)}, r"correction of 'p' expects shape \(2,\)"),
        (lambda p: {"r": np.ones(2)}, "corrections names 'r'"),
        (lambda p: [p], "corrections must be a dict"),
    ],
)
def test_bad_corrections_are_refused(make: Any, message: str, unchecked: None) -> None:
    p = tx.State("p", (2,))
    with pytest.raises(ValueError, match=message):
        tx.System({p: -p}, corrections=make(p))


def test_bad_loops_are_refused(unchecked: None) -> None:
    links, y = four_bar().links, (0.0, 1.0, 0.0)
    for closure, message in (
        ([loops.PointLoop("a", "pin", "nowhere")], "no frame 'nowhere'"),
        ([loops.PointLoop("a", "pin", "coupler")], "two frames of one body"),
        ([loops.PointLoop("a", "pin", "tip"), loops.PointLoop("a", "tip", "pin")], "loops must have different names"),
        (["pin"], "expects loops"),
    ):
        with pytest.raises(tx.ModelError, match=message):
            Mechanism(links, loops=closure)
    with pytest.raises(tx.ModelError, match="two different frames, got 'pin' twice"):
        loops.AxisLoop("a", "pin", "pin", y)
    with pytest.raises(tx.ModelError, match="no loop 'b'"):
        mechanics.loop_wrench(four_bar(), "b")
    with pytest.raises(tx.ModelError, match="expects a mechanism with loops"):
        mechanics.closed_dynamics(Mechanism(links))


@pytest.mark.slow
def test_a_linkage_over_a_hundred_seconds() -> None:
    dynamics, x = moving(), start()
    for tolerance, bound in ((1e-8, 1e-5), (1e-10, 1e-8), (1e-12, 1e-10)):
        sol = tx.integrate(dynamics, x, t1=100.0, rtol=tolerance, atol=tolerance, save_at=np.linspace(0.0, 100.0, 501))
        found = sol.outputs
        energy = np.asarray(found["energy"])
        assert np.abs(found["gap"]).max() < 1e-12
        assert np.ptp(energy) < bound * np.abs(energy).max()


def stewart() -> tuple[tx.System, dict[str, Any]]:
    """Six legs that slide on springs, on universal joints below and balls above; six freedoms are left of 24."""
    sides, length, height, stiffness = 2.0 * np.pi / 3.0 * np.arange(3), 0.5, 0.8, 4e3
    below = np.concatenate([[a - 0.3, a + 0.3] for a in sides])
    above = np.concatenate([[a - 0.8, a + 0.8] for a in sides])
    feet = np.stack([np.cos(below), np.sin(below), 0.0 * below], 1)
    tops = 0.6 * np.stack([np.cos(above), np.sin(above), 0.0 * above], 1)
    plate = SpatialInertia(mass=20.0, inertia=np.diag([1.8, 1.8, 3.6]))
    tube = SpatialInertia(mass=2.0, center_of_mass=(0.0, 0.0, 0.25), inertia=np.diag([0.04, 0.04, 0.001]))
    rod = SpatialInertia(mass=1.0, center_of_mass=(0.0, 0.0, -0.2), inertia=np.diag([0.02, 0.02, 0.001]))
    links, closures, q = [Link(joints.Free("plate"), plate, np.eye(4))], [], list[float]()
    for i, (foot, top) in enumerate(zip(feet, tops, strict=True)):
        one, two = joints.universal(f"foot{i}", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        way = top + [0.0, 0.0, height] - foot
        reach = float(np.linalg.norm(way))
        drive = Drive(stiffness=stiffness, rest=reach + 0.02 - length)
        slide = joints.Prismatic(f"leg{i}", (0.0, 0.0, 1.0))
        links += [
            Link(one, None, tx.pose(position=foot)),
            Link(two, tube, np.eye(4), parent=one.name, name=f"tube{i}"),
            Link(slide, rod, tx.pose(position=[0.0, 0.0, length]), parent=f"tube{i}", drive=drive),
            Link(joints.Fixed(f"ball{i}"), None, tx.pose(position=top), parent="plate"),
        ]
        closures.append(loops.PointLoop(f"closure{i}", f"leg{i}", f"ball{i}"))
        x, y, z = way / reach
        q += [-np.arctan2(y, z), np.arcsin(x), reach - length]
    platform = Mechanism(links, loops=closures, driven=[])
    assert platform.redundant_closures == 0
    gaps = tx.Concat(*(mechanics.loop_gap(platform, loop.name) for loop in closures))
    system = platform.system(outputs={"energy": platform.energy(), "gap": gaps})
    qd = np.concatenate([[0.3, 0.0, 0.5, 0.0, 0.4, 1.0], np.zeros(18)])
    return system, {"q": np.array(q), "plate_position": tx.pose(position=[0.0, 0.0, height]), "qd": qd}


@pytest.mark.slow
def test_a_stewart_platform_over_a_hundred_seconds() -> None:
    system, x = stewart()
    dynamics = tx.compile(system)
    times = np.linspace(0.0, 100.0, 201)
    sol = tx.integrate(dynamics, dynamics.project(0.0, x), t1=100.0, rtol=1e-10, atol=1e-10, save_at=times)
    found = sol.outputs
    energy = np.asarray(found["energy"])
    assert np.abs(found["gap"]).max() < 1e-10
    assert np.ptp(energy) < 1e-8 * np.abs(energy).max()


@pytest.mark.slow
def test_the_fastest_move_of_an_arm_of_two_links() -> None:
    """A mechanism in a trajectory problem: solved, and flown again by another method, it arrives."""
    z, drive = (0.0, 0.0, 1.0), Drive(effort=5.0, lower=-3.0, upper=3.0, speed=8.0)
    body = SpatialInertia(mass=1.0, center_of_mass=(0.25, 0.0, 0.0), inertia=np.diag([0.001, 0.02, 0.02]))
    arm = mechanics.Chain(
        [
            Link(joints.Revolute("a", z), body, np.eye(4), drive=drive),
            Link(joints.Revolute("b", z), body, tx.pose(position=[0.5, 0.0, 0.0]), drive=drive),
        ],
        gravity=(0.0, 0.0, 0.0),
    )
    dynamics, rest = tx.compile(arm.system()), np.zeros(2)
    end = np.array([1.5, 0.5])
    problem = tx.trajectory.Problem(
        dynamics,
        tx.Minimize(tx.Time()),
        nodes=21,
        final_time=(0.3, 3.0),
        initial={"q": rest, "qd": rest},
        final={"q": end, "qd": rest},
    )
    result = problem.solve()
    assert "SOLVED" in str(result.status)
    assert 0.4 < result.final_time < 1.0
    start = {"q": rest, "qd": rest}
    flown = tx.integrate(dynamics, start, t1=result.final_time, rtol=1e-10, atol=1e-10, u=result.controls)
    np.testing.assert_allclose(flown.xs["q"][-1], end, atol=1e-3)


def test_second_derivatives_of_closed_loops() -> None:
    """Those on the graph of scalars, against differences of the gradient by JAX."""
    dynamics, x, weights = moving(), start(), np.array([0.3, -1.2, 0.7])
    z = np.concatenate([x["q"], x["qd"]])
    gradient = jax.jit(jax.grad(lambda z: weights @ dynamics(0.0, {"q": z[:3], "qd": z[3:]})["qd"]))

    def differences(h: float) -> np.ndarray:
        return np.stack([(gradient(z + h * e) - gradient(z - h * e)) / (2.0 * h) for e in np.eye(6)])

    right = (4.0 * differences(5e-4) - differences(1e-3)) / 3.0
    found = dynamics.hessian(0.0, x, None, None, {"qd": weights}, wrt=("x",))
    np.testing.assert_allclose(found, right, rtol=0.0, atol=1e-8 * np.abs(right).max())
