"""Distances of solved problems from known optima, on fixed and refined meshes; solves by IPOPT and Fatrop."""

import functools
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import twistax as tx

from ...trajectory import IPOPT, Fatrop, Linear, Mesh, Problem, TrajectoryResult
from ..harness.expected import Absent, at_most, between, needed
from ..harness.measurement import Section, slow, table
from ..harness.timing import printed
from . import cops, flights, problems
from .problems import FIVE_SWITCHES, Known

#: Solves of which the fastest counts, starts tried, and the relative difference of costs of one optimum.
_REPEATS, _STARTS, _SAME = 5, 8, 1e-4


def _beyond(result: TrajectoryResult) -> float:
    """The largest violation of a limit between nodes, relative to the size of what is limited."""
    return max(result.between_nodes.values(), default=0.0)


# ---- whatever the units, the limits and the form ---------------------------------------------------------------------

_of = functools.partial
_FORMS = ("norm as cost", "norm below a slack", "squares below a slack")

_KNOWN: dict[str, Known] = {
    "least time, lengths of 1e-6 m": Known(_of(problems.fastest, 1e-6, (0.5, 6.0), 1e-6), 2.0),
    "least time, lengths of 1 m": Known(_of(problems.fastest, 1.0, (0.5, 6.0), 1.0), 2.0),
    "least time, lengths of 1e6 m": Known(_of(problems.fastest, 1e6, (0.5, 6.0), 1e6), 2.0),
    "least time, up to 20,000 s allowed": Known(_of(problems.fastest, 1.0, (0.5, 20_000.0), 1.0), 2.0),
    "1 km at 10 m/s2, up to 200 s allowed": Known(_of(problems.fastest, 10.0, (1.0, 200.0), 1000.0), 20.0),
    "Goddard's rocket, 51 nodes": Known(problems.goddard, 1.01284),
    **{f"least fuel, {form}": Known(_of(problems.rendezvous, form), 1.212619) for form in _FORMS},
}
_FLAT = "start where a constraint has zero derivatives: cost"

OPTIMA: Section = [
    *(slow(f"{name}: from the optimum", "relative", at_most(it.bar), it.error) for name, it in _KNOWN.items()),
    *(slow(f"{name}: iterations", "steps", between(), lambda k=it: k.result.iterations) for name, it in _KNOWN.items()),
    slow(_FLAT, "least is 0", at_most(1e-9), lambda: problems.no_slope().solve().cost),
]

# ---- as published ----------------------------------------------------------------------------------------------------

_DELTA = "Delta III in four phases, linear: 7,529.712 kg, 29 nodes"

#: Controls are held, so a mesh misses a continuous optimum by the square of its intervals.
_HELD: dict[str, tuple[Callable[[], Any], float, float]] = {
    "brachistochrone: 1.80160 s, 51 nodes": (problems.brachistochrone, 1.80160, 1e-3),
    "Bryson-Denham: 4, 61 nodes": (problems.bryson_denham, 4.0, 5e-3),
    "Goddard: 1.01284, 51 nodes": (problems.goddard, 1.01284, 1e-5),
    "cart-pole of Kelly: 58.8077, 51 nodes": (problems.cart_pole, 58.8077, 1e-2),
    "half turn of Bilimoria and Wie: 3.24307 s, 51 nodes": (problems.reorientation, 3.24307, 1e-3),
    "rendezvous of least fuel: 1.212619, 31 nodes": (_of(problems.rendezvous, _FORMS[0]), 1.212619, 1e-5),
    "landing of the demo: 27,260 kg, 25 nodes": (problems.landing, 27_260.0, 1e-4),
    "orbit raising of Bryson and Ho, linear: 1.525, 60 nodes": (problems.orbit_raising, 1.525, 1e-4),
    "robot arm of COPS: 9.14093 s, 51 nodes": (cops.robot_arm, 9.14093, 1e-3),
    "particle steering of COPS, linear: 0.554571 s, 51 nodes": (cops.particle_steering, 0.554571, 2e-6),
    "catalyst mixing of COPS: 0.0480556, 101 nodes": (cops.catalyst_mixing, 0.0480556, 1e-5),
    _DELTA: (flights.delta_iii, 7529.712, 1e-5),
    "quadrotor past three spheres: 1.489138 s, 31 nodes": (flights.quadrotor, 1.489138, 1e-5),
    "Panda from shelf to shelf: 0.860227 s, 41 nodes": (flights.panda, 0.860227, 1e-5),
}
PROBLEMS = {name: Known(*fields, {"guesses": _STARTS}) for name, fields in _HELD.items()}


def _reached(it: Known) -> float:
    """The number of starts that are SOLVED at the best cost."""
    best = it.result
    same = [abs(cost / best.cost - 1.0) <= _SAME for status, cost, *_ in best.tries if status is best.status]
    return float(sum(same)) if best.solved else 0.0


PUBLISHED: Section = table(
    PROBLEMS,
    {
        "apart": (lambda it: at_most(it.bar), Known.error),
        "starts that reach it, of 8": (between(), _reached),
        "beyond limits between nodes": (between(), lambda it: _beyond(it.plain)),
        "compile, s": (between(), lambda it: it.result.compile_seconds),
    },
)

# ---- on refined meshes -----------------------------------------------------------------------------------------------


def _refined(make: Callable[..., Any], optimum: float, bar: float = 1e-6, more: Any = None, **options: Any) -> Known:
    return Known(_of(make, **options), optimum, bar, {"refine": 1e-6, **(more or {})})


_TURN, _ARCS = "half turn of Bilimoria and Wie, free node times: 3.2430833 s", float(np.dot(FIVE_SWITCHES, (4.0, 2.0)))
_LANDING = "landing of the demo, held, limits kept between nodes"
_FREE: dict[str, Any] = {"nodes": Mesh(7, free=True), "substeps": 8}

#: Bars are 1e-6, or half of the last digit that is published.
KNOWN: dict[str, Known] = {
    "brachistochrone, linear: 1.801603": _refined(problems.brachistochrone, 1.801603122, nodes=13, controls=Linear()),
    "Bryson-Denham, linear: exactly 4": _refined(problems.bryson_denham, 4.0, nodes=16, controls=Linear()),
    "Goddard, held: 1.01284": _refined(problems.goddard, 1.01284, 5e-6),
    "cart-pole of Kelly, linear: 58.8077": _refined(problems.cart_pole, 58.8077, nodes=26, controls=Linear()),
    _TURN: _refined(problems.reorientation, _ARCS, more={"guesses": _STARTS}, **_FREE),
    "hypersensitive, linear: 1.330807": _refined(problems.hypersensitive, 1.3308069049430025),
    _DELTA: _refined(flights.delta_iii, 7529.712, 1e-6),
    _LANDING: _refined(problems.landing, 27_260.0, 1e-3, {"refine": 1e-5, "between": 1e-4}),
}


REFINED: Section = table(
    KNOWN,
    {
        "apart": (lambda it: at_most(it.bar), Known.error),
        "meshes": (between(), lambda it: len(it.result.meshes)),
        "nodes of the last": (between(), lambda it: it.result.meshes[-1].nodes),
        "largest error of an interval": (
            lambda it: at_most(it.options["refine"]),
            lambda it: np.max(it.result.meshes[-1].error),
        ),
        "beyond limits between nodes": (between(), lambda it: _beyond(it.result)),
    },
)

# ---- beside other solvers --------------------------------------------------------------------------------------------

_SOLVERS: dict[str, Any] = {"twistax": None, "IPOPT": IPOPT, "Fatrop": Fatrop}
#: The longest that a solver of others may take, and what all repeats may take together, s.
_LONGEST, _TOGETHER = 120.0, 10.0


@functools.cache
def _tried(name: str, by: str) -> TrajectoryResult:
    """The fastest of several equal solves, after one that compiles and may hang; that one unless it is SOLVED."""
    kind, problem = _SOLVERS[by], PROBLEMS[name].problem
    first = problem.solve(solver=kind and kind(max_seconds=_LONGEST))
    repeats: list[TrajectoryResult] = []
    begin = time.perf_counter()
    while first.solved and len(repeats) < _REPEATS and time.perf_counter() - begin < _TOGETHER:
        repeats.append(problem.solve(solver=kind and kind(max_seconds=None)))
    return min(repeats, key=lambda result: result.solve_seconds, default=first)


def _timed(name: str, by: str) -> TrajectoryResult:
    """The solve of a problem by a solver. Raises Absent unless it is SOLVED."""
    if _SOLVERS[by] is not None:
        needed("casadi")
    result = _tried(name, by)
    if not result.solved:
        raise Absent(f"ends in {result.status.name}")
    return result


_iterations = lambda name, by: _timed(name, by).iterations  # noqa: E731
_milliseconds = lambda name, by: 1e3 * _timed(name, by).solve_seconds  # noqa: E731
SOLVERS: Section = [
    slow(name, f"{by}, {unit}", between(), measure, name, by, place=(by, float(row)) if unit == "ms" else None)
    for row, name in enumerate(PROBLEMS, 1)
    for measure, unit in ((_iterations, "steps"), (_milliseconds, "ms"))
    for by in _SOLVERS
]


def _ratios(measure: Callable[[str, str], float], of: Callable[[Sequence[float]], float]) -> float:
    """Ours over IPOPT's, where both are SOLVED at the same cost."""
    ratios = []
    for name in PROBLEMS:
        try:
            ours, theirs = _timed(name, "twistax"), _timed(name, "IPOPT")
        except Absent:
            continue
        if abs(ours.cost / theirs.cost - 1.0) <= _SAME:
            ratios.append(measure(name, "twistax") / measure(name, "IPOPT"))
    if not ratios:
        raise Absent("IPOPT solved none of them")
    return of(ratios)


RATIOS: Section = [
    slow(f"ours over IPOPT's, {word}", by, at_most(bar), _ratios, measure, of)
    for measure, by, bars in ((_iterations, "steps", (1.0, 3.0)), (_milliseconds, "time", (0.3, 1.5)))
    for word, of, bar in zip(("median", "worst"), (statistics.median, max), bars, strict=True)
]

# ---- many cases, and the first solve of a process --------------------------------------------------------------------

#: Cases that are solved alone, too.
_ALONE = 64

#: With the problem in place of the braces.
_FIRST_SOLVE = """import time, jax
jax.config.update("jax_enable_x64", True)
from twistax.report.sections import flights
problem = flights.{}
begin = time.process_time()
problem.solve()
print(time.process_time() - begin)
"""


def _quadrotors() -> tuple[Problem, str, Any]:
    places = np.random.default_rng(0).normal(size=(64, 3)) * [0.1, 0.3, 0.3]
    return flights.quadrotor(20), "g", np.array([tx.pose(position=place) for place in places])


def _integrators() -> tuple[Problem, str, Any]:
    return problems.fastest(1.0, (0.5, 6.0), 1.0), "p", np.random.default_rng(0).uniform(-1.0, 0.5, 1024)


def _at_once(made: Callable[[], tuple[Problem, str, Any]]) -> float:
    """The time of a case in `solve_many` over that of a single solve."""
    problem, state, starts = made()
    some = starts[:: len(starts) // _ALONE]
    problem.solve_many(initial={state: starts})  # as many rows as these compile, and what is rare
    begin = time.perf_counter()
    for start in some:
        problem.solve(initial={state: start})
    alone = (time.perf_counter() - begin) / len(some)
    begin = time.perf_counter()
    many = problem.solve_many(initial={state: starts})
    share = (time.perf_counter() - begin) / len(starts) / alone
    if not many.solved.all():
        raise Absent("not all are SOLVED")
    return share


def _first_solve(problem: str, cache: str = "", processes: int = 4) -> float:
    """Seconds of processor time of the first solve of a process, the median of some processes after the first one.

    The variable `cache` of the environment names an empty folder.
    """
    with tempfile.TemporaryDirectory() as folder:
        environment = {cache: folder} if cache else {}
        seconds = [printed(_FIRST_SOLVE.format(problem), **environment) for _ in range(processes)]
        return statistics.median(seconds[1:] or seconds)


_FIRST, _CHAIN = (f"first solve of a process, {it}" for it in ("quadrotor of 25 nodes", "ten masses, 63 states"))
_QUADROTOR, _MASSES, _XLA_CACHE = "quadrotor(25)", "chain_of_masses()", "JAX_COMPILATION_CACHE_DIR"
TIMES: Section = [
    slow("64 quadrotors of 20 nodes by solve_many", "a case over one alone", at_most(0.3), _at_once, _quadrotors),
    slow("1,024 double integrators by solve_many", "a case over one alone", at_most(0.3), _at_once, _integrators),
    slow(_FIRST, "processor time, kernels on the disk, s", at_most(3.0), _first_solve, _QUADROTOR),
    slow(_FIRST, "the same with JAX's cache on the disk, s", at_most(3.0), _first_solve, _QUADROTOR, _XLA_CACHE),
    slow(_CHAIN, "processor time, nothing on the disk, s", at_most(15.0), _first_solve, _MASSES, "TWISTAX_CACHE", 1),
    slow(_CHAIN, "processor time, kernels on the disk, s", at_most(15.0), _first_solve, _MASSES),
]
