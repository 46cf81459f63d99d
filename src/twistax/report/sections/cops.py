"""Optimal control problems of COPS with their published optima.

Source: Dolan, More, Munson, Benchmarking optimization software with COPS 3.0 (2004); the problem numbers are those of
this paper, and the values those of the finest meshes of its tables.
"""

import math
from typing import Any

import twistax as tx

from ...trajectory import Linear, Problem
from .problems import problem_of


def robot_arm(nodes: Any = 51, **options: Any) -> Problem:
    """Least time of an arm that turns and slides, between two points: problem 8, 9.14093.

    Its length is rho, at most 5, and its angles are theta and phi. Torques and the force are at most 1.
    """
    limits = {"rho": (0.0, 5.0), "theta": (-math.pi, math.pi), "phi": (0.0, math.pi)}
    places = [tx.State(name, min=low, max=high) for name, (low, high) in limits.items()]
    rates = [tx.State(f"rate of {name}") for name in limits]
    rho, _, phi = places
    u = tx.Control("u", shape=(3,), min=-1.0, max=1.0)
    length = 5.0
    inertia = ((length - rho) ** 3 + rho**3) / 3.0
    heavy = (length, inertia * tx.Sin(phi) ** 2, inertia)
    rates_of: dict[Any, Any] = dict(zip(places, rates)) | {rate: u[k] / heavy[k] for k, rate in enumerate(rates)}
    still: dict[Any, Any] = dict.fromkeys(rates, 0.0)
    start, goal = (
        dict(zip(places, values)) for values in ((4.5, 0.0, math.pi / 4.0), (4.5, 2.0 * math.pi / 3.0, math.pi / 4.0))
    )
    options |= {"nodes": nodes, "initial": still | start, "final": still | goal}
    return problem_of(rates_of, tx.Minimize(tx.Time()), final_time=(1.0, 30.0), **options)


def particle_steering(nodes: Any = 51, **options: Any) -> Problem:
    """Least time of a thrust of given size to a height and a speed along the ground: problem 9, 0.554571."""
    size, height, speed = 100.0, 5.0, 45.0
    x, y, vx, vy = (tx.State(name) for name in ("x", "y", "vx", "vy"))
    angle = tx.Control("angle", min=-math.pi / 2.0, max=math.pi / 2.0)
    rates: dict[Any, Any] = {x: vx, y: vy, vx: size * tx.Cos(angle), vy: size * tx.Sin(angle)}
    zero: dict[Any, Any] = dict.fromkeys((x, y, vx, vy), 0.0)
    options |= {"nodes": nodes, "initial": zero, "final": {y: height, vx: speed, vy: 0.0}, "controls": Linear()}
    return problem_of(rates, tx.Minimize(tx.Time()), final_time=(0.1, 10.0), **options)


def catalyst_mixing(nodes: Any = 101, **options: Any) -> Problem:
    """How two catalysts are mixed along a reactor for most of the product: problem 14, 0.0480556."""
    x1, x2, u = tx.State("x1"), tx.State("x2"), tx.Control("u", min=0.0, max=1.0)
    swap = u * (10.0 * x2 - x1)
    rates: dict[Any, Any] = {x1: swap, x2: -swap - (1.0 - u) * x2}
    options |= {"nodes": nodes, "initial": {x1: 1.0, x2: 0.0}}
    return problem_of(rates, tx.Maximize(1.0 - x1 - x2), final_time=1.0, **options)
