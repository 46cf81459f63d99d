"""Problems as OpenSCvx states and solves them, and the same problems in this package; both solutions are integrated by
our dense rollout.
"""

import dataclasses
import functools
import itertools
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import numpy as np

import twistax as tx

from ...integrators.ambient import AmbientSystem
from ...system import name_of
from ...trajectory import Linear, Mesh, Problem
from ...trajectory.problem.conditions import split
from ...trajectory.result.result import Trajectory
from ..harness.expected import at_most, between, needed
from ..harness.measurement import Section, slow, table
from . import flights, problems
from .problems import Known

#: What `openscvx.Problem` takes: nothing, or what makes its transcription ours. Weights come with the latter.
_DEFAULTS: Mapping[str, Any] = {}
_SAME_TRANSCRIPTION: Mapping[str, Any] = {"float_dtype": "float64", "discretizer": {"dis_type": "ZOH"}, "uniform": True}
#: The longest that its program may take, s.
_LONGEST = 600.0


@dataclasses.dataclass(frozen=True)
class PeerSolve:
    """A solve by one of both: its objective, whether it claims success, its path, steps and seconds."""

    value: float
    says_solved: bool
    trajectory: Trajectory
    iterations: int
    compile_seconds: float
    solve_seconds: float


@dataclasses.dataclass(frozen=True)
class PeerProblem:
    """A problem that both packages state.

    Args:
        name: of the function of `rival`, which states it there.
        make: states it here, of `nodes` and `controls`.
        weights: `lam_cost` and `lam_vc` there that served best of seven pairs from (0.1, 1) to (100, 1000).
        parts: state -> those that make it there, where names differ.
    """

    name: str
    make: Callable[..., Problem]
    nodes: int
    optimum: float
    weights: tuple[float, float]
    parts: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def known(self) -> Known:
        """Ours, with held controls on equal intervals."""
        return Known(functools.partial(self.make, nodes=self.nodes), self.optimum)

    @functools.cached_property
    def _answers(self) -> list[Any] | Exception:
        """The results of OpenSCvx for both settings, or the error that its program ended with."""
        weights = dict(zip(("lam_cost", "lam_vc"), self.weights, strict=True))
        settings = [_DEFAULTS, {**_SAME_TRANSCRIPTION, "algorithm": weights}]
        request = {"name": self.name, "nodes": self.nodes, "settings": settings}
        command = [sys.executable, "-m", "twistax.report.openscvx_problems", json.dumps(request)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST, check=False)
        except subprocess.TimeoutExpired as late:
            return late
        return RuntimeError(done.stderr.strip().splitlines()[-1]) if done.returncode else list(json.loads(done.stdout))

    def _answer(self, same_transcription: bool) -> Mapping[str, Any]:
        needed("openscvx", "'twistax[openscvx]'")
        if isinstance(self._answers, Exception):
            raise self._answers
        return dict(self._answers[same_transcription])

    def ours(self) -> PeerSolve:
        """Our solve from the naive guess; a second one is timed, as `initialize` of OpenSCvx compiles and runs all."""
        it = self.known.plain
        again = self.known.problem.solve().solve_seconds
        return PeerSolve(it.cost, it.solved, it, it.iterations, it.compile_seconds, again)

    def theirs(self, same_transcription: bool) -> PeerSolve:
        """The solve of OpenSCvx. Raises Absent where it is not installed, and the error that its program ended with."""
        answer = self._answer(same_transcription)
        path = self.trajectory(answer["nodes"], zero_order_hold=same_transcription)
        seconds = (answer[name] for name in ("iterations", "initialize", "solve"))
        return PeerSolve(answer["value"], answer["converged"], path, *seconds)

    def _numbers(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """OpenSCvx's states as our states in `AmbientSystem` numbers; the leading axis is points."""
        arrays = {}
        for state in self.known.problem.dynamics.system.states:
            parts = self.parts.get(state.name)
            array = np.concatenate([values[n] for n in parts or (state.name,)], axis=1)
            arrays[state.name] = array if parts else array.reshape(-1, *state.shape)
        return arrays

    def _controls(self, values: Mapping[str, Any]) -> dict[str, Any]:
        leaves = self.known.problem.dynamics.system.controls
        return {c.name: np.asarray(values[c.name]).reshape(-1, *c.shape) for c in leaves}

    def _states(self, values: Mapping[str, Any]) -> dict[str, Any]:
        read = AmbientSystem(self.known.problem.dynamics).from_ambient
        return {n: np.asarray(a) for n, a in jax.jit(jax.vmap(read))(self._numbers(values)).items()}

    def trajectory(self, nodes: Mapping[str, Any], zero_order_hold: bool) -> Trajectory:
        """A trajectory of our problem with these node times, its controls held or linear between nodes."""
        ts = np.ravel(nodes["time"]) - nodes["time"][0][0]  # its solver leaves 1e-12 there
        # Held controls are on equal intervals.
        problem = self.known.problem if zero_order_hold else self.make(nodes=Mesh(ts / ts[-1]), controls=Linear())
        us = {n: values[: -1 if zero_order_hold else None] for n, values in self._controls(nodes).items()}
        return Trajectory(
            problem.parts[0], self._states(nodes), us, ts, float(ts[-1]), {}, {} if zero_order_hold else us
        )

    def difference(self) -> float:
        """The largest difference of the two statements, relative where above 1; see `_pairs`."""
        pairs = ((np.asarray(a, float), np.asarray(b, float)) for a, b in self._pairs(self._answer(True)["stated"]))
        return max(float(np.max(np.abs(a - b) / np.maximum(1.0, np.abs(b)), initial=0.0)) for a, b in pairs)

    def _pairs(self, statement: Mapping[str, Any]) -> Iterator[tuple[Any, Any]]:
        """Theirs and ours: rates, running costs and path constraints at random points, fixed ends, limits of ours."""
        problem = self.known.problem
        problem_statement, system = problem.stated, problem.dynamics.system
        plain, points = AmbientSystem(problem.dynamics), self._numbers(statement["points"])
        rows = [constraint.residual() for constraint in system.constraints.values()]
        rows += [cost for cost in (problem_statement["objective"].running,) if cost is not None]

        def at(y: Any, u: Any) -> Any:
            values = tx.lower([*rows, *system.states, *system.controls])(0.0, plain.from_ambient(y), u)
            return plain.vector_field(0.0, y, (u, None)), values[: len(rows)]

        rates, values = jax.jit(jax.vmap(at))(points, self._controls(statement["points"]))
        yield from ((theirs, rates[name]) for name, theirs in self._numbers(statement["rates"]).items())
        costs = (np.ravel(statement["rates"][n]) for n in statement["rates"] if n == "cost")
        yield from zip([*statement["constraints"], *costs], values, strict=True)
        for which, end in enumerate(("initial", "final")):
            ours = {name_of(key): value for key, value in split(end, problem_statement[end])[0].items()}
            fixed = {name: both[which] for name, both in statement["ends"].items() if name != "cost"}
            theirs = self._states({n: [[0.0 if v is None else v for v in row]] for n, row in fixed.items()})
            for name in theirs:
                free = any(v is None for part in self.parts.get(name, (name,)) for v in fixed[part])
                yield (math.inf, 0.0) if free is (name in ours) else (theirs[name][0], ours.get(name, theirs[name][0]))
        for leaf in itertools.chain(system.controls, () if self.parts else system.states):
            for limit, theirs in zip((leaf.min, leaf.max), statement["limits"][leaf.name], strict=True):
                if limit is not None:
                    yield np.reshape(theirs, leaf.shape), limit
        yield np.max(statement["time"]), np.max(problem_statement["final_time"])


_of = functools.partial
_SPIN = {"R": ("q",)}
_POSE = {"g": ("q", "p"), "V": ("v", "w")}

PROBLEMS = {
    "least time of a mass: 2 s, 21 nodes": PeerProblem(
        "fastest", _of(problems.fastest, 1.0, (0.5, 6.0), 1.0), 21, 2.0, (10.0, 100.0)
    ),
    "brachistochrone: 1.80160 s, 51 nodes": PeerProblem(
        "brachistochrone", problems.brachistochrone, 51, 1.80160, (10.0, 100.0)
    ),
    "Bryson-Denham: 4, 61 nodes": PeerProblem("bryson_denham", problems.bryson_denham, 61, 4.0, (0.1, 1.0)),
    "Goddard: 1.01284, 51 nodes": PeerProblem("goddard", problems.goddard, 51, 1.01284, (10.0, 100.0)),
    "cart-pole of Kelly: 58.8077, 51 nodes": PeerProblem("cart_pole", problems.cart_pole, 51, 58.8077, (0.1, 1.0)),
    "rendezvous of least fuel: 1.212619, 31 nodes": PeerProblem(
        "rendezvous", _of(problems.rendezvous, "norm below a slack"), 31, 1.212619, (10.0, 100.0)
    ),
    "half turn of Bilimoria and Wie: 3.24307 s, 51 nodes": PeerProblem(
        "reorientation", problems.reorientation, 51, 3.24307, (10.0, 100.0), _SPIN
    ),
    "quadrotor past three spheres: 1.489138 s, 31 nodes": PeerProblem(
        "quadrotor", flights.quadrotor, 31, 1.489138, (10.0, 100.0), _POSE
    ),
}


def _missed(solve: PeerSolve) -> float:
    return max(miss for of_state in solve.trajectory.dense.misses.values() for miss in of_state.values())


def _rows(name: str, it: PeerProblem) -> Section:
    solves: dict[str, Callable[[], PeerSolve]] = {
        f"{name}, twistax": functools.cache(it.ours),
        f"{name}, OpenSCvx as it comes": functools.cache(_of(it.theirs, same_transcription=False)),
        f"{name}, OpenSCvx, held controls and weights of its own": functools.cache(
            _of(it.theirs, same_transcription=True)
        ),
    }
    columns: dict[str, Callable[[PeerSolve], float]] = {
        "apart": lambda solve: abs(solve.value / it.optimum - 1.0),
        "says that it is solved": lambda solve: float(solve.says_solved),
        "a rollout misses the end by": _missed,
        "beyond limits between nodes": lambda solve: max(solve.trajectory.between_nodes.values(), default=0.0),
        "steps": lambda solve: float(solve.iterations),
        "compile, s": lambda solve: solve.compile_seconds,
        "solve, ms": lambda solve: 1e3 * solve.solve_seconds,
    }
    measured = lambda column: lambda solve: column(solve())  # noqa: E731
    both = slow(f"{name}, both", "statements differ by", at_most(1e-10), it.difference)
    return [both, *table(solves, {by: (between(), measured(column)) for by, column in columns.items()})]


OPENSCVX: Section = [row for name, it in PROBLEMS.items() for row in _rows(name, it)]
