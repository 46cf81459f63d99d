"""Problems with published optima: what comes out, how well it holds, and the same transcription by IPOPT and Fatrop."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import math
import statistics
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import twistax as tx

from ...scenes import powered_descent
from ...trajectory import IPOPT, Fatrop, Problem, TrajectoryResult
from ..checks import Absent, Check, Section, at_most, between
from .optima import goddard, rendezvous

#: Solves of which the fastest counts, starts tried, and the relative difference of costs of one optimum.
_REPEATS, _STARTS, _SAME = 5, 8, 1e-4


def brachistochrone(**options: Any) -> Problem:
    """Fastest slide from (0, 10) m to (10, 5) m. Source: dymos, example brachistochrone."""
    x, y, v = tx.State("x"), tx.State("y"), tx.State("v")
    angle = tx.Control("angle", min=0.01, max=3.13)
    system = tx.System(rates={x: v * tx.Sin(angle), y: -v * tx.Cos(angle), v: 9.80665 * tx.Cos(angle)})
    ends: dict[str, Any] = {"initial": {x: 0.0, y: 10.0, v: 0.0}, "final": {x: 10.0, y: 5.0}}
    return Problem(
        tx.compile(system), tx.Minimize(tx.Time()), final_time=(0.5, 10.0), **ends, **{"nodes": 51, **options}
    )


def bryson_denham(**options: Any) -> Problem:
    """Least effort there and back below a ceiling. Source: Bryson and Ho, Applied Optimal Control (1975), 3.11."""
    x, v, u = tx.State("x", max=1.0 / 9.0), tx.State("v"), tx.Control("u")
    ends: dict[str, Any] = {"initial": {x: 0.0, v: 1.0}, "final": {x: 0.0, v: -1.0}}
    dynamics = tx.compile(tx.System(rates={x: v, v: u}))
    return Problem(dynamics, tx.Minimize(running=0.5 * u**2), final_time=1.0, **ends, **{"nodes": 61, **options})


def cart_pole(**options: Any) -> Problem:
    """Swing-up in 2 s by least squared force. Source: Kelly, SIAM Review 59 (2017), section 6 and appendix E."""
    cart, pole, g, length = 1.0, 0.3, 9.81, 0.5
    q, a = tx.State("q", min=-2.0, max=2.0), tx.State("a")
    dq, da = tx.State("dq"), tx.State("da")
    u = tx.Control("u", min=-20.0, max=20.0)
    sine, cosine = tx.Sin(a), tx.Cos(a)
    mass = cart + pole * sine**2
    system = tx.System(
        rates={
            q: dq,
            a: da,
            dq: (length * pole * sine * da**2 + u + pole * g * cosine * sine) / mass,
            da: -(length * pole * cosine * sine * da**2 + u * cosine + (cart + pole) * g * sine) / (length * mass),
        }
    )
    still: dict[Any, Any] = {q: 0.0, a: 0.0, dq: 0.0, da: 0.0}
    there = {**still, q: 1.0, a: math.pi}
    objective = tx.Minimize(running=u**2)
    return Problem(
        tx.compile(system), objective, final_time=2.0, initial=still, final=there, **{"nodes": 51, **options}
    )


def reorientation(**options: Any) -> Problem:
    """Fastest half turn of a ball with three torques. Source: Bilimoria and Wie, J. Guidance 16 (1993)."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    u = tx.Control("u", shape=(3,), min=-1.0, max=1.0)
    half = np.diag([-1.0, -1.0, 1.0])
    return Problem(
        tx.compile(tx.System(rates={R: w, w: u})),
        tx.Minimize(tx.Time()),
        final_time=(1.0, 6.0),
        initial={R: np.eye(3), w: np.zeros(3)},
        final={R: half, w: np.zeros(3)},
        **{"nodes": 51, **options},
    )


def landing(**options: Any) -> Problem:
    """The landing of the demo; its mass at the end is our own best."""
    return powered_descent.problem(tx.compile(powered_descent.system()), **{"nodes": 25, **options})


@dataclasses.dataclass(frozen=True)
class Published:
    """A problem, its published optimum, and how near to it the mesh is asked to come."""

    make: Callable[[], Problem]
    optimum: float
    bar: float


#: Controls are held, so a mesh misses a continuous optimum by the square of its intervals.
PROBLEMS: dict[str, Published] = {
    "brachistochrone: 1.80160 s, 51 nodes": Published(brachistochrone, 1.80160, 1e-3),
    "Bryson-Denham: 4, 61 nodes": Published(bryson_denham, 4.0, 5e-3),
    "Goddard: 1.01284, 51 nodes": Published(goddard, 1.01284, 1e-5),
    "cart-pole of Kelly: 58.8077, 51 nodes": Published(cart_pole, 58.8077, 1e-2),
    "half turn of Bilimoria and Wie: 3.24307 s, 51 nodes": Published(reorientation, 3.24307, 1e-3),
    "rendezvous of least fuel: 1.212619, 31 nodes": Published(
        functools.partial(rendezvous, "norm as cost"), 1.212619, 1e-5
    ),
    "landing of the demo: 27,260 kg, 25 nodes": Published(landing, 27_260.0, 1e-4),
}


@functools.cache
def _problem(name: str) -> Problem:
    return PROBLEMS[name].make()


@functools.cache
def _plain(name: str) -> TrajectoryResult:
    return _problem(name).solve()


@functools.cache
def _best(name: str) -> TrajectoryResult:
    return _problem(name).solve(guesses=_STARTS)


def _apart(name: str) -> float:
    """The relative difference of the best of all starts; NaN unless SOLVED."""
    best = _best(name)
    return abs(best.cost / PROBLEMS[name].optimum - 1.0) if best.solved else math.nan


def _reached(name: str) -> float:
    """How many starts are SOLVED at the best cost."""
    best = _best(name)
    same = [abs(cost / best.cost - 1.0) <= _SAME for status, cost, *_ in best.tries if status is best.status]
    return float(sum(same)) if best.solved else 0.0


def _between(name: str) -> float:
    """The largest violation between nodes over the size of what is limited."""
    return max(_plain(name).between_nodes.values(), default=0.0)


_SOLVERS: dict[str, Any] = {"twistax": None, "IPOPT": IPOPT(), "Fatrop": Fatrop()}


@functools.cache
def _timed(name: str, by: str) -> TrajectoryResult:
    """The fastest of several equal solves, after one that compiles. Raises Absent unless SOLVED."""
    if _SOLVERS[by] is not None and importlib.util.find_spec("casadi") is None:
        raise Absent("casadi is not installed")
    problem = _problem(name)
    first = problem.solve(solver=_SOLVERS[by])
    if not first.solved:
        raise Absent(f"ends in {first.status.name}")
    again = [problem.solve(solver=_SOLVERS[by]) for _ in range(_REPEATS)]
    return min(again, key=lambda result: result.solve_seconds)


def _iterations(name: str, by: str) -> float:
    return float(_timed(name, by).iterations)


def _milliseconds(name: str, by: str) -> float:
    return 1e3 * _timed(name, by).solve_seconds


def _ratios(measure: Callable[[str, str], float], of: Callable[[Sequence[float]], float]) -> float:
    """Ours over IPOPT's, where both are SOLVED at the same cost."""
    found = []
    for name in PROBLEMS:
        try:
            ours, theirs = _timed(name, "twistax"), _timed(name, "IPOPT")
        except Absent:
            continue
        if abs(ours.cost / theirs.cost - 1.0) <= _SAME:
            found.append(measure(name, "twistax") / measure(name, "IPOPT"))
    if not found:
        raise Absent("IPOPT solved none of them")
    return of(found)


PUBLISHED: Section = [
    check
    for name, published in PROBLEMS.items()
    for check in (
        Check(name, "apart", at_most(published.bar), _apart, name, slow=True),
        Check(name, "starts that reach it, of 8", between(), _reached, name, slow=True),
        Check(name, "beyond limits between nodes", between(), _between, name, slow=True),
        Check(name, "compile, s", between(), lambda n=name: _best(n).compile_seconds, slow=True),
    )
]

SOLVERS: Section = [
    *(
        Check(name, f"{by}, {unit}", between(), measure, name, by, slow=True)
        for name in PROBLEMS
        for measure, unit in ((_iterations, "steps"), (_milliseconds, "ms"))
        for by in _SOLVERS
    ),
]

RATIOS: Section = [
    *(
        Check(f"ours over IPOPT's, {word}", by, at_most(bar), _ratios, measure, of, slow=True)
        for measure, by, bars in ((_iterations, "steps", (1.0, 3.0)), (_milliseconds, "time", (0.3, 1.5)))
        for word, of, bar in zip(("median", "worst"), (statistics.median, max), bars, strict=True)
    ),
]
