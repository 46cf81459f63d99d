"""Trajectory problems whose optimum is known: exactly, as published, or by a convex solver on the same mesh."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

import twistax as tx

from ...scenes import powered_descent
from ...trajectory import Linear, Problem


@dataclasses.dataclass(frozen=True)
class Known:
    """A problem with its known optimum, the largest relative error allowed, and options of its solve."""

    make: Callable[..., Any]
    optimum: float
    bar: float = 1e-5
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @cached_property
    def problem(self) -> Any:
        """The problem, compiled when first used."""
        return self.make()

    @cached_property
    def plain(self) -> Any:
        """The result from the guess of the problem, without options."""
        return self.problem.solve()

    @cached_property
    def result(self) -> Any:
        """The result with the options."""
        return self.problem.solve(**self.options)

    def error(self) -> float:
        """The relative difference of the result from the optimum; NaN unless SOLVED."""
        return abs(self.result.cost / self.optimum - 1.0) if self.result.solved else math.nan


def problem_of(rates: Mapping[Any, Any], objective: Any, constraints: Any = (), **options: Any) -> Problem:
    """A problem of a system with these rates and constraints."""
    system = tx.System(rates=dict(rates), constraints=list(constraints))
    return Problem(tx.compile(system), objective, **options)


def brachistochrone(nodes: Any = 51, **options: Any) -> Problem:
    """Fastest slide from (0, 10) m to (10, 5) m. Source: dymos, example brachistochrone."""
    x, y, v = tx.State("x"), tx.State("y"), tx.State("v")
    angle = tx.Control("angle", min=0.01, max=3.13)
    rates = {x: v * tx.Sin(angle), y: -v * tx.Cos(angle), v: 9.80665 * tx.Cos(angle)}
    options |= {"nodes": nodes, "initial": {x: 0.0, y: 10.0, v: 0.0}, "final": {x: 10.0, y: 5.0}}
    return problem_of(rates, tx.Minimize(tx.Time()), final_time=(0.5, 10.0), **options)


def bryson_denham(nodes: Any = 61, **options: Any) -> Problem:
    """Least effort there and back below a ceiling. Source: Bryson and Ho, Applied Optimal Control (1975), 3.11."""
    x, v, u = tx.State("x", max=1.0 / 9.0), tx.State("v"), tx.Control("u")
    options |= {"nodes": nodes, "initial": {x: 0.0, v: 1.0}, "final": {x: 0.0, v: -1.0}}
    return problem_of({x: v, v: u}, tx.Minimize(running=0.5 * u**2), final_time=1.0, **options)


def orbit_raising(nodes: Any = 60, **options: Any) -> Problem:
    """Farthest circular orbit from that of the Earth in 193 days of a small thrust; lengths in astronomical units.

    Source: Bryson and Ho, Applied Optimal Control (1975), section 2.5.
    """
    r, vr, vt, angle = tx.State("r"), tx.State("vr"), tx.State("vt"), tx.Control("angle")
    thrust = 0.1405 / (1.0 - 0.0749 * tx.Time())
    rates = {r: vr, vr: vt**2 / r - 1.0 / r**2 + thrust * tx.Sin(angle), vt: -vr * vt / r + thrust * tx.Cos(angle)}
    options |= {"nodes": nodes, "initial": {r: 1.0, vr: 0.0, vt: 1.0}, "final": [vr == 0.0, vt == 1.0 / tx.Sqrt(r)]}
    guess = {angle: np.where(np.arange(nodes) < nodes // 2, 0.3, 5.9)}
    return problem_of(rates, tx.Maximize(r), final_time=3.3193, controls=Linear(), guess=guess, **options)


def cart_pole(nodes: Any = 51, **options: Any) -> Problem:
    """Swing-up in 2 s by least squared force. Source: Kelly, SIAM Review 59 (2017), section 6 and appendix E."""
    cart, pole, g, length = 1.0, 0.3, 9.81, 0.5
    q, a = tx.State("q", min=-2.0, max=2.0), tx.State("a")
    dq, da = tx.State("dq"), tx.State("da")
    u = tx.Control("u", min=-20.0, max=20.0)
    sine, cosine = tx.Sin(a), tx.Cos(a)
    mass = cart + pole * sine**2
    rates = {
        q: dq,
        a: da,
        dq: (length * pole * sine * da**2 + u + pole * g * cosine * sine) / mass,
        da: -(length * pole * cosine * sine * da**2 + u * cosine + (cart + pole) * g * sine) / (length * mass),
    }
    still: dict[Any, Any] = {q: 0.0, a: 0.0, dq: 0.0, da: 0.0}
    options |= {"nodes": nodes, "initial": still, "final": {**still, q: 1.0, a: math.pi}}
    return problem_of(rates, tx.Minimize(running=u**2), final_time=2.0, **options)


#: The half turn of Bilimoria and Wie with five switches, all torques at limits: its arcs take a, b, a, a, b, a s, which
#: is 3.2430833 s. Published are 3.24307 s, with a last digit that is not met.
FIVE_SWITCHES = (0.44543899494481, 0.73066364883654)


def reorientation(nodes: Any = 51, **options: Any) -> Problem:
    """Fastest half turn of a ball with three torques. Source: Bilimoria and Wie, J. Guidance 16 (1993)."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    u, zero = tx.Control("u", shape=(3,), min=-1.0, max=1.0), np.zeros(3)
    options |= {"nodes": nodes, "initial": {R: np.eye(3), w: zero}, "final": {R: np.diag([-1.0, -1.0, 1.0]), w: zero}}
    return problem_of({R: w, w: u}, tx.Minimize(tx.Time()), final_time=(1.0, 6.0), **options)


def landing() -> Problem:
    """The landing of the demo; its mass at the end is our own best."""
    return powered_descent.problem(tx.compile(powered_descent.system()), nodes=25)


def goddard(nodes: Any = 51, **options: Any) -> Problem:
    """How high a rocket climbs through an exponential atmosphere.

    Source: Dolan, More, Munson, Benchmarking optimization software with COPS 3.0 (2004), problem 10.
    """
    thrust, scale_height, drag, last, speed = 3.5, 500.0, 310.0, 0.6, 0.5
    h, v = tx.State("h", min=1.0), tx.State("v", min=0.0)
    m, T = tx.State("m", min=last, max=1.0), tx.Control("T", min=0.0, max=thrust)
    force = T - drag * v**2 * tx.Exp(-scale_height * (h - 1.0))
    ends: dict[str, Any] = {"initial": {h: 1.0, v: 0.0, m: 1.0}, "final": {m: last}}
    times: dict[str, Any] = {"final_time": (0.02, 0.6), "final_time_guess": 0.2}
    rates = {h: v, v: force / m - 1.0 / h**2, m: -T / speed}
    return problem_of(rates, tx.Maximize(h), nodes=nodes, **times, **ends, **options)


def rendezvous(form: str, nodes: Any = 31, **options: Any) -> Problem:
    """Least fuel from an offset to rest in 8 s, |u| <= 1: convex, 1.212619 by Clarabel on the same mesh."""
    x, v = tx.State("x", shape=(3,)), tx.State("v", shape=(3,))
    u, s = tx.Control("u", shape=(3,)), tx.Control("s", min=0.0, max=1.0)
    size = tx.linalg.Norm(u)
    limit, cost = {
        "norm as cost": (size <= 1.0, size),
        "norm below a slack": (size <= s, s),
        "squares below a slack": (u @ u <= s * s, s),
    }[form]
    start, end = {x: [4.0, -2.0, 1.0], v: [0.0, 0.5, -0.2]}, {x: np.zeros(3), v: np.zeros(3)}
    options |= {"nodes": nodes, "final_time": 8.0, "initial": start, "final": end}
    return problem_of({x: v, v: u}, tx.Minimize(running=cost), [limit], **options)


def hypersensitive(**options: Any) -> Problem:
    """x' = u - x^3 from 1.5 to 1 in 40 s at least (x^2 + u^2) / 2. Source: Rao and Mease, Automatica 35 (1999).

    Over so long a time it rests at zero in between, where H = 0 says u = x^3 -+ sqrt(x^6 + x^2) for both ends; so the
    optimum is the integral of sqrt(x^6 + x^2) - x^3 up to 1.5 and of sqrt(x^6 + x^2) + x^3 up to 1.
    """
    x, u = tx.State("x"), tx.Control("u")
    options = {"nodes": 41, "final_time": 40.0, "initial": {x: 1.5}, "final": {x: 1.0}} | options
    return problem_of({x: u - x**3}, tx.Minimize(running=0.5 * (x**2 + u**2)), controls=Linear(), **options)


def fastest(limit: float, times: tuple[float, float], distance: float, nodes: Any = 21, **options: Any) -> Problem:
    """Least time of p'' = u, |u| <= limit, from rest to rest over a distance: 2 sqrt(distance / limit)."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-limit, max=limit)
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": {p: distance, v: 0.0}}
    return problem_of({p: v, v: u}, tx.Minimize(tx.Time()), nodes=nodes, final_time=times, **ends, **options)


def no_slope() -> Problem:
    """|u|^2 least outside of a circle, from a point where the constraint has no slope: nothing need move."""
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,), min=-1.0, max=1.0)
    return problem_of({x: u}, tx.Minimize(running=u @ u), [x @ x >= 1.1], nodes=6, final_time=1.0)
