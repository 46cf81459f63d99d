"""Bad input of what edits, writes, reaches and identifies: an error that names it, in words of this package."""

from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax import mechanics
from twistax.errors import InputError, ModelError
from twistax.mechanics import Drive, Link, PositionTask, PostureTask, SpatialInertia, identify, joints, reach

BODY = SpatialInertia(mass=1.0, center_of_mass=(0.1, 0.0, 0.2), inertia=0.1 * np.eye(3))
ARM, PLANAR = (
    mechanics.Chain([Link(joints.Revolute(n, (0.0, 1.0, 0.0)), BODY, tx.pose(position=[0.0, 0.0, 0.3])) for n in names])
    for names in ("ab", "abc")
)
X = {"q": np.zeros(2)}
POINT = SpatialInertia(mass=1.0, center_of_mass=(0.0, 0.3, 0.0), inertia=np.zeros((3, 3)))
TARGET = np.array([0.1, 0.0, 0.5])


def controller(*tasks: mechanics.Task) -> mechanics.DifferentialController:
    return mechanics.DifferentialController(ARM, tasks, dt=0.01, acceleration=5.0)


def records(**changes: Any) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {name: rng.normal(size=(9, 2)) for name in ("q", "qd", "qdd", "tau")} | changes


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: ARM.replace(drives=[Drive()]), ModelError, "drives by the names of joints"),
        (lambda: ARM.to_urdf(None), ModelError, "to_urdf: name expects text"),
        (lambda: ARM.to_urdf("out/arm.urdf"), ModelError, r"got the path 'out/arm.urdf'.\n  fix: pathlib.Path"),
        (lambda: ARM.to_mjcf("arm.xml"), ModelError, "to_mjcf: name expects the name of the robot, got the path"),
        (
            lambda: ARM.without(["link7"]),
            ModelError,
            r"expects names of links, got .*\n  fix: without\(\*\['link7'\]\)",
        ),
        (lambda: ARM.without(7), ModelError, "expects names of links, got 7"),
        (lambda: ARM.to_mjcf(3), ModelError, "to_mjcf: name expects text"),
        (lambda: ARM.to_urdf(leave_out=None), ModelError, "leave_out expects names"),
        (lambda: Drive(upper=np.inf), ModelError, "None where there is no limit"),
        (lambda: ARM.system(controls=3), ModelError, "joints expects names"),
        (lambda: ARM.system(rates=[1]), ModelError, "rates must be a dict from states"),
        (lambda: ARM.system(forces=[np.nan, 0.0]), ModelError, "forces to be finite"),
        (lambda: ARM.system(wrenches={"b": np.full(6, np.inf)}), ModelError, "wrench at 'b' to be finite"),
        (lambda: ARM.inverse_system(outputs=[1]), ModelError, "outputs expects expressions by name"),
        (
            lambda: ARM.replace(drives={"a": Drive(gear=0.0)}).inverse_system(),
            ModelError,
            "motors of 'a' have a gear of zero",
        ),
        (lambda: ARM.with_inertia({"b": POINT}).system(), ModelError, "no inertia about the axis of joint 'b'"),
        (lambda: reach(ARM, {"b": "far"}), InputError, "real numbers"),
        (lambda: reach(ARM, {"b": None}), InputError, "real numbers"),
        (lambda: reach(ARM, {"b": [[1.0, 2.0], [3.0]]}), InputError, "real numbers"),
        (lambda: reach(ARM, {"b": 1j * TARGET}), InputError, "real numbers"),
        (lambda: reach(ARM, {"b": TARGET}, start={"q": "ab"}), InputError, "real numbers"),
        (lambda: reach(ARM, {"b": TARGET}, start={"q": [0.0, np.nan]}), InputError, "finite numbers for 'q'"),
        (lambda: reach(ARM, {"b": TARGET}, secondary=[PostureTask([np.nan, 0.0])]), ModelError, "target to be finite"),
        (lambda: reach(ARM, {"b": TARGET}, constraints={"k": ARM.q[0] <= np.nan}), ModelError, "'k' is never finite"),
        (
            lambda: controller(PositionTask("b", TARGET), PositionTask("b", 2.0 * TARGET)),
            ModelError,
            "two tasks have targets named 'b_position' with different numbers",
        ),
        (lambda: controller(mechanics.ManipulabilityTask("b")), ModelError, r"\(3, 2\) is singular everywhere"),
        (
            lambda: mechanics.DifferentialController(PLANAR, [mechanics.ManipulabilityTask("c")], dt=0.01),
            ModelError,
            "of 'c' is singular everywhere",
        ),
        (lambda: controller(PostureTask([0.0, 0.0]))(X, qd=[1.0]), InputError, r"expects qd \(2,\), got \(1,\)"),
        (
            lambda: controller(PostureTask([0.0, 0.0]))(X, qd=[0.0, 0.0], warm=3),
            InputError,
            "warm expects the step before",
        ),
        (
            lambda: controller(PostureTask([0.0, 0.0])).replace(gain=1.0),
            InputError,
            "arguments of replace are 'dt', .*got 'gain'",
        ),
        (
            lambda: mechanics.computed_torque(ARM, TARGET[:2], TARGET[:2], stiffness=-1.0, damping=1.0),
            ModelError,
            "stiffness to be finite and 0 or more",
        ),
        (lambda: mechanics.base_parameters(ARM, drives=3), ModelError, "drives expects names"),
        (lambda: mechanics.identifiable_combinations(np.eye(1), None), ModelError, "names expects names"),
        (lambda: mechanics.physical_inertia(np.full(10, np.nan)), ModelError, "finite parameters"),
        (lambda: identify(ARM, records(), links=3), ModelError, "links expects names"),
        (lambda: identify(ARM, records(), drives=None), ModelError, "drives expects names"),
        (lambda: identify(ARM, records(), params=[1]), InputError, "params"),
        (lambda: identify(ARM, records(), params={"m": 1.0}), InputError, "params"),
        (lambda: identify(ARM, records(tau=np.full((9, 2), 1e200))), InputError, "below 1e"),
        (lambda: identify(ARM, records(), noise=1e-300), InputError, "noise"),
    ],
)
def test_it_is_refused(call: Any, error: type[Exception], match: str, unchecked: None) -> None:
    with pytest.raises(error, match=match):
        call()


def test_half_precision_targets_and_indices_of_results(unchecked: None) -> None:
    result = reach(ARM, {"b": TARGET.astype(np.float16)}, seeds=1)
    assert result.x["q"].dtype == np.float32
    with pytest.raises(InputError, match=r"index into \(\), got \(3,\)"):
        result.stopped_by(3)


def test_a_target_on_the_base_is_reached_with_positions_that_are_numbers() -> None:
    result = reach(ARM, {"base": np.zeros(3)}, seeds=1)
    assert result.status == mechanics.ReachStatus.REACHED
    assert np.isfinite(result.x["q"]).all()


def test_links_beside_one_with_the_name_of_the_base_are_on_the_ground() -> None:
    places = {"base": 1.0, "table": 3.0}
    links = [
        Link(joints.Revolute(n, (0.0, 1.0, 0.0)), BODY, tx.pose(position=[x, 0.0, 0.0])) for n, x in places.items()
    ]
    for name, x in places.items():
        pose = tx.lower(mechanics.Mechanism(links).pose(name))(0.0, {"q": np.zeros(2)})
        assert pose[0, 3] == x


def test_a_name_twice_is_one() -> None:
    assert mechanics.base_parameters(ARM, drives=["damping", "damping"]).names[-2:] == ("a.damping", "b.damping")


def test_known_bodies_with_parameters() -> None:
    body = SpatialInertia(mass=tx.Parameter("m"), inertia=np.eye(3))
    arm = ARM.with_inertia({"b": body})
    tau = tx.lower(mechanics.inverse_dynamics(arm, qdd=tx.State("qdd", (2,))))
    data = records()
    exact = [tau(0.0, {n: data[n][k] for n in ("q", "qd", "qdd")}, params={"m": 2.0}) for k in range(9)]
    data["tau"] = np.array(exact)
    result = identify(arm, data, links=["a"], noise=1e-3, params={"m": 2.0})
    assert result.estimate("a.mx")[0] == pytest.approx(0.1)
