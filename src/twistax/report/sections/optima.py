"""Trajectory problems with known optima: how near SOLVED is to them, whatever the units, the limits and the form."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

import twistax as tx

from ...trajectory import Problem, TrajectoryResult
from ..checks import Check, Section, at_most, between

_Norm = tx.linalg.Norm


def _fastest(limit: float, times: tuple[float, float], distance: float, nodes: int = 21) -> Problem:
    """Least time of p'' = u, |u| <= limit, from rest to rest over a distance: 2 sqrt(distance / limit)."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-limit, max=limit)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": {p: distance, v: 0.0}}
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=nodes, final_time=times, **ends)


def goddard() -> Problem:
    """How high a rocket climbs through an exponential atmosphere.

    Source: Dolan, More, Munson, Benchmarking optimization software with COPS 3.0 (2004), problem 10.
    """
    thrust, scale_height, drag, last, speed = 3.5, 500.0, 310.0, 0.6, 0.5
    h, v = tx.State("h", min=1.0), tx.State("v", min=0.0)
    m, T = tx.State("m", min=last, max=1.0), tx.Control("T", min=0.0, max=thrust)
    force = T - drag * v**2 * tx.Exp(-scale_height * (h - 1.0))
    system = tx.System(rates={h: v, v: force / m - 1.0 / h**2, m: -T / speed})
    return Problem(
        tx.compile(system),
        tx.Maximize(h),
        nodes=51,
        final_time=(0.02, 0.6),
        final_time_guess=0.2,
        initial={h: 1.0, v: 0.0, m: 1.0},
        final={m: last},
    )


def rendezvous(form: str) -> Problem:
    """Least fuel from an offset to rest in 8 s, |u| <= 1: convex, 1.212619 by Clarabel on the same mesh."""
    x, v = tx.State("x", shape=(3,)), tx.State("v", shape=(3,))
    u, s = tx.Control("u", shape=(3,)), tx.Control("s", min=0.0, max=1.0)
    limit, cost = {
        "norm as cost": (_Norm(u) <= 1.0, _Norm(u)),
        "norm below a slack": (_Norm(u) <= s, s),
        "squares below a slack": (u @ u <= s * s, s),
    }[form]
    return Problem(
        tx.compile(tx.System(rates={x: v, v: u}, constraints=[limit])),
        tx.Minimize(running=cost),
        nodes=31,
        final_time=8.0,
        initial={x: [4.0, -2.0, 1.0], v: [0.0, 0.5, -0.2]},
        final={x: np.zeros(3), v: np.zeros(3)},
    )


def _no_slope() -> Problem:
    """|u|^2 least outside of a circle, from a point where the constraint has no slope: nothing need move."""
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,), min=-1.0, max=1.0)
    system = tx.System(rates={x: u}, constraints=[x @ x >= 1.1])
    return Problem(tx.compile(system), tx.Minimize(running=u @ u), nodes=6, final_time=1.0)


_PROBLEMS: dict[str, tuple[Any, float]] = {
    "least time, lengths of 1e-6 m": (lambda: _fastest(1e-6, (0.5, 6.0), 1e-6), 2.0),
    "least time, lengths of 1 m": (lambda: _fastest(1.0, (0.5, 6.0), 1.0), 2.0),
    "least time, lengths of 1e6 m": (lambda: _fastest(1e6, (0.5, 6.0), 1e6), 2.0),
    "least time, up to 20,000 s allowed": (lambda: _fastest(1.0, (0.5, 20_000.0), 1.0), 2.0),
    "1 km at 10 m/s2, up to 200 s allowed": (lambda: _fastest(10.0, (1.0, 200.0), 1000.0), 20.0),
    "Goddard's rocket, 51 nodes": (goddard, 1.01284),
    **{
        f"least fuel, {form}": (functools.partial(rendezvous, form), 1.212619)
        for form in ("norm as cost", "norm below a slack", "squares below a slack")
    },
}


@functools.cache
def _solved(name: str) -> TrajectoryResult:
    return _PROBLEMS[name][0]().solve()


def _apart(name: str) -> float:
    """The relative difference from the optimum; NaN unless SOLVED."""
    result, best = _solved(name), _PROBLEMS[name][1]
    return abs(result.cost / best - 1.0) if result.solved else math.nan


OPTIMA: Section = [
    *(Check(f"{name}: from the optimum", "relative", at_most(1e-5), _apart, name, slow=True) for name in _PROBLEMS),
    *(
        Check(f"{name}: iterations", "steps", between(), lambda n=name: float(_solved(n).iterations), slow=True)
        for name in _PROBLEMS
    ),
    Check(
        "from where a constraint has no slope: cost",
        "least is 0",
        at_most(1e-9),
        lambda: _no_slope().solve().cost,
        slow=True,
    ),
]
