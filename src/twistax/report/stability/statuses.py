"""Whether the status SOLVED is correct: rows with a vanishing gradient, coarse meshes, violations between nodes, warm
starts.
"""

import functools
from typing import Any

import numpy as np

import twistax as tx

from ...trajectory import Collocation, Mesh, Problem, Status, TrajectoryResult
from ..harness.expected import at_most, between
from ..harness.measurement import Section, quick, slow
from ..sections import problems
from ..sections.problems import problem_of

#: A cost that is said to be the least may be off by so much, relative.
_OFF = 1e-3


def _claimed(result: TrajectoryResult, least: float) -> float:
    """The relative distance of a cost from the least if the status is SOLVED, else 0."""
    return abs(result.cost / least - 1.0) if result.status is Status.SOLVED else 0.0


def _to_rest(nodes: int, by_place: bool = False) -> float:
    """Least time to a point at rest, 2 s, with the end stated by a square: the cost while SOLVED."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    final: Any = [(p - 1.0) ** 2 <= 0.0, v == 0.0] if by_place else [p == 1.0, v**2 <= 0.0]
    options: dict[str, Any] = {"nodes": nodes, "initial": {p: 0.0, v: 0.0}, "final": final}
    return _claimed(problem_of({p: v, v: u}, tx.Minimize(tx.Time()), final_time=(0.1, 6.0), **options).solve(), 2.0)


def _lagging(**options: Any) -> Problem:
    """A control behind a lag of 50 1/s, in 20 intervals of 0.1 s; the least cost is 0.36266."""
    x, z, u = tx.State("x"), tx.State("z"), tx.Control("u", min=-1.0, max=1.0)
    options |= {"nodes": 21, "final_time": 2.0, "initial": {x: 1.0, z: 0.0}}
    return problem_of({x: z, z: -50.0 * (z - u)}, tx.Minimize(running=x**2 + 0.01 * u**2), **options)


_LEAST = 0.36266
_RADAU = functools.partial(_lagging, transcription=Collocation(tx.tableaus.RADAU_IIA5, substeps=2))


@functools.cache
def _solved() -> tuple[Problem, TrajectoryResult]:
    problem = _RADAU()
    return problem, problem.solve()


def _behind_a_lag() -> float:
    """How far from the least cost, by a method for stiff rates; NaN unless SOLVED."""
    result = _solved()[1]
    return abs(result.cost / _LEAST - 1.0) if result.solved else float("nan")


def _warm() -> float:
    """Iterations of a solve that starts from its result."""
    problem, result = _solved()
    again = problem.solve(warm=result)
    return float(again.iterations) if abs(again.cost / result.cost - 1.0) <= 1e-12 else float("nan")


def _sensitive() -> float:
    """The hypersensitive problem on free nodes, which move where mesh errors lower the cost; the least is 1.330807."""
    problem = problems.hypersensitive(nodes=Mesh(20, free=True))
    return _claimed(problem.solve(), 1.330807)


def _chain(substeps: int) -> float:
    """A chain of eight links and motors from hanging to a zigzag in 1 s on 21 nodes; the least cost is 0.17097."""
    mechanics = tx.mechanics
    bar = mechanics.SpatialInertia(mass=1.0, center_of_mass=(0, 0, -0.1), inertia=np.diag([0.004, 0.004, 0.0005]))
    drive, links = mechanics.Drive(damping=0.05, armature=0.02), []
    for i in range(8):
        hinge = mechanics.joints.Revolute(f"j{i}", axis=[(0.0, 1.0, 0.0), (1.0, 0.0, 0.0)][i % 2])
        place = tx.pose(position=[0.0, 0.0, -0.2 if i else 0.0])
        links.append(mechanics.Link(hinge, bar, place, drive=drive))
    dynamics = tx.compile(mechanics.Chain(links, gravity=(0.0, 0.0, -9.81)).system())
    (u,) = dynamics.controls
    goal = np.where(np.arange(8) % 2 == 0, 0.3, -0.2)
    problem = Problem(
        dynamics,
        tx.Minimize(running=1e-3 * (u @ u)),
        nodes=21,
        substeps=substeps,
        final_time=1.0,
        initial={"q": np.zeros(8), "qd": np.zeros(8)},
        final={"q": goal, "qd": np.zeros(8)},
    )
    return _claimed(problem.solve(), 0.17097)


def _above() -> float:
    """The relative error of the violation between nodes that the result reports, against the top of its parabolas."""
    x, v, u = tx.State("x"), tx.State("v"), tx.Control("u")
    ends: dict[str, Any] = {"initial": {x: 0.0, v: 1.0}, "final": {x: 0.0, v: -1.0}}
    system = tx.System(rates={x: v, v: u}, constraints={"ceiling": x <= 1.0 / 9.0})
    result = Problem(tx.compile(system), tx.Minimize(running=0.5 * u**2), nodes=11, final_time=1.0, **ends).solve()
    starts = zip(result.xs["x"][:-1], result.xs["v"][:-1], result.us["u"])
    turns = [(x, v, u, np.clip(-v / u, 0.0, 0.1)) for x, v, u in starts]
    top = max(x + v * h + 0.5 * u * h**2 for x, v, u, h in turns) - 1.0 / 9.0
    accuracy = result.accuracy
    if accuracy is None or "'ceiling' by " not in result.message:
        return float("nan")
    return abs(accuracy.exceeded["ceiling"].by / top - 1.0)


STATUSES: Section = [
    "A square has no slope where it is zero: its multiplier grows without end, and every gradient is small beside it.",
    quick("rest as v^2 <= 0, 21 nodes: cost while SOLVED", "interior point", at_most(_OFF), _to_rest, 21),
    quick(
        "a place as (p - 1)^2 <= 0, 21 nodes: cost while SOLVED", "interior point", at_most(_OFF), _to_rest, 21, True
    ),
    "Intervals that are too long for a rate miss their ends; one that follows them closely says so.",
    quick(
        "a lag of 50 1/s, intervals of 0.1 s: cost while SOLVED",
        "RK4",
        at_most(_OFF),
        lambda: _claimed(_lagging().solve(), _LEAST),
    ),
    quick("the same: apart, and SOLVED", "Radau", at_most(1e-4), _behind_a_lag),
    "An optimiser that moves nodes moves them to where the error pays.",
    quick("hypersensitive, 20 free nodes: cost while SOLVED", "RK4", at_most(_OFF), _sensitive),
    "What a coarse mesh gains is three quarters of the cost here.",
    slow("a chain of 8 links, 21 nodes, 1 substep: cost while SOLVED", "RK4", at_most(_OFF), _chain, 1),
    "A limit is asked at nodes and substeps; what it is exceeded by between them is said.",
    quick("a ceiling between nodes: what is said, apart", "message", at_most(0.1), _above),
    "A solution is the answer where it is the start.",
    quick("a solve from its own result: iterations", "interior point", between(0.0, 0.0, "steps"), _warm),
]
