"""Masses that move within bodies: against sums over points, and against the same masses on joints that are driven."""

from typing import Any

import jax
import numpy as np
import pytest
from mechanics_oracles import Cloud, pose

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, flight, joints

LENGTH, SPEED = tx.State("length"), tx.State("speed")
RATES: dict[Any, Any] = {LENGTH: SPEED, SPEED: 0.3 - 0.4 * LENGTH}
MASSES, PLACES = np.array([0.4, 0.7, 0.3]), np.array([0.2, 0.6, 1.0])  # kg; shares of the length
ROOT, ALONG = np.array([0.3, -0.2, 0.1]), np.array([2.0, -1.0, 2.0]) / 3.0
HUB = Cloud.random(np.random.default_rng(1), 5)


def boom(length: Any) -> SpatialInertia:
    """Three points on a line, which move out along it."""
    total = MASSES.sum()
    middle = MASSES @ PLACES / total
    spread = MASSES @ (PLACES - middle) ** 2
    return SpatialInertia(
        mass=total,
        center_of_mass=ROOT + ALONG * (length * middle),
        inertia=(np.eye(3) - np.outer(ALONG, ALONG)) * (length**2 * spread),
    )


def hub() -> SpatialInertia:
    return SpatialInertia(mass=HUB.mass, center_of_mass=HUB.center, inertia=HUB.tensor_about(HUB.center))


def momentum_of_points(T: Any, V: Any, length: Any, speed: Any) -> np.ndarray:
    """[p; L] (6,) in the world, about its origin, point by point."""
    points = np.concatenate([HUB.points, ROOT + np.outer(PLACES, ALONG) * length])
    inner = np.concatenate([0.0 * HUB.points, np.outer(PLACES, ALONG) * speed])
    masses = np.concatenate([HUB.masses, MASSES])
    carried = masses[:, None] * ((V[:3] + np.cross(V[3:], points) + inner) @ T[:3, :3].T)
    there = points @ T[:3, :3].T + T[:3, 3]
    return np.concatenate([carried.sum(axis=0), np.cross(there, carried).sum(axis=0)])


def test_a_boom_that_deploys_by_states_keeps_the_momentum_of_its_points() -> None:
    craft = hub() + boom(LENGTH)
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    known = craft.with_rates(RATES)
    system = tx.System(
        {g: V, V: known.acceleration(V, np.zeros(6)), **RATES},
        outputs={"momentum": tx.lie.SE3AdjointDual(g) @ known.momentum(V)},
    )
    dynamics = tx.compile(system)
    start = {"g": pose(np.random.default_rng(2)), "V": np.array([0.3, -0.2, 0.5, 0.4, 0.9, -0.6])}
    start |= {"length": np.array(1.0), "speed": np.array(0.7)}
    end = tx.integrate(dynamics, start, t1=2.0, rtol=1e-13, atol=1e-14).last
    names = ("g", "V", "length", "speed")
    before, after = (momentum_of_points(*(np.asarray(x[name]) for name in names)) for x in (start, end))
    assert np.linalg.norm(end["V"][3:] - start["V"][3:]) > 0.1
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-12 * np.linalg.norm(before))
    np.testing.assert_allclose(dynamics.outputs(0.0, start)["momentum"], before, rtol=1e-13)


def test_a_vehicle_whose_boom_deploys_in_time() -> None:
    """Angular momentum about its centre of mass in inertial axes, in free fall; gravity pulls on all points alike."""
    craft = flight.Vehicle(flight.EARTH.still())
    grown = 1.0 + 0.5 * tx.Sin(tx.Time())
    tensor = np.array([[2.0, 0.1, 0.0], [0.1, 3.0, -0.2], [0.0, -0.2, 4.0]])
    body = SpatialInertia(mass=10.0, inertia=tensor * grown)
    start = craft.start(0.0, 0.0, 4e5, (7600.0, 0.0, 0.0), rate=(0.1, -0.2, 0.5), relative_to=flight.inertial_axes)
    end = tx.integrate(tx.compile(craft.system(body)), start, t1=3.0, rtol=1e-13, atol=1e-10).last
    before = start["g"][:3, :3] @ (tensor @ start["V"][3:])
    after = end["g"][:3, :3] @ ((1.0 + 0.5 * np.sin(3.0)) * tensor @ end["V"][3:])
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-12 * np.linalg.norm(before))


def driven_pair() -> tuple[Mechanism, Mechanism]:
    """A mass that moves within a link, and the same mass on a slide."""
    arm = Link(joints.Revolute("arm", (0.0, 1.0, 0.0)), hub(), pose(np.random.default_rng(4)), parent="root")
    root = Link(joints.Free("root"), hub(), np.eye(4))
    tensor, rate = np.diag([0.1, 0.2, 0.15]), {LENGTH: SPEED, SPEED: 0.3 - 0.4 * LENGTH}
    inside = SpatialInertia(mass=2.0, center_of_mass=ROOT + ALONG * LENGTH, inertia=tensor, rates=rate)
    held = Link(joints.Fixed("tip"), inside, pose(np.random.default_rng(5)), parent="arm")
    mount = np.asarray(held.mount.value) @ tx.pose(position=ROOT)
    rider = SpatialInertia(mass=2.0, inertia=tensor)
    slide = Link(joints.Prismatic("slide", ALONG), rider, mount, parent="arm")
    return Mechanism([root, arm, held]), Mechanism([root, arm, slide])


def test_a_mass_within_a_link_does_what_it_does_on_a_slide() -> None:
    inside, outside = driven_pair()
    rng = np.random.default_rng(6)
    length, speed = 0.8, -0.5
    q, qd, qdd, T = rng.normal(size=1), rng.normal(size=7), rng.normal(size=7), pose(rng)
    x = {"q": q, "qd": qd, "root_position": T, "length": np.array(length), "speed": np.array(speed)}
    slid = {"q": np.append(q, length), "qd": np.append(qd, speed), "root_position": T}
    found, expected = (
        evaluated(
            {
                "tau": mechanics.inverse_dynamics(m, qdd=a),
                "gravity": mechanics.gravity_forces(m) + mechanics.coriolis_forces(m) - mechanics.bias_forces(m),
                "momentum": mechanics.centroidal_momentum(m),
                "energy": m.energy(),
                "load": mechanics.joint_wrench(m, "arm", qdd=a),
            },
            state,
        )
        for m, a, state in ((inside, qdd, x), (outside, np.append(qdd, 0.3 - 0.4 * length), slid))
    )
    np.testing.assert_allclose(found["tau"], expected["tau"][:7], rtol=1e-12, atol=1e-12)
    for name in ("momentum", "energy", "load"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found["gravity"], 0.0, atol=1e-12)
    back = evaluated(mechanics.forward_dynamics(inside, tau=np.asarray(found["tau"])), x)
    np.testing.assert_allclose(back, qdd, rtol=1e-11, atol=1e-11)


def test_derivatives_know_the_masses_that_move() -> None:
    inside, _ = driven_pair()
    rng = np.random.default_rng(7)
    x: dict[str, Any] = {"q": rng.normal(size=1), "qd": rng.normal(size=7), "root_position": pose(rng)}
    x |= {"length": np.array(0.8), "speed": np.array(-0.5)}
    tau = rng.normal(size=7)
    function = tx.lower(mechanics.forward_dynamics(inside, tau=tau))
    found = evaluated(mechanics.forward_dynamics_derivatives(inside, tau=tau)._asdict(), x)

    def moved(d: Any) -> Any:
        root = tx.lie.se3.compose(x["root_position"], tx.lie.se3.exp(d[:6]))
        return function(0.0, {**x, "root_position": root, "q": x["q"] + d[6:]})

    along = lambda qd: function(0.0, {**x, "qd": qd})  # noqa: E731
    by_q, by_qd = jax.jit(lambda d, qd: (jax.jacfwd(moved)(d), jax.jacfwd(along)(qd)))(np.zeros(7), x["qd"])
    np.testing.assert_allclose(found["q"], by_q, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(found["qd"], by_qd, rtol=1e-11, atol=1e-11)


def test_a_mechanism_takes_the_rates_of_further_states() -> None:
    inside, _ = driven_pair()
    links = [link if link.name != "tip" else tip_without_rates(link) for link in inside.links]
    system = Mechanism(links).system(controls=[], rates=RATES)
    assert list(system.rates) == ["q", "root_position", "qd", "length", "speed"]
    known = inside.system(controls=[], rates=RATES)
    x = {"q": np.ones(1), "qd": np.ones(7), "root_position": np.eye(4), "length": np.ones(()), "speed": np.ones(())}
    one, other = (tx.compile(each)(0.0, x)["qd"] for each in (system, known))
    np.testing.assert_array_equal(one, other)
    with pytest.raises(tx.ModelError, match=r"rates of additional states, got 'qd'"):
        inside.system(rates={"qd": np.zeros(7)})


def tip_without_rates(link: Link) -> Link:
    assert link.body is not None
    body = SpatialInertia(mass=2.0, center_of_mass=link.body.center_of_mass, inertia=link.body.inertia)
    return Link(link.joint, body, link.mount, parent=link.parent)


def test_mass_that_leaves_takes_its_momentum_along() -> None:
    """The terms are those of mass that stays: where the mass changes, or is said to leave, there are none."""
    fuel, V, F = tx.State("fuel"), np.arange(6.0), np.ones(6)
    tensor = np.diag([1.0, 2.0, 2.5])
    rigid = evaluated(SpatialInertia(mass=2.0, inertia=tensor).acceleration(V, F))
    burning = SpatialInertia(mass=fuel, inertia=tensor * fuel / 2.0)
    np.testing.assert_allclose(evaluated(burning.acceleration(V, F), {"fuel": np.array(2.0)}), rigid)
    told = SpatialInertia(mass=2.0, inertia=tensor * (1.0 - tx.Time()), mass_leaves=True)
    np.testing.assert_allclose(evaluated(told.acceleration(V, F)), rigid)
    kept = SpatialInertia(mass=2.0, inertia=tensor * (1.0 - tx.Time()))
    expected = rigid[3:] + np.asarray(V[3:])  # I w' = ... - I' w, I' = -I
    np.testing.assert_allclose(evaluated(kept.acceleration(V, F))[3:], expected)
    still = SpatialInertia(mass=2.0, inertia=tensor * fuel / 2.0, rates={"fuel": 0.0})
    assert still.inner_motion is None


def test_a_mass_that_is_a_state_of_rate_zero_stays() -> None:
    """It does what the same mass does as a number, when the rate is known at once or later."""
    mass, V, zero = tx.State("mass"), np.array([0.1, -0.2, 0.3, 0.4, 0.5, -0.6]), 0.0 * SPEED
    x = {"length": np.array(0.3), "speed": np.array(0.7), "mass": np.array(2.0)}

    def body(m: Any, **more: Any) -> SpatialInertia:
        return SpatialInertia(mass=m, center_of_mass=ROOT + ALONG * LENGTH, inertia=np.eye(3) * (1 + LENGTH**2), **more)

    def motion(b: SpatialInertia) -> dict[str, Any]:
        whole = hub() + b.in_frame(tx.pose(position=[0.1, 0.2, 0.3]))
        expressions = {
            "acceleration": whole.acceleration(V, np.ones(6)),
            "momentum": whole.momentum(V),
            "energy": whole.kinetic_energy(V),
        }
        return tx.lower(expressions)(0.0, x)

    expected = motion(body(2.0, rates=RATES))
    leaving = motion(body(mass, rates={**RATES, mass: SPEED}))
    for name, value in expected.items():
        assert np.abs(leaving[name] - value).max() > 0.1
    for staying in (
        body(mass, rates={**RATES, mass: 0.0}),
        body(mass, rates={**RATES, mass: zero}),
        body(mass, rates={**RATES, mass: 0.0}, mass_leaves=False),
        body(mass).with_rates({**RATES, mass: 0.0}),
        body(mass).in_frame(tx.pose()).with_rates({**RATES, mass: 0.0}),
    ):
        actual = motion(staying)
        for name, value in expected.items():
            np.testing.assert_allclose(actual[name], value, rtol=1e-12, atol=1e-12)
    for rates in ({mass: SPEED}, {}):
        with pytest.raises(tx.ModelError, match=r"(?s)mass that does not change.*fix: pass rates="):
            body(mass, rates={**RATES, **rates}, mass_leaves=False)


def test_what_is_not_known_is_refused(unchecked: None) -> None:
    x, angle = tx.State("x"), tx.Control("angle")
    body = SpatialInertia(mass=1.0, center_of_mass=tx.Concat(x, 0.0, 0.0), inertia=np.eye(3))
    V = np.ones(6)
    with pytest.raises(tx.ModelError, match=r"(?s)depends on the state 'x', whose rate is not known.*fix: .*rates="):
        body.acceleration(V, V)
    with pytest.raises(tx.ModelError, match="control 'angle', whose rate is not known"):
        body.with_rates({x: angle}).acceleration(V, V)  # the centre's acceleration
    body.with_rates({x: angle}).momentum(V)
    with pytest.raises(tx.ModelError, match="whose rate is not known"):
        mechanics.forward_dynamics(Mechanism([Link(joints.Free("free"), body, np.eye(4))]))
    with pytest.raises(tx.ModelError, match="mass that does not change"):
        SpatialInertia(mass=x, inertia=np.eye(3), mass_leaves=False)
    with pytest.raises(tx.ModelError, match=r"by name: SpatialInertia\(mass=\.\.\., center_of_mass="):
        SpatialInertia(1.0, np.eye(3))
    moving = tx.pose(position=[0.0, 0.0, 0.0]) + 0.0 * x
    for call in (
        lambda: hub().in_frame(moving).acceleration(V, V),
        lambda: Link(joints.Fixed("tip"), None, moving),
        lambda: Drive(armature=x),
    ):
        with pytest.raises(
            tx.ModelError, match=r"(?s)constant during the motion, got .*depends on 'x'.*fix: use a joint"
        ):
            call()
    with pytest.raises(tx.ShapeError, match=r"rate of 'x' with shape \(\), got \(3,\)"):
        body.with_rates({x: np.ones(3)}).momentum(V)
    with pytest.raises(tx.ModelError, match="states, controls or their names, got 3"):
        body.with_rates({3: x})
