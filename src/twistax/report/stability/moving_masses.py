"""Masses that move within bodies, and closed loops with nearly dependent constraints."""

import functools
from typing import Any

import numpy as np

import twistax as tx

from ...mechanics import (
    Drive,
    Link,
    Mechanism,
    SpatialInertia,
    joints,
    loop_diagnostics,
    loop_wrench,
    loops,
    spatial_momentum,
)
from ..harness.expected import at_most, between, simulated
from ..harness.measurement import Section, quick

_TENSOR = np.array([[2.0, 0.1, 0.0], [0.1, 3.0, -0.2], [0.0, -0.2, 4.0]])
_SPIN = np.array([0.3, -0.2, 0.5, 0.4, 0.9, -0.6])


def _momentum(body: SpatialInertia, rates: dict[Any, Any], start: dict[str, Any]) -> float:
    """The relative change of a free body's momentum [p; L] about the base in 3 s."""
    known = body.with_rates(rates)
    craft = Mechanism([Link(joints.Free("craft"), known, np.eye(4))], gravity=(0.0, 0.0, 0.0))
    dynamics = tx.compile(craft.system(controls=[], rates=rates, outputs={"momentum": spatial_momentum(craft)}))
    x = {"craft_position": np.eye(4), "qd": _SPIN, **start}
    end = simulated(dynamics, x, t1=3.0, rtol=1e-13, atol=1e-13).last
    before, after = (np.asarray(dynamics.outputs(t, state)["momentum"]) for t, state in ((0.0, x), (3.0, end)))
    return float(np.linalg.norm(after - before) / np.linalg.norm(before))


def _in_time() -> float:
    return _momentum(SpatialInertia(mass=10.0, inertia=_TENSOR * (1.0 + 0.3 * tx.Sin(tx.Time()))), {}, {})


def _by_states() -> float:
    length, speed = tx.State("length"), tx.State("speed")
    tip = SpatialInertia(mass=2.0, center_of_mass=tx.Concat(0.2 + length, -0.3, 0.1), inertia=0.1 * np.eye(3))
    body = SpatialInertia(mass=10.0, inertia=_TENSOR) + tip
    rates = {length: speed, speed: 0.3 - 0.4 * length}
    return _momentum(body, rates, {"length": np.array(1.0), "speed": np.array(0.7)})


def _sprung() -> float:
    """The change of energy, springs included, of a ball joint and a hinge on springs in 3 s, over the largest part."""
    body = SpatialInertia(mass=1.2, center_of_mass=(0.2, 0.1, -0.1), inertia=np.diag([0.05, 0.06, 0.07]))
    place, y = tx.pose(position=[0.4, 0.0, 0.1]), (0.0, 1.0, 0.0)
    links = [
        Link(joints.Revolute("hinge", y), body, np.eye(4), drive=Drive(stiffness=5.0, rest=0.3)),
        Link(joints.Spherical("ball"), body, place, parent="hinge", drive=Drive(stiffness=3.0)),
    ]
    robot = Mechanism(links)
    dynamics = tx.compile(robot.system(outputs={**robot.energies(), "sum": robot.energy()}))
    x = {"q": np.array([0.2]), "qd": np.array([1.0, 0.4, -0.3, 0.6]), "ball_position": np.eye(3)}
    end = simulated(dynamics, x, t1=3.0, rtol=1e-12, atol=1e-12).last
    before, after = (dynamics.outputs(0.0, state) for state in (x, end))
    return float(abs(after["sum"] - before["sum"])) / max(abs(float(value)) for value in after.values())


# ---- loops -----------------------------------------------------------------------------------------------------------


def _rod(length: float) -> SpatialInertia:
    return SpatialInertia(mass=1.0, center_of_mass=(0.5 * length, 0.0, 0.0), inertia=np.diag([0.01, 0.05, 0.05]))


def _at(x: float, twist: float = 0.0) -> np.ndarray:
    return np.asarray(tx.pose(position=[x, 0.0, 0.0], rotation=_about_x(twist)))


def _about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


@functools.cache
def _four_bar(tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations and the wrench of the closure, of a four-bar linkage whose rocker's axis is tilted."""
    y = (0.0, 1.0, 0.0)
    links = [
        Link(joints.Revolute("crank", y), _rod(0.4), _at(0.0)),
        Link(joints.Revolute("coupler", y), _rod(1.0), _at(0.4), parent="crank"),
        Link(joints.Fixed("pin"), None, _at(1.0), parent="coupler"),
        Link(joints.Revolute("rocker", y), _rod(0.8), _at(0.9, tilt)),
        Link(joints.Fixed("tip"), None, _at(0.8), parent="rocker"),
    ]
    bar = Mechanism(links, loops=[loops.PointLoop("c", "pin", "tip")])
    straight = bar if not tilt else Mechanism([*links[:3], *_straight(links[3:])], loops=bar.loops)
    x = tx.compile(straight.system(controls=[])).project(0.0, {"q": [-0.9, 0.4, -1.3], "qd": [3.0, 0.0, 0.0]})
    dynamics = tx.compile(bar.system(controls=[], outputs=lambda qdd, tau: {"F": loop_wrench(bar, "c", tau=tau)}))
    return np.asarray(dynamics(0.0, x)["qd"]), np.asarray(dynamics.outputs(0.0, x)["F"])


def _straight(links: list[Link]) -> list[Link]:
    return [Link(links[0].joint, links[0].body, _at(0.9)), links[1]]


def _tilted(part: int) -> float:
    """By how much a tilt of 1e-7 rad changes accelerations (0) or the wrench (1), in parts of them."""
    straight, off = _four_bar(0.0)[part], _four_bar(1e-7)[part]
    return float(np.linalg.norm(off - straight) / np.linalg.norm(straight))


def _ajar(off: float) -> float:
    """How far a door on two hinges, the upper one off by a length, m, is from a pendulum, in parts."""
    panel = SpatialInertia(mass=20.0, center_of_mass=(0.4, 0.0, 1.0), inertia=np.diag([2.0, 3.0, 1.1]))
    links = [
        Link(joints.Revolute("low", (0.0, 0.0, 1.0)), panel, np.eye(4)),
        Link(joints.Fixed("top"), None, tx.pose(position=[0.0, 0.0, 2.0]), parent="low"),
        Link(joints.Fixed("frame"), None, tx.pose(position=[off, 0.0, 2.0])),
    ]
    upper = loops.AxisLoop("upper", "top", "frame", (0.0, 0.0, 1.0))
    door = tx.compile(Mechanism(links, loops=[upper], gravity=(0.0, 1.0, -9.81)).system(controls=[]))
    pendulum = 20.0 * 0.4 * np.cos(0.7) / (1.1 + 20.0 * 0.4**2)
    return abs(float(door(0.0, {"q": np.array([0.7]), "qd": np.zeros(1)})["qd"][0]) / pendulum - 1.0)


@functools.cache
def _bennett() -> tuple[tx.Dynamics, dict[str, Any]]:
    """Bennett's linkage, 1 rad before its flat posture."""
    alpha, beta, z = np.deg2rad(40.0), np.deg2rad(70.0), (0.0, 0.0, 1.0)
    a, b = 0.5, 0.5 * np.sin(beta) / np.sin(alpha)
    links = [
        Link(joints.Revolute("j1", z), _rod(a), np.eye(4)),
        Link(joints.Revolute("j2", z), _rod(b), _at(a, alpha), parent="j1"),
        Link(joints.Revolute("j3", z), _rod(a), _at(b, beta), parent="j2"),
        Link(joints.Fixed("end"), None, _at(a, alpha), parent="j3"),
        Link(joints.Fixed("ground"), None, np.linalg.inv(_at(b, beta))),
    ]
    linkage = Mechanism(links, loops=[loops.AxisLoop("c", "end", "ground", z)], gravity=(0.0, 0.0, 0.0))
    outputs = {"energy": linkage.energy(), **loop_diagnostics(linkage)}
    dynamics = tx.compile(linkage.system(controls=[], outputs=outputs))
    half = np.arctan2(np.sin(0.5 * (beta + alpha)) / np.sin(0.5 * (beta - alpha)), np.tan(-0.5))
    return dynamics, dynamics.project(0.0, {"q": np.array([-1.0, 2.0 * half, 1.0]), "qd": np.array([2.0, 0.0, 0.0])})


@functools.cache
def _passed() -> dict[str, Any]:
    dynamics, x = _bennett()
    return simulated(dynamics, x, t1=1.0, dt=1e-3).last


def _energy() -> float:
    dynamics, x = _bennett()
    before, after = (float(dynamics.outputs(0.0, state)["energy"]) for state in (x, _passed()))
    return abs(after / before - 1.0)


def _redundant() -> float:
    dynamics, _ = _bennett()
    return float(dynamics.outputs(0.0, _passed())["redundant"])


MOVING_MASSES: Section = [
    "Momentum counts what masses that move within a body carry.",
    quick("momentum of a body whose inertia changes in time", "tx.integrate", at_most(1e-12), _in_time),
    "A boom that is a state moves the hub by the acceleration of its centre of mass.",
    quick("momentum of a body with a boom that deploys", "tx.integrate", at_most(1e-12), _by_states),
    "The energy of a mechanism counts the springs of its drives.",
    quick("energy of a hinge and a ball joint on springs", "tx.integrate", at_most(1e-10), _sprung),
]

LOOPS: Section = [
    "An axis that is off by round-off says nothing new: its row is left out.",
    quick("four-bar, an axis tilted by 1e-7 rad: accelerations", "loops", at_most(1e-6), _tilted, 0),
    quick("the same: the closure's wrench", "loops", at_most(1e-6), _tilted, 1),
    "A second hinge of a door says nothing new at all: what its rows are is round-off.",
    quick("a door whose upper hinge is off by 1e-9 m: acceleration", "loops", at_most(1e-12), _ajar, 1e-9),
    quick("the same, by 1e-6 m", "loops", at_most(1e-12), _ajar, 1e-6),
    "In the flat posture rows vanish, and the rank stays.",
    quick("Bennett's linkage through its flat posture, dt = 1 ms: energy", "tx.integrate", at_most(1e-8), _energy),
    quick("the same: redundant rows, of 5", "loop_diagnostics", between(3.0, 3.0, "rows"), _redundant),
]
