"""Joints, mechanisms and flight say of what kind their states, wrenches and outputs are."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import Link, Mechanism, SpatialInertia, flight, joints

BODY = SpatialInertia(mass=4.0, center_of_mass=(0.1, 0.0, 0.2), inertia=np.diag([0.4, 0.5, 0.3]))
AT = tx.pose(position=[0.0, 0.1, 0.3])


def arm() -> Mechanism:
    return Mechanism(
        [
            Link(joints.Free("hub"), BODY, np.eye(4)),
            Link(joints.Spherical("ball"), BODY, np.eye(4), parent="hub", name="dish"),
            Link(joints.Revolute("hinge", (0.0, 0.0, 1.0)), BODY, AT, parent="hub"),
            Link(joints.Fixed("tip"), None, AT, parent="hinge"),
        ]
    )


def planar() -> Mechanism:
    y = (0.0, 1.0, 0.0)
    return Mechanism(
        [Link(joints.Revolute("one", y), BODY, np.eye(4)), Link(joints.Revolute("two", y), BODY, AT, parent="one")]
    )


def wrench_at(frame: str, kind: Any) -> tx.System:
    return arm().system(wrenches={frame: tx.Control("W", (6,), kind=kind)})


def position_of(frame: str, **more: Any) -> tx.System:
    mechanism, p = arm(), tx.State("p", shape=(3,), kind=tx.Point("base"))
    return mechanism.system(rates={p: -1.0 * p}, outputs={"y": mechanism.pose(frame, **more)[:3, 3] - p})


def pushed(frame: str, unit: str = "N") -> tx.System:
    craft = flight.Vehicle(wind=flight.Steady((3.0, 1.0, 0.0)))
    force = tx.Control("F", (3,), kind=tx.FreeVector(frame), unit=unit)
    engine = flight.Engine(10.0, position=(-1.0, 0.0, 0.0))
    loads = tx.lie.wrench(force=force + flight.drag(craft.air, 0.2), torque=np.zeros(3)) + engine.wrench
    return craft.system(BODY, loads, outputs={"mach": craft.air.mach, "spin": craft.rate(flight.local_axes)})


def weighted(unit: str) -> tx.System:
    mechanism, gain = planar(), tx.Parameter("gain", value=3.0, unit=unit)
    return mechanism.system(forces=-gain * mechanism.qd)


def wind(frame: str) -> tx.System:
    craft, still = flight.Vehicle(), tx.Parameter("still", value=[1.0, 0.0, 0.0], kind=tx.FreeVector(frame), unit="m/s")
    return craft.system(BODY, outputs={"y": craft.ned_velocity - still})


RIGHT: dict[str, Callable[[], tx.System]] = {
    "a wrench at a link": lambda: wrench_at("hinge", tx.Wrench("hinge")),
    "a wrench at a frame": lambda: wrench_at("tip", tx.Wrench("tip")),
    "by the name of a joint": lambda: wrench_at("ball", tx.Wrench("dish")),
    "a position": lambda: position_of("tip"),
    "a force on a vehicle": lambda: pushed("body"),
    "a damping": lambda: weighted("N m s"),
    "a wind": lambda: wind("ned"),
}
WRONG: dict[str, tuple[Callable[[], tx.System], str]] = {
    "a wrench of another link": (lambda: wrench_at("hinge", tx.Wrench("hub")), "'hub' and 'hinge'"),
    "a wrench of the world": (
        lambda: wrench_at("tip", tx.Wrench("world")),
        "two frames are combined: 'world' and 'tip'",
    ),
    "a twist for a wrench": (lambda: wrench_at("tip", tx.Twist("tip")), "a twist is combined with a wrench"),
    "a position in a link": (lambda: position_of("tip", relative_to="dish"), "'base' and 'dish'"),
    "a force in inertial axes": (lambda: pushed("inertial"), "'body' and 'inertial'"),
    "a moment for a force": (lambda: pushed("body", "N m"), "Add has one unit"),
    "a wind in body axes": (lambda: wind("body"), "'body' and 'ned'"),
}


@pytest.mark.parametrize("what", RIGHT)
def test_right_models_are_accepted(what: str) -> None:
    assert isinstance(RIGHT[what](), tx.System)


@pytest.mark.parametrize("what", WRONG)
def test_wrong_models_are_refused(what: str) -> None:
    build, message = WRONG[what]
    with pytest.raises(tx.KindError, match=message):
        build()


def test_models_that_declare_nothing_are_not_checked() -> None:
    mechanism = planar()
    mechanism.system(forces=-mechanism.q - tx.Tanh(mechanism.qd), outputs={"cost": mechanism.qd @ mechanism.qd})


def test_what_layers_know_is_told() -> None:
    known = tx.compile(planar().system()).explain(kinds=True)
    assert (known.leaves["q"], known.leaves["qd"]) == ("unit 1", "unit 1/s")
    assert known.leaves["tau"] == "unit kg m2/s2"
    assert known.declared == []
    known = tx.compile(arm().system()).explain(kinds=True)
    assert known.leaves["hub_position"] == "from 'hub' to 'base'"
    assert known.leaves["ball_position"] == "from 'dish' to 'hub', unit 1"


def test_a_vehicle_says_its_frames() -> None:
    known = tx.compile(flight.Vehicle().system(BODY)).explain(kinds=True)
    assert known.leaves == {"g": "from 'body' to 'inertial'", "V": "a twist, in 'body', unit 1/s"}
    outputs = {"fixed_position": "in 'fixed', unit m", "ned_velocity": "in 'ned', unit m/s", "density": "unit kg/m3"}
    assert {name: known.outputs[name] for name in outputs} == outputs


def test_every_joint_says_the_unit_of_its_coordinates() -> None:
    z = (0.0, 0.0, 1.0)
    units = {"unit 1": joints.Revolute("j", z), "unit m": joints.Prismatic("j", z), "unit open": joints.Planar("j")}
    for unit, joint in units.items():
        system = tx.System(rates={**joint.rates, joint.velocity: -1.0 * joint.velocity})
        assert tx.compile(system).explain(kinds=True).leaves["j_position"] == unit


def test_programs_do_not_depend_on_what_is_declared() -> None:
    R, v = tx.State("R", group=tx.SO3), tx.State("v", shape=(3,))
    plain = R @ v + 1.0
    said = tx.kinds.declare(plain, tx.FreeVector("world"), "m/s")
    assert said.key() == plain.key()
    assert said.canonicalize().key() == plain.canonicalize().key()
    rates = {R: np.zeros(3), v: -1.0 * v}
    programs = [tx.compile(tx.System(rates=rates, outputs={"y": y})).explain("y").operations for y in (plain, said)]
    assert programs[0] == programs[1]
    declared, open_one = wrench_at("tip", tx.Wrench("tip")), wrench_at("tip", None)
    keys = [[rate.canonicalize().key() for rate in system.rates.values()] for system in (declared, open_one)]
    assert keys[0] == keys[1]


def test_an_expression_that_declares_asks_for_the_check() -> None:
    R, v = tx.State("R", group=tx.SO3), tx.State("v", shape=(3,))
    rates = {R: np.zeros(3), v: -1.0 * v}
    turned = tx.kinds.declare(R @ v, tx.FreeVector("world"))
    with pytest.raises(tx.KindError, match="two frames are combined"):
        tx.System(rates=rates, outputs={"y": turned + tx.kinds.declare(R.T @ v, tx.FreeVector("body"))})
    with pytest.raises(tx.ModelError, match="expects a kind or a unit"):
        tx.kinds.declare(v)
    long = tx.kinds.declare(tx.Parameter("h", value=2.0, unit="kg") * 2, unit="m")
    with pytest.raises(tx.KindError, match="is declared in m"):
        tx.System(rates=rates, outputs={"y": long})
