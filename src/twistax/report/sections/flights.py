"""Larger problems of the page of optima: an ascent in phases, a quadrotor past spheres, an arm, a chain of masses."""

import itertools
from typing import Any

import numpy as np

import twistax as tx

from ...mechanics import chain_models, inverse_dynamics
from ...trajectory import Linear, Phase, Problem

#: Of the Delta III: gravity, radius, spin and air of the Earth, reference area, drag; SI.
_MU, _RADIUS, _SPIN = 3.986012e14, 6378145.0, 7.29211585e-5
_DENSITY, _SCALE_HEIGHT, _AREA, _DRAG = 1.225, 7200.0, 4.0 * np.pi, 0.5
#: Whole mass, propellant, kg, thrust, N, and burning time, s, of a booster, the first and the second stage.
_BOOSTER, _FIRST, _SECOND = (
    (19_290.0, 17_010.0, 628_500.0, 75.2),
    (104_380.0, 95_550.0, 1_083_100.0, 261.0),
    (19_300.0, 16_820.0, 110_094.0, 700.0),
)
_PAYLOAD = 4164.0
#: Of the orbit: semi-major axis, m, eccentricity, inclination, ascending node, argument of periapsis.
_ORBIT = (24_361_140.0, 0.7308, *np.deg2rad([28.5, 269.8, 130.5]))


def _on_orbit(anomaly: Any) -> tuple[Any, Any]:
    """Place and velocity at a true anomaly."""
    a, e, tilt, node, periapsis = _ORBIT
    turn = lambda axis, angle: np.asarray(tx.SO3.exp(angle * np.eye(3)[axis]))  # noqa: E731
    R = turn(2, node) @ turn(0, tilt) @ turn(2, periapsis)
    p, c, s = a * (1.0 - e**2), tx.Cos(anomaly), tx.Sin(anomaly)
    r = R[:, :2] @ tx.Concat(c, s) * (p / (1.0 + e * c))
    return r, R[:, :2] @ tx.Concat(-s, e + c) * np.sqrt(_MU / p)


#: A rough ascent as a guess: times, s, heights, m, shares of the way around the Earth to the periapsis, speeds, m/s.
_ENDS = np.array([0.0, 75.2, 150.4, 261.0, 920.0])
_HEIGHTS, _WAYS = np.array([0.0, 2e4, 6e4, 1.8e5, 1.8e5]), np.array([0.0, 0.01, 0.04, 0.14, 1.0])
_SPEEDS = np.array([400.0, 1e3, 2.2e3, 5e3, 1e4])


def _path(start: Any, periapsis: Any, ends: Any, nodes: int) -> list[Any]:
    """Places, velocities and angles of thrust of that ascent between two times."""
    times = np.linspace(ends[0], ends[1], nodes)
    height, share, speed = (np.interp(times, _ENDS, a)[:, None] for a in (_HEIGHTS, _WAYS, _SPEEDS))
    up, last = (a / np.linalg.norm(a) for a in (np.asarray(start), np.asarray(periapsis[0])))
    across = np.cross(np.cross(up, last), up)
    across /= np.linalg.norm(across)
    angle = share * np.arccos(up @ last)
    forward = np.cos(angle) * across - np.sin(angle) * up
    place = (_RADIUS + height) * (np.cos(angle) * up + np.sin(angle) * across)
    return [place, speed * forward, 2.2 * times / _ENDS[-1], 0.5 - 0.8 * times / _ENDS[-1]]


def delta_iii(nodes: tuple[int, ...] = (6, 6, 6, 11), **options: Any) -> Problem:
    """The mass that a Delta III brings into a transfer orbit, in four phases: six boosters, three more, two stages.

    The direction of thrust is two angles, linear between nodes. Source: Benson, A Gauss pseudospectral transcription
    for optimal control (2005), section 6.2; 7,529.71 kg by GPOPS, 7,529.66 kg in the manual of PSOPT.
    That the last stage burns no more than it has is said twice, by its time and by its mass, for limits of times move.
    """
    r, v, m = tx.State("r", shape=(3,)), tx.State("v", shape=(3,)), tx.State("m")
    azimuth, elevation = tx.Control("azimuth"), tx.Control("elevation")
    aim = tx.Concat(tx.Cos(elevation) * tx.Cos(azimuth), tx.Cos(elevation) * tx.Sin(azimuth), tx.Sin(elevation))
    distance = tx.linalg.Norm(r)
    wind = v - tx.linalg.Cross(np.array([0.0, 0.0, _SPIN]), r)
    density = _DENSITY * tx.Exp(-(distance - _RADIUS) / _SCALE_HEIGHT)
    drag = (0.5 * _DRAG * _AREA) * density * tx.linalg.Norm(wind) * wind

    def burning(*engines: tuple[int, tuple[float, ...]]) -> Any:
        """The system while so many of these burn."""
        push = sum(count * thrust for count, (_, _, thrust, _) in engines)
        flow = sum(count * fuel / time for count, (_, fuel, _, time) in engines)
        rates: dict[Any, Any] = {r: v, v: -_MU / distance**3 * r + (push * aim - drag) / m, m: -flow}
        return tx.compile(tx.System(rates=rates, constraints={"above the ground": distance >= _RADIUS}))

    latitude = np.deg2rad(28.5)
    start = _RADIUS * np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    spin = np.cross([0.0, 0.0, _SPIN], start)
    begin = 9 * _BOOSTER[0] + _FIRST[0] + _SECOND[0] + _PAYLOAD
    burnt, dry = lambda stage, time: stage[1] * time / stage[3], lambda stage: stage[0] - stage[1]
    step = _BOOSTER[3]
    anomaly = tx.Parameter("anomaly", value=0.0)
    place, speed = _on_orbit(anomaly)
    periapsis = tx.lower([place, speed])(0.0, {})
    begins = [begin, begin - 6 * _BOOSTER[0] - burnt(_FIRST, step)]
    begins.append(begins[1] - 3 * _BOOSTER[0] - burnt(_FIRST, step))
    begins.append(_SECOND[0] + _PAYLOAD)
    stages = [
        (burning((6, _BOOSTER), (1, _FIRST)), step, 6 * dry(_BOOSTER)),
        (burning((3, _BOOSTER), (1, _FIRST)), step, 3 * dry(_BOOSTER)),
        (burning((1, _FIRST)), _FIRST[3] - 2.0 * step, dry(_FIRST)),
        (burning((1, _SECOND)), (300.0, _SECOND[3]), 0.0),
    ]
    phases = [
        Phase(
            system,
            tx.Maximize(m) if number == 3 else None,
            nodes=nodes[number],
            final_time=time,
            final_time_guess=650.0 if number == 3 else None,
            initial={r: start, v: spin, m: begin} if number == 0 else None,
            final=[r == place, v == speed, m >= _PAYLOAD + dry(_SECOND)] if number == 3 else None,
            guess={
                **dict(zip((r, v, azimuth, elevation), _path(start, periapsis, _ENDS[number:], nodes[number]))),
                m: np.linspace(begins[number], begins[number + 1] if number < 3 else 7_000.0, nodes[number]),
            },
            controls=Linear(),
            name=f"stage {number}",
            **options,
        )
        for number, (system, time, _) in enumerate(stages)
    ]
    links = [{m: m - dropped} for _, _, dropped in stages[:-1]]
    return Problem(phases, links=links, free=[anomaly])


#: Centres and radii of spheres, m.
_SPHERES = (((2.0, 0.4, 0.3), 0.9), ((4.2, -0.5, -0.2), 1.0), ((6.3, 0.2, 0.5), 0.8))


def quadrotor(nodes: Any = 31, **options: Any) -> Problem:
    """A quadrotor past three spheres, 8 m from rest to rest in least time, its pose on SE(3); nothing is published."""
    mass, J, arm, twist = 0.8, np.diag([5e-3, 5e-3, 9e-3]), 0.17, 0.016
    mixer = np.array([[1, 1, 1, 1], [0, arm, 0, -arm], [-arm, 0, arm, 0], [twist, -twist, twist, -twist]])
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    rotors = tx.Control("rotors", shape=(4,), min=0.3, max=4.5, guess=np.full(4, mass * 9.81 / 4.0))
    lift, M = mixer @ rotors, np.diag([mass] * 3 + [J[0, 0], J[1, 1], J[2, 2]])
    force = g[:3, :3].T @ np.array([0.0, 0.0, -9.81 * mass]) + tx.Concat(0.0, 0.0, lift[0])
    wrench = tx.lie.wrench(force=force, torque=lift[1:]) - tx.lie.AdjointDual(V, M @ V)
    past = {
        f"sphere {k}": tx.linalg.Dot(g[:3, 3] - np.array(place), g[:3, 3] - np.array(place)) >= radius**2
        for k, (place, radius) in enumerate(_SPHERES)
    }
    dynamics = tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, wrench)}, constraints=past))
    ends: dict[str, Any] = {
        "initial": {g: np.eye(4), V: np.zeros(6)},
        "final": {g: tx.pose(position=[8.0, 0.0, 0.0]), V: np.zeros(6)},
    }
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=nodes, final_time=(0.5, 8.0), **ends, **options)


#: Of the Panda: limits of places, rad, speeds, rad/s, and torques, N m. Source: Franka's documentation.
_LOW = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
_HIGH = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
_FASTEST = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
_TORQUES = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])


def panda(nodes: int = 41, **options: Any) -> Problem:
    """A Panda from one shelf to another in least time, its speeds and torques limited; nothing is published.

    The controls are accelerations, and inverse dynamics say which torques they take.
    """
    arm = chain_models.panda()
    q = tx.State("q", shape=(7,), min=_LOW, max=_HIGH)
    qd = tx.State("qd", shape=(7,), min=-_FASTEST, max=_FASTEST)
    qdd = tx.Control("qdd", shape=(7,))
    share = inverse_dynamics(arm, q, qd, qdd) / _TORQUES
    limits = {"torque up": share <= 1.0, "torque down": share >= -1.0}
    dynamics = tx.compile(tx.System(rates={q: qd, qd: qdd}, constraints=limits))
    ends: dict[str, Any] = {
        "initial": {q: np.array([-0.9, 1.2, 0.0, -0.6, 0.0, 2.2, 0.8]), qd: np.zeros(7)},
        "final": {q: np.array([0.9, 0.3, 0.3, -1.0, 0.2, 2.6, 0.8]), qd: np.zeros(7)},
    }
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=nodes, final_time=(0.2, 4.0), **ends, **options)


def chain_of_masses(count: int = 10, nodes: int = 21) -> Problem:
    """Masses on springs between a wall and an end that is led to rest: 6 count + 3 states; nothing is published.

    Source: Wirsching, Bock, Diehl, Fast NMPC of a chain of masses connected by springs (2006), its masses and lengths.
    """
    mass, length, goal = 0.033, 0.033, np.array([1.0, 0.0, 0.0])
    x, v = tx.State("x", shape=(3 * count,)), tx.State("v", shape=(3 * count,))
    end, u = tx.State("end", shape=(3,)), tx.Control("u", shape=(3,), min=-1.0, max=1.0)
    places: list[Any] = [np.zeros(3), *(x[3 * k : 3 * k + 3] for k in range(count)), end]
    pulls = [(1.0 - length / tx.linalg.Norm(b - a)) * (b - a) for a, b in itertools.pairwise(places)]
    falls = [(b - a) / mass - np.array([0.0, 0.0, 9.81]) for a, b in itertools.pairwise(pulls)]
    line = np.linspace(0.0, 1.0, count + 2)[1:-1, None] * goal
    start: dict[Any, Any] = {x: line.ravel(), v: np.zeros(3 * count), end: goal + np.array([0.0, 0.5, 0.0])}
    cost = tx.Minimize(running=25.0 * (end - goal) @ (end - goal) + v @ v + 0.01 * u @ u)
    dynamics = tx.compile(tx.System(rates={x: v, v: tx.Concat(*falls), end: u}))
    return Problem(dynamics, cost, nodes=nodes, final_time=4.0, substeps=2, initial=start)
