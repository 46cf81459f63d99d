"""Problems of the page as OpenSCvx states and solves them, beside ours; both through our dense rollout."""

from __future__ import annotations

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

from ...integrators.ambient import Ambient
from ...system import name_of
from ...trajectory import Linear, Mesh, Problem
from ...trajectory.problem.conditions import split
from ...trajectory.result.result import Trajectory
from ..checks import Section, at_most, between, needed, slow
from . import flights, problems
from .problems import Known

#: What `openscvx.Problem` takes: nothing, or what makes its transcription ours. Weights come with the latter.
_DEFAULTS: Mapping[str, Any] = {}
_ALIKE: Mapping[str, Any] = {"float_dtype": "float64", "discretizer": {"dis_type": "ZOH"}, "uniform": True}
#: The longest that its program may take, s.
_LONGEST = 600.0


@dataclasses.dataclass(frozen=True)
class Found:
    """What one of them found, whether it says that this is a solution, in how many steps and s."""

    value: float
    claimed: bool
    trajectory: Trajectory
    iterations: int
    compile_seconds: float
    solve_seconds: float


@dataclasses.dataclass(frozen=True)
class Rival:
    """A problem that both state.

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
    def _came(self) -> list[Any] | Exception:
        """What came there of both settings, or what the program ended with."""
        weights = dict(zip(("lam_cost", "lam_vc"), self.weights, strict=True))
        asked = {"name": self.name, "nodes": self.nodes, "settings": [_DEFAULTS, {**_ALIKE, "algorithm": weights}]}
        command = [sys.executable, "-m", "twistax.report.rival", json.dumps(asked)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST, check=False)
        except subprocess.TimeoutExpired as late:
            return late
        return RuntimeError(done.stderr.strip().splitlines()[-1]) if done.returncode else list(json.loads(done.stdout))

    def _said(self, alike: bool) -> Mapping[str, Any]:
        needed("openscvx", "'twistax[openscvx]'")
        if isinstance(self._came, Exception):
            raise self._came
        return dict(self._came[alike])

    def ours(self) -> Found:
        """From the naive guess; timed once more, as there all is compiled, and run, by `initialize`."""
        it = self.known.plain
        again = self.known.problem.solve().solve_seconds
        return Found(it.cost, it.solved, it, it.iterations, it.compile_seconds, again)

    def theirs(self, alike: bool) -> Found:
        """The same there. Raises Absent where OpenSCvx is not installed, and what its program ended with."""
        said = self._said(alike)
        path = self.trajectory(said["nodes"], held=alike)
        return Found(said["value"], said["converged"], path, *(said[n] for n in ("iterations", "initialize", "solve")))

    def _numbers(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Our states as `Ambient` has them, of theirs; leading axis the points."""
        found = {}
        for state in self.known.problem.dynamics.system.states:
            parts = self.parts.get(state.name)
            own = np.concatenate([values[n] for n in parts or (state.name,)], axis=1)
            found[state.name] = own if parts else own.reshape(-1, *state.shape)
        return found

    def _controls(self, values: Mapping[str, Any]) -> dict[str, Any]:
        leaves = self.known.problem.dynamics.system.controls
        return {c.name: np.asarray(values[c.name]).reshape(-1, *c.shape) for c in leaves}

    def _states(self, values: Mapping[str, Any]) -> dict[str, Any]:
        read = Ambient(self.known.problem.dynamics).from_ambient
        return {n: np.asarray(a) for n, a in jax.jit(jax.vmap(read))(self._numbers(values)).items()}

    def trajectory(self, nodes: Mapping[str, Any], held: bool) -> Trajectory:
        """In our problem with these node times, of controls that are held or linear between nodes."""
        ts = np.ravel(nodes["time"]) - nodes["time"][0][0]  # its solver leaves 1e-12 there
        # Held controls are on equal intervals.
        problem = self.known.problem if held else self.make(nodes=Mesh(ts / ts[-1]), controls=Linear())
        us = {n: values[: -1 if held else None] for n, values in self._controls(nodes).items()}
        return Trajectory(problem.parts[0], self._states(nodes), us, ts, float(ts[-1]), {}, {} if held else us)

    def apart(self) -> float:
        """The largest difference of the two statements, relative where above 1; see `_pairs`."""
        pairs = ((np.asarray(a, float), np.asarray(b, float)) for a, b in self._pairs(self._said(True)["stated"]))
        return max(float(np.max(np.abs(a - b) / np.maximum(1.0, np.abs(b)), initial=0.0)) for a, b in pairs)

    def _pairs(self, said: Mapping[str, Any]) -> Iterator[tuple[Any, Any]]:
        """Theirs and ours: rates, running costs and path constraints at random points, fixed ends, limits of ours."""
        problem = self.known.problem
        stated, system = problem.stated, problem.dynamics.system
        plain, points = Ambient(problem.dynamics), self._numbers(said["points"])
        rows = [each.residual() for each in system.constraints.values()]
        rows += [cost for cost in (stated["objective"].running,) if cost is not None]

        def at(y: Any, u: Any) -> Any:
            told = tx.lower([*rows, *system.states, *system.controls])(0.0, plain.from_ambient(y), u)
            return plain.vector_field(0.0, y, (u, None)), told[: len(rows)]

        rates, told = jax.jit(jax.vmap(at))(points, self._controls(said["points"]))
        yield from ((own, rates[name]) for name, own in self._numbers(said["rates"]).items())
        there = [*said["constraints"], *(np.ravel(said["rates"][n]) for n in said["rates"] if n == "cost")]
        yield from zip(there, told, strict=True)
        for which, end in enumerate(("initial", "final")):
            ours = {name_of(key): value for key, value in split(end, stated[end])[0].items()}
            fixed = {name: own[which] for name, own in said["ends"].items() if name != "cost"}
            theirs = self._states({n: [[0.0 if v is None else v for v in own]] for n, own in fixed.items()})
            for name in theirs:
                free = any(v is None for part in self.parts.get(name, (name,)) for v in fixed[part])
                yield (math.inf, 0.0) if free is (name in ours) else (theirs[name][0], ours.get(name, theirs[name][0]))
        for leaf in itertools.chain(system.controls, () if self.parts else system.states):
            for limit, own in zip((leaf.min, leaf.max), said["limits"][leaf.name], strict=True):
                if limit is not None:
                    yield np.reshape(own, leaf.shape), limit
        yield np.max(said["time"]), np.max(stated["final_time"])


_of = functools.partial
_SPIN = {"R": ("q",)}
_POSE = {"g": ("q", "p"), "V": ("v", "w")}

RIVALS = {
    "least time of a mass: 2 s, 21 nodes": Rival(
        "fastest", _of(problems.fastest, 1.0, (0.5, 6.0), 1.0), 21, 2.0, (10.0, 100.0)
    ),
    "brachistochrone: 1.80160 s, 51 nodes": Rival(
        "brachistochrone", problems.brachistochrone, 51, 1.80160, (10.0, 100.0)
    ),
    "Bryson-Denham: 4, 61 nodes": Rival("bryson_denham", problems.bryson_denham, 61, 4.0, (0.1, 1.0)),
    "Goddard: 1.01284, 51 nodes": Rival("goddard", problems.goddard, 51, 1.01284, (10.0, 100.0)),
    "cart-pole of Kelly: 58.8077, 51 nodes": Rival("cart_pole", problems.cart_pole, 51, 58.8077, (0.1, 1.0)),
    "rendezvous of least fuel: 1.212619, 31 nodes": Rival(
        "rendezvous", _of(problems.rendezvous, "norm below a slack"), 31, 1.212619, (10.0, 100.0)
    ),
    "half turn of Bilimoria and Wie: 3.24307 s, 51 nodes": Rival(
        "reorientation", problems.reorientation, 51, 3.24307, (10.0, 100.0), _SPIN
    ),
    "quadrotor past three spheres: 1.489138 s, 31 nodes": Rival(
        "quadrotor", flights.quadrotor, 31, 1.489138, (10.0, 100.0), _POSE
    ),
}


def _missed(found: Found) -> float:
    return max(miss for own in found.trajectory.dense.misses.values() for miss in own.values())


def _rows(name: str, it: Rival) -> Iterator[Any]:
    whos: dict[str, Callable[[], Found]] = {
        "twistax": functools.cache(it.ours),
        "OpenSCvx as it comes": functools.cache(_of(it.theirs, alike=False)),
        "OpenSCvx, held controls and weights of its own": functools.cache(_of(it.theirs, alike=True)),
    }
    measures: dict[str, Callable[[Found], float]] = {
        "apart": lambda found: abs(found.value / it.optimum - 1.0),
        "says that it is solved": lambda found: float(found.claimed),
        "a rollout misses the end by": _missed,
        "beyond limits between nodes": lambda found: max(found.trajectory.between_nodes.values(), default=0.0),
        "steps": lambda found: float(found.iterations),
        "compile, s": lambda found: found.compile_seconds,
        "solve, ms": lambda found: 1e3 * found.solve_seconds,
    }
    yield slow(f"{name}, both", "statements differ by", at_most(1e-10), it.apart)
    for who, found in whos.items():
        for by, measure in measures.items():
            yield slow(f"{name}, {who}", by, between(), lambda found=found, measure=measure: measure(found()))


OPENSCVX: Section = [row for name, it in RIVALS.items() for row in _rows(name, it)]
