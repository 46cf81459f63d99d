"""Springs of drives: their energy, and joints on them without motors."""

from typing import Any

import numpy as np

import twistax as tx
from evaluated import evaluated
from twistax import mechanics
from twistax.mechanics import Drive, Link, Mechanism, Mimic, SpatialInertia, joints

BODY = SpatialInertia(mass=1.2, center_of_mass=(0.2, 0.1, -0.1), inertia=np.diag([0.05, 0.06, 0.07]))


def sprung() -> Mechanism:
    apart, y = tx.pose(position=[0.4, 0.0, 0.1]), (0.0, 1.0, 0.0)
    return Mechanism(
        [
            Link(joints.Spherical("ball"), BODY, np.eye(4), drive=Drive(stiffness=3.0, rest=0.1)),
            Link(joints.Revolute("hinge", y), BODY, apart, parent="ball", drive=Drive(stiffness=5.0, rest=0.3)),
            Link(joints.Prismatic("slide", y), BODY, apart, parent="hinge", drive=Drive(stiffness=40.0, effort=9.0)),
            Link(
                joints.Revolute("follower", y),
                BODY,
                apart,
                parent="hinge",
                drive=Drive(stiffness=2.0),
                mimic=Mimic("hinge", -0.5, 0.2),
            ),
            Link(joints.Revolute("motor", y), BODY, apart, parent="slide", drive=Drive(damping=0.0)),
        ]
    )


def test_energy_has_parts_and_counts_springs() -> None:
    robot = sprung()
    turn, q = np.array([0.3, -0.5, 0.4]), np.array([0.7, -0.2, 0.4])
    x: dict[str, Any] = {"q": q, "qd": np.linspace(-1.0, 1.0, 6), "ball_position": np.asarray(tx.lie.so3.exp(turn))}
    found = evaluated({"parts": robot.energies(), "sum": robot.energy()}, x)
    expected = 1.5 * np.sum((turn - 0.1) ** 2) + 2.5 * 0.4**2 + 20.0 * 0.2**2 + (0.2 - 0.5 * 0.7) ** 2
    assert list(robot.energies()) == ["kinetic", "gravity", "springs"]
    np.testing.assert_allclose(found["parts"]["springs"], expected, rtol=1e-13)
    np.testing.assert_allclose(sum(found["parts"].values()), found["sum"], rtol=1e-15)
    for name, of in (("kinetic", mechanics.kinetic_energy), ("gravity", mechanics.potential_energy)):
        np.testing.assert_allclose(found["parts"][name], evaluated(of(robot), x), rtol=1e-15)
    free = robot.replace(drives={name: Drive() for name in ("ball", "hinge", "slide", "follower")})
    assert evaluated(free.energies()["springs"]) == 0.0


def test_energy_of_a_mechanism_on_springs_stays() -> None:
    links = [
        Link(joints.Revolute("a", (0.0, 1.0, 0.0)), BODY, np.eye(4), drive=Drive(stiffness=5.0, rest=0.3)),
        Link(joints.Spherical("b"), BODY, tx.pose(position=[0.4, 0.0, 0.1]), parent="a", drive=Drive(stiffness=3.0)),
    ]
    robot = Mechanism(links)
    dynamics = tx.compile(robot.system(outputs=robot.energies()))
    x = {"q": np.array([0.2]), "qd": np.array([1.0, 0.4, -0.3, 0.6]), "b_position": np.eye(3)}
    end = tx.integrate(dynamics, x, t1=1.0, rtol=1e-11, atol=1e-11).last
    before, after = (dynamics.outputs(0.0, state) for state in (x, end))
    assert abs(float(after["springs"] - before["springs"])) > 0.1
    np.testing.assert_allclose(sum(after.values()), sum(before.values()), rtol=1e-9)


def test_a_passive_joint_on_a_spring_has_no_motor() -> None:
    robot = sprung()
    assert robot.driven == ("slide", "motor")
    assert robot.system().controls[0].shape == (2,)
    assert robot.system(controls=["hinge"]).controls[0].shape == (1,)
    links = [Link(joints.Revolute("a", (0.0, 1.0, 0.0)), BODY, np.eye(4), drive=Drive(stiffness=5.0))]
    assert not Mechanism(links).system().controls
    assert Mechanism(links, driven=["a"]).system().controls[0].shape == (1,)


def test_states_that_are_not_read_may_be_there() -> None:
    """The inertia of one hinge is a number: whoever has the state of the mechanism hands it over all the same."""
    one = Mechanism([Link(joints.Revolute("a", (0.0, 1.0, 0.0)), BODY, np.eye(4))])
    M = tx.lower(mechanics.mass_matrix(one))
    alone, whole = M(0.0), M(0.0, {"q": np.array([0.3]), "qd": np.zeros(1)})
    np.testing.assert_array_equal(whole, alone)
    assert M(0.0, {"q": np.zeros(1, np.float32)}).dtype == np.float32
