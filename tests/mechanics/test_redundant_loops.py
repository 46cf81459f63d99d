"""Closures that nearly say one thing twice: axes a little off, and postures in which rows vanish.

The oracle is a KKT system in NumPy: rows and drift by JAX's derivatives of the gap, the mass matrix by those of the
energy, ranks by singular values.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

import twistax as tx
from twistax import mechanics
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints, loops

Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def rod(length: float) -> SpatialInertia:
    return SpatialInertia(mass=1.0, center_of_mass=(0.5 * length, 0.0, 0.0), inertia=np.diag([0.01, 0.05, 0.05]))


def tilted(x: float, angle: float = 0.0) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0, x], [0.0, c, -s, 0.0], [0.0, s, c, 0.0], [0.0, 0.0, 0.0, 1.0]])


STRAIGHT = tilted(0.9)


def four_bar(rocker: Any, closure: loops.Loop, **more: Any) -> Mechanism:
    """A planar linkage in space; the mount of its rocker may tilt the rocker's axis."""
    links = [
        Link(joints.Revolute("crank", Y), rod(0.4), tilted(0.0)),
        Link(joints.Revolute("coupler", Y), rod(1.0), tilted(0.4), parent="crank"),
        Link(joints.Fixed("pin"), None, tilted(1.0), parent="coupler"),
        Link(joints.Revolute("rocker", Y), rod(0.8), rocker),
        Link(joints.Fixed("tip"), None, tilted(0.8), parent="rocker"),
    ]
    return Mechanism(links, loops=[closure], **more)


@functools.cache
def straight() -> Mechanism:
    return four_bar(STRAIGHT, loops.PointLoop("c", "pin", "tip"))


@functools.cache
def start() -> dict[str, np.ndarray]:
    a = -0.9

    def open_by(z: Any) -> list[float]:
        return [
            0.4 * np.cos(a) + np.cos(a + z[0]) - 0.9 - 0.8 * np.cos(z[1]),
            -0.4 * np.sin(a) - np.sin(a + z[0]) + 0.8 * np.sin(z[1]),
        ]

    b, c = fsolve(open_by, [0.4, -1.3], xtol=1e-12)
    A = np.array([[-np.sin(a + b), 0.8 * np.sin(c)], [-np.cos(a + b), 0.8 * np.cos(c)]])
    rates = np.linalg.solve(A, 3.0 * np.array([0.4 * np.sin(a) + np.sin(a + b), 0.4 * np.cos(a) + np.cos(a + b)]))
    return {"q": np.array([a, b, c]), "qd": np.array([3.0, *rates])}


@functools.cache
def moving(mechanism: Mechanism) -> Any:
    def outputs(qdd: Any, tau: Any) -> dict[str, Any]:
        return {
            "F": mechanics.loop_wrench(mechanism, "c", tau=tau),
            "energy": mechanism.energy(),
            **mechanics.loop_diagnostics(mechanism, tau=tau),
        }

    return tx.compile(mechanism.system(controls=[], outputs=outputs))


@functools.cache
def terms(mechanism: Mechanism) -> Any:
    """Of positions and rates: rows of the gap, their drift, the mass matrix, and the forces of the Lagrangian."""
    gap = tx.lower(mechanics.loop_gap(mechanism, "c"))
    kinetic = tx.lower(mechanics.kinetic_energy(mechanism))
    potential = tx.lower(mechanics.potential_energy(mechanism))

    def lagrangian(q: Any, qd: Any) -> Any:
        return kinetic(0.0, {"q": q, "qd": qd}) - potential(0.0, {"q": q})

    @jax.jit
    def derivatives(q: Any, qd: Any) -> Any:
        rows, moment = jax.jacfwd(lambda q: gap(0.0, {"q": q})), jax.grad(lagrangian, 1)
        c = jax.jvp(lambda q: rows(q) @ qd, (q,), (qd,))[1]
        f = jax.grad(lagrangian)(q, qd) - jax.jvp(lambda q: moment(q, qd), (q,), (qd,))[1]
        return rows(q), c, jax.hessian(lagrangian, 1)(q, qd), f

    return derivatives


def by_kkt(mechanism: Mechanism, x: dict[str, Any], length: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Accelerations, the shortest multipliers in the measure of a length, and the rank, by singular values."""
    G, c, M, f = map(np.asarray, terms(mechanism)(jnp.asarray(x["q"]), jnp.asarray(x["qd"])))
    measures = np.where(np.arange(len(G)) < 3, 1.0, length)
    scaled = measures[:, None] * G / length  # all joints turn
    U, sizes, _ = np.linalg.svd(scaled)
    rank = int(np.sum(sizes > 1e-5 * sizes[0]))
    W = (U[:, :rank].T * measures) @ G
    A = W @ np.linalg.solve(M, W.T)
    nu = np.linalg.solve(A, -(U[:, :rank].T * measures) @ c - W @ np.linalg.solve(M, f))
    qdd = np.linalg.solve(M, f + W.T @ nu)
    multipliers = measures * (U[:, :rank] @ nu)
    return qdd, multipliers, rank


@pytest.mark.parametrize("closure", ["point", "axis"])
def test_an_axis_that_is_a_little_off_changes_nothing(closure: str) -> None:
    loop = loops.PointLoop("c", "pin", "tip") if closure == "point" else loops.AxisLoop("c", "pin", "tip", Y)
    tilt = tx.Parameter("tilt")
    rocker = tx.pose(position=[0.9, 0.0, 0.0], rotation_vector=tilt * np.array([1.0, 0.0, 0.0]))
    dynamics, untilted = moving(four_bar(rocker, loop)), four_bar(STRAIGHT, loop)

    def at(tilt: float) -> tuple[Any, Any]:
        params = {"tilt": tilt}
        return dynamics(0.0, start(), params=params)["qd"], dynamics.outputs(0.0, start(), params=params)

    qdd, found = at(0.0)
    expected, multipliers, rank = by_kkt(untilted, start(), 0.775)
    np.testing.assert_allclose(qdd, expected, rtol=1e-10)
    carried = untilted.loops[0].constraint_basis.value @ multipliers
    np.testing.assert_allclose(found["F"], carried, rtol=1e-9, atol=1e-10)
    assert (int(found["rank"]), int(found["redundant"])) == (rank, loop.rows - rank) == (2, loop.rows - 2)
    size = np.linalg.norm(found["F"])
    for angle in (1e-12, 1e-9, 1e-7, 1e-6, 3.67e-6):
        moved, carried = at(angle)
        np.testing.assert_allclose(moved, qdd, rtol=1e-6)
        allowed = 1e-6 * size if angle <= 1e-6 else 1e-5 * size
        np.testing.assert_allclose(carried["F"], found["F"], rtol=0.0, atol=allowed)
        assert carried["wrench_error"] < 1e-7


def test_a_four_bar_linkage_moves_as_pinocchio_says() -> None:
    """Its constraint dynamics, of the closure as a contact of points."""
    pin: Any = pytest.importorskip("pinocchio")
    model, at = pin.Model(), lambda x: pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
    numbers = []
    for parent, place, length in ((0, 0.0, 0.4), (1, 0.4, 1.0), (0, 0.9, 0.8)):
        number = model.addJoint(parent, pin.JointModelRY(), at(place), f"joint{len(numbers)}")
        rigid = pin.Inertia(1.0, np.array([0.5 * length, 0.0, 0.0]), np.diag([0.01, 0.05, 0.05]))
        model.appendBodyToJoint(number, rigid, pin.SE3.Identity())
        numbers.append(number)
    closure = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D, model, numbers[1], at(1.0), numbers[2], at(0.8), pin.ReferenceFrame.LOCAL
    )
    models, datas, data = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData(), model.createData()
    models.append(closure)
    datas.append(closure.createData())
    pin.initConstraintDynamics(model, data, models, datas)
    x, settings = start(), pin.ProximalSettings(1e-12, 1e-12, 50)
    expected = pin.constraintDynamics(model, data, x["q"], x["qd"], np.zeros(3), models, datas, settings)
    dynamics = moving(straight())
    np.testing.assert_allclose(dynamics(0.0, x)["qd"], expected, rtol=1e-8)
    force = np.linalg.norm(dynamics.outputs(0.0, x)["F"])
    np.testing.assert_allclose(force, np.linalg.norm(datas[0].contact_force.linear), rtol=1e-8)


def test_an_axis_that_is_off_locks_the_linkage() -> None:
    """What is no round-off counts: three rows on three freedoms leave no motion."""
    found = moving(four_bar(tilted(0.9, 1e-2), loops.PointLoop("c", "pin", "tip"))).outputs(0.0, start())
    assert int(found["redundant"]) == 0
    assert 1e-5 < float(found["reciprocal_condition"]) < 1e-2
    loose = four_bar(tilted(0.9, 1e-2), loops.PointLoop("c", "pin", "tip"), loop_metric=loops.Metric(tolerance=0.1))
    assert int(moving(loose).outputs(0.0, start())["redundant"]) == 1


def test_where_a_linkage_stands_is_no_length_of_it() -> None:
    near, far = straight(), np.asarray(tx.pose(position=[1e3, -2e3, 0.0]))
    links = [
        dataclasses.replace(each, mount=far @ each.mount.value) if each.parent is None else each for each in near.links
    ]
    found, expected = (moving(each).outputs(0.0, start()) for each in (Mechanism(links, loops=near.loops), near))
    for name in ("F", "rank", "reciprocal_condition"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-9, atol=1e-9)


# ---- a door on two hinges --------------------------------------------------------------------------------------------


def door(tilt: float, aside: float, frames: tuple[str, str], size: float = 1.0) -> Mechanism:
    """A door whose upper hinge is a closure, off the axis of the lower one; lengths in units of `size`, m."""
    panel = SpatialInertia(
        mass=20.0, center_of_mass=(0.4 * size, 0.0, size), inertia=np.diag([2.0, 3.0, 1.1]) * size**2
    )
    high, off = tx.pose(position=[0.0, 0.0, 2.0 * size]), tilted(aside * size, tilt)
    place = tx.pose(position=[1e3 * size, 0.0, 0.0])
    links = [
        Link(joints.Revolute("low", Z), panel, place),
        Link(joints.Fixed("top"), None, high, parent="low"),
        Link(joints.Fixed("frame"), None, np.asarray(place) @ np.asarray(high) @ off),
    ]
    sideways = (0.0, 9.81 * np.sin(0.1) * size, -9.81 * size)
    return Mechanism(links, loops=[loops.AxisLoop("c", *frames, Z)], gravity=sideways)


@pytest.mark.parametrize(
    ("tilt", "aside", "frames", "size"),
    [
        (0.0, 0.0, ("top", "frame"), 1.0),
        (1e-9, 0.0, ("top", "frame"), 1.0),
        (1e-6, 0.0, ("frame", "top"), 1.0),
        (0.0, 1e-6, ("top", "frame"), 1.0),
        (1e-6, 1e-6, ("top", "frame"), 1e-3),
    ],
)
def test_a_second_hinge_that_is_a_little_off_does_not_lock_a_door(
    tilt: float, aside: float, frames: tuple[str, str], size: float
) -> None:
    """All rows of the closure are round-off: the door is a pendulum."""
    dynamics, x = moving(door(tilt, aside, frames, size)), {"q": np.array([0.7]), "qd": np.array([0.2])}
    pendulum = 20.0 * 0.4 * 9.81 * np.sin(0.1) * np.cos(0.7) / (1.1 + 20.0 * 0.4**2)
    np.testing.assert_allclose(dynamics(0.0, x)["qd"], [pendulum], rtol=1e-12)
    found = dynamics.outputs(0.0, x)
    assert (int(found["rank"]), int(found["redundant"]), float(found["reciprocal_condition"])) == (0, 5, 1.0)
    assert float(found["misalignment"]) <= 2.1e-6
    np.testing.assert_array_equal(found["F"], np.zeros(6))  # the lower hinge can carry all
    assert float(found["wrench_error"]) == 0.0


# ---- Bennett's linkage: four hinges in space that turn all the same --------------------------------------------------

ALPHA, BETA = np.deg2rad(40.0), np.deg2rad(70.0)
A_LENGTH, B_LENGTH = 0.5, 0.5 * np.sin(BETA) / np.sin(ALPHA)


@functools.cache
def bennett() -> Mechanism:
    def place(length: float, twist: float) -> np.ndarray:
        return tilted(length, twist)

    links = [
        Link(joints.Revolute("j1", Z), rod(A_LENGTH), np.eye(4)),
        Link(joints.Revolute("j2", Z), rod(B_LENGTH), place(A_LENGTH, ALPHA), parent="j1"),
        Link(joints.Revolute("j3", Z), rod(A_LENGTH), place(B_LENGTH, BETA), parent="j2"),
        Link(joints.Fixed("end"), None, place(A_LENGTH, ALPHA), parent="j3"),
        Link(joints.Fixed("ground"), None, np.linalg.inv(place(B_LENGTH, BETA))),
    ]
    return Mechanism(links, loops=[loops.AxisLoop("c", "end", "ground", Z)], gravity=(0.0, 0.0, 0.0))


def bennett_at(angle: float) -> Any:
    ratio = np.sin(0.5 * (BETA + ALPHA)) / np.sin(0.5 * (BETA - ALPHA))

    def positions(s: float) -> np.ndarray:
        return np.array([s, 2.0 * np.arctan2(ratio, np.tan(0.5 * s)), -s])

    h = 1e-6
    rates = (positions(angle + h) - positions(angle - h)) / h
    return moving(bennett()).project(0.0, {"q": positions(angle), "qd": rates})


@pytest.mark.parametrize("angle", [0.5, 1e-2, 1e-4, 1e-6, 0.0])
def test_wrenches_of_bennetts_linkage_about_its_flat_posture(angle: float) -> None:
    x = bennett_at(angle)
    length = float(np.mean([A_LENGTH, B_LENGTH, A_LENGTH, np.linalg.norm(bennett().links[-1].mount.value[:3, 3])]))
    qdd, multipliers, rank = by_kkt(bennett(), x, length)
    found = moving(bennett()).outputs(0.0, x)
    np.testing.assert_allclose(moving(bennett())(0.0, x)["qd"], qdd, rtol=1e-8, atol=1e-10)
    carried = bennett().loops[0].constraint_basis.value @ multipliers
    size = np.linalg.norm(carried)
    np.testing.assert_allclose(np.linalg.norm(found["F"]), size, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found["F"], carried, rtol=0.0, atol=1e-5 * size + 1e-12)
    assert (rank, int(found["rank"]), int(found["redundant"])) == (2, 2, 3)


def test_bennetts_linkage_passes_its_flat_posture() -> None:
    dynamics, x = moving(bennett()), bennett_at(-1.0)
    before = float(dynamics.outputs(0.0, x)["energy"])
    end = tx.integrate(dynamics, x, t1=1.0, dt=1e-3).last
    assert float(end["q"][0]) > 0.5
    assert abs(float(dynamics.outputs(0.0, end)["energy"]) - before) < 1e-8 * before


def test_derivatives_and_batches_at_the_flat_posture() -> None:
    dynamics, x = moving(bennett()), bennett_at(0.0)
    outputs = lambda q: dynamics.outputs(0.0, {**x, "q": q})  # noqa: E731
    slopes = jax.jit(jax.jacfwd(outputs))(jnp.asarray(x["q"]))
    assert all(np.isfinite(each).all() for each in jax.tree.leaves(slopes))
    rate = lambda q: dynamics(0.0, {**x, "q": q})["qd"]  # noqa: E731
    back, forth = jax.jit(lambda q: (jax.jacrev(rate)(q), jax.jacfwd(rate)(q)))(jnp.asarray(x["q"]))
    assert np.isfinite(back).all()
    np.testing.assert_allclose(back, forth, rtol=1e-9, atol=1e-9 * np.abs(forth).max())
    many = jax.tree.map(lambda a: jnp.stack([a, a]), x)
    batch = jax.jit(jax.vmap(lambda x: dynamics(0.0, x)["qd"]))(many)
    np.testing.assert_allclose(batch[1], dynamics(0.0, x)["qd"], rtol=1e-10, atol=1e-12)


def test_slopes_are_those_of_differences() -> None:
    """On the manifold, along the motion of the straight linkage: what a wrench does as the crank turns."""
    dynamics = moving(four_bar(STRAIGHT, loops.AxisLoop("c", "pin", "tip", Y)))
    along = start()["qd"]

    def wrench(s: Any) -> Any:
        return dynamics.outputs(0.0, {"q": start()["q"] + s * along, "qd": start()["qd"]})["F"]

    slope = jax.jit(jax.jacfwd(wrench))(jnp.zeros(()))
    h = 1e-5
    np.testing.assert_allclose(slope, (wrench(h) - wrench(-h)) / (2.0 * h), rtol=1e-6, atol=1e-6)


def test_bad_metrics_are_refused(unchecked: None) -> None:
    for call, words in (
        (lambda: loops.Metric(length=0.0), "Metric: length"),
        (lambda: loops.Metric(tolerance=1.0), "Metric: tolerance"),
        (
            lambda: four_bar(STRAIGHT, loops.PointLoop("c", "pin", "tip"), loop_metric=1e-5),
            "loop_metric to be of Metric",
        ),
        (lambda: mechanics.loop_diagnostics(Mechanism(bennett().links)), "expects a mechanism with loops"),
    ):
        with pytest.raises(tx.ModelError, match=words):
            call()
