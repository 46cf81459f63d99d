"""Tests of the status SOLVED: each problem is solved again in other units, with wider limits, from several starts and
with all states in one vector, on one mesh."""

from __future__ import annotations

import dataclasses
import functools
import gc
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

import twistax as tx

from ...expr import Control, State
from ...expr.graph import substitute
from ...system import name_of
from ...trajectory import Mesh, Status
from ...trajectory.problem.conditions import split
from ..harness.expected import at_most, between
from ..harness.measurement import Section, slow
from . import cops, flights, problems
from .curvature import is_saddle
from .packed import packed
from .problems import Known

#: How many of a new unit make an old one, by how much limits are wider, and starts of each.
SIZES, WIDTHS, STARTS = (1e-6, 1.0, 1e6), (1.0, 1e2, 1e4), 4
_STATED = float(len(SIZES) * len(WIDTHS) * STARTS)
#: And as many more with all states in one vector, whose entries have units of their own: one start in each unit.
_SOLVES = _STATED + len(SIZES)
#: Relative differences of costs of one optimum, and a tolerance that shows whether a solution is one.
_SAME, _CLOSER = 1e-4, 1e-9
#: Limits that bind nothing lie so many times as far as the optimum reaches.
_FAR = 2.0


@dataclasses.dataclass(frozen=True)
class InOtherUnits:
    """The same problem in other units, or with limits so wide that none is active.

    An old unit is `size` new ones for the first state, 1 / size for the next, and so on over states and controls; size
    for times, 1 / size for the objective. Limits of the final time are `width` times as far apart. Sides of states
    and controls that have no limit get one, `width` times as far as `reach` says, by name. Groups keep their units.
    """

    size: float
    width: float
    reach: Mapping[str, float]

    def __call__(self, problem: Any) -> Any:
        """The problem in the new units."""
        parts = [problem.stated] if problem.alone else [vars(phase) for phase in problem.phases]
        systems = [part["dynamics"].system for part in parts]
        leaves = {leaf.name: leaf for system in systems for leaf in (*system.states, *system.controls)}
        flat = lambda leaf: isinstance(leaf, Control) or leaf.group.flat  # noqa: E731
        sizes = dict(zip(leaves, itertools.cycle((self.size, 1.0 / self.size))))
        sizes |= {name: 1.0 for name, leaf in leaves.items() if not flat(leaf)}
        units = _Units(self, sizes, {name: self._leaf(e, sizes[name]) if flat(e) else e for name, e in leaves.items()})
        units.exchange.update((e.key(), units.old(name)) for name, e in leaves.items())
        if problem.alone:
            return tx.trajectory.Problem(**units.statement(parts[0]))
        links = [{units.leaves[name_of(k)]: units.new(k, v) for k, v in x.items()} for x in problem.stated["links"]]
        phases = [tx.trajectory.Phase(**units.statement(part)) for part in parts]
        return tx.trajectory.Problem(**problem.stated | {"dynamics": phases, "links": links})

    def _leaf(self, leaf: State | Control, size: float) -> Any:
        far = _FAR * self.width * self.reach[leaf.name]
        low, high = (self._limit(limit, side * far) * size for limit, side in ((leaf.min, -1.0), (leaf.max, 1.0)))
        options = {name: getattr(leaf, name) for name in ("guess", "scale")}
        options = {name: value * size for name, value in options.items() if value is not None}
        return type(leaf)(leaf.name, shape=leaf.shape, min=low, max=high, **options)

    @staticmethod
    def _limit(limit: Any, far: float) -> Any:
        return np.asarray(far if limit is None else np.where(np.isfinite(limit), limit, far))


@dataclasses.dataclass(frozen=True)
class _Units:
    """New leaves, and how many of their units make an old one, by name."""

    change: InOtherUnits
    sizes: Mapping[str, float]
    leaves: Mapping[str, Any]
    exchange: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        self.exchange[tx.Time().key()] = tx.Time() / self.change.size

    def old(self, name: str) -> Any:
        """What a leaf was, of the new one."""
        return self.leaves[name] if self.sizes[name] == 1.0 else self.leaves[name] / self.sizes[name]

    def new(self, leaf: Any, value: Any) -> Any:
        """What a value, or an expression, of a leaf is in new units."""
        size = self.sizes[name_of(leaf)]
        return size * (substitute(value, self.exchange) if isinstance(value, tx.Expr) else np.asarray(value))

    def statement(self, statement: Mapping[str, Any]) -> dict[str, Any]:
        """What a problem or a phase is stated with."""
        size, width = self.change.size, self.change.width
        system, objective, put = statement["dynamics"].system, statement["objective"], self._put
        rates = {self.leaves[s]: self.sizes[s] / size * put(rate) for s, rate in system.rates.items()}
        constraints: Any = {name: put(expr) for name, expr in system.constraints.items()}
        changed = dict(statement) | {"dynamics": tx.compile(tx.System(rates=rates, constraints=constraints))}
        if objective is not None:
            final, running = (
                None if part is None else put(part) / size**power
                for part, power in ((objective.final, 1), (objective.running, 2))
            )
            changed["objective"] = type(objective)(final, running=running)
        for end in ("initial", "final"):
            values, conditions = split(end, statement[end])
            changed[end] = [self._values(values), *map(put, conditions.values())]
        changed["guess"] = self._values(statement["guess"] or {})
        times = np.asarray(statement["final_time"]) * size
        changed["final_time"] = (times[0] / width, times[1] * width) if times.ndim else float(times)
        guess = statement["final_time_guess"]
        # Not the default, which does not move with the limits: their middle is a bad guess, and so a hard start.
        changed["final_time_guess"] = float(np.mean(changed["final_time"])) if guess is None else guess * size
        return changed

    def _put(self, expr: Any) -> Any:
        return substitute(expr, self.exchange)

    def _values(self, by_leaf: Mapping[Any, Any]) -> dict[Any, Any]:
        return {self.leaves[name_of(leaf)]: self.new(leaf, value) for leaf, value in by_leaf.items()}


@dataclasses.dataclass(frozen=True)
class Tried:
    """One solve: whether it was SOLVED, at which cost in the old unit, in how many steps; where that is not the cost
    plainly found, whether a closer solve stays there, and whether the objective falls to second order."""

    solved: bool
    cost: float
    iterations: int
    stays: bool = True
    is_saddle: bool = False


def _alike(cost: float, other: float) -> bool:
    return abs(cost / other - 1.0) <= _SAME


def _stays(result: Any) -> bool:
    """Whether a closer solve stays at a result, in the scales of that place alone.

    Rounding may be more than the tolerance asked for. ACCEPTABLE then says that the conditions hold within a hundred
    times of it, which is still ten times as close as the result.
    """
    closer = result.problem.solve(warm=result, tolerance=_CLOSER)
    return closer.status in (Status.SOLVED, Status.ACCEPTABLE) and _alike(closer.cost, result.cost)


class StartSweep:
    """All solves of one problem.

    Args:
        known: it, and its optimum.
        solved: how many are to be SOLVED.
    """

    def __init__(self, known: Known, solved: float = _SOLVES) -> None:
        self.known, self.solved = known, solved

    @property
    def tried(self) -> list[Tried]:
        """In all units, with all limits, from all starts. Raises what the sweep raised, which runs once."""
        if isinstance(self._came, Exception):
            raise self._came
        return self._came

    @functools.cached_property
    def _came(self) -> list[Tried] | Exception:
        try:
            return self._all()
        except Exception as failure:  # whatever comes is what was found
            return failure

    def _all(self) -> list[Tried]:
        plain, reach = self.known.result, dict[str, float]()
        if not plain.solved:
            raise RuntimeError(
                f"how far the optimum reaches is not known: plainly stated it ends in {plain.status.name}"
            )
        for trajectory in getattr(plain, "phases", [plain]):
            for name, values in (trajectory.xs | trajectory.us).items():
                reach[name] = max(reach.get(name, 0.0), float(np.abs(values).max()))
        # Those at its cost are what it is; where another is better it has to be a strict local optimum, too.
        if not _stays(plain) or is_saddle(plain):
            raise RuntimeError(
                f"plainly stated it ends at {plain.cost:.9g}, where a closer solve does not stay, or at a saddle"
            )
        changes = [InOtherUnits(*factors, reach) for factors in itertools.product(SIZES, WIDTHS)]
        trials = [trial for change in changes for trial in self._of(change, STARTS)]
        if self.known.problem.alone:
            trials += [trial for size in SIZES for trial in self._of(InOtherUnits(size, 1.0, reach), 1, packed)]
        return trials

    def _of(self, change: InOtherUnits, starts: int, form: Callable[[Any], Any] = lambda same: same) -> Iterator[Tried]:
        problem = form(change(self.known.problem))
        for start in range(starts):
            result = problem.solve(seed=start or None)
            trial = Tried(result.solved, result.cost * change.size, result.iterations)
            # At once, so that the problem can go: of a hundred compiled ones the memory maps of a process run out.
            if trial.solved and not _alike(trial.cost, self.known.result.cost):
                stays = _stays(result)
                trial = dataclasses.replace(trial, stays=stays, is_saddle=stays and is_saddle(result))
            yield trial
        del problem, result
        gc.collect()

    @functools.cached_property
    def best(self) -> float:
        """The cost of the best that was found."""
        costs = [trial.cost for trial in self.tried if trial.solved]
        sign = self.known.problem.sign
        return sign * min((sign * cost for cost in costs), default=math.nan)

    @functools.cached_property
    def elsewhere(self) -> list[Tried]:
        """SOLVED at other costs than the best one."""
        return [trial for trial in self.tried if trial.solved and not _alike(trial.cost, self.best)]

    @property
    def wrong(self) -> list[Tried]:
        """Those of them at no stationary point: a closer solve does not stay."""
        return [trial for trial in self.elsewhere if not trial.stays]

    @property
    def saddles(self) -> list[Tried]:
        """Those of the others where the objective falls to second order."""
        return [trial for trial in self.elsewhere if trial.is_saddle]

    def excess_of_best(self) -> float:
        """The best, relative to the known optimum."""
        return abs(self.best / self.known.optimum - 1.0)

    def spread(self) -> float:
        """The largest relative difference of those at the best."""
        same = [trial.cost for trial in self.tried if trial.solved and _alike(trial.cost, self.best)]
        return max((abs(cost / self.best - 1.0) for cost in same), default=math.nan)


_given = functools.partial
#: Equal intervals are unstable for explicit steps where it leaves 1.5.
_DENSE_AT_ENDS = Mesh(0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 41)))
_FAST = _given(problems.fastest, 1.0, (0.5, 6.0), 1.0)

SWEEPS = {
    "least time of a mass: 2 s, 21 nodes": StartSweep(Known(_FAST, 2.0, 1e-5)),
    "brachistochrone: 1.80160 s, 51 nodes": StartSweep(Known(problems.brachistochrone, 1.80160, 1e-3)),
    "Bryson-Denham: 4, 61 nodes": StartSweep(Known(problems.bryson_denham, 4.0, 5e-3)),
    "Goddard: 1.01284, 51 nodes": StartSweep(Known(problems.goddard, 1.01284, 1e-5)),
    "cart-pole of Kelly: 58.8077, 51 nodes": StartSweep(Known(problems.cart_pole, 58.8077, 1e-2)),
    "half turn of Bilimoria and Wie: 3.24307 s, 51 nodes": StartSweep(Known(problems.reorientation, 3.24307, 1e-3)),
    "rendezvous, norm as cost: 1.212619, 31 nodes": StartSweep(
        Known(_given(problems.rendezvous, "norm as cost"), 1.212619, 1e-5)
    ),
    "rendezvous, a slack: 1.212619, 31 nodes": StartSweep(
        Known(_given(problems.rendezvous, "norm below a slack"), 1.212619, 1e-5)
    ),
    "hypersensitive: 1.33, 41 nodes": StartSweep(
        Known(_given(problems.hypersensitive, nodes=_DENSE_AT_ENDS), 1.3308069, 5e-2)
    ),
    "landing of the demo: 27,260 kg, 25 nodes": StartSweep(Known(problems.landing, 27_260.0, 1e-4)),
    "Panda from shelf to shelf: 0.860227 s, 41 nodes": StartSweep(Known(flights.panda, 0.860227, 1e-5)),
    "robot arm of COPS: 9.14093 s, 51 nodes": StartSweep(Known(cops.robot_arm, 9.14093, 1e-3)),
    "particle steering of COPS, linear: 0.554571 s, 51 nodes": StartSweep(
        Known(cops.particle_steering, 0.554571, 2e-6)
    ),
    "catalyst mixing of COPS: 0.0480556, 101 nodes": StartSweep(Known(cops.catalyst_mixing, 0.0480556, 1e-5)),
    "Delta III in four phases, linear: 7,529.712 kg, 29 nodes": StartSweep(
        Known(flights.delta_iii, 7529.712, 1e-5), solved=_STATED
    ),
    # A way past spheres for each side of each: many optima, and not every start is SOLVED.
    "quadrotor past three spheres: 1.489138 s, 31 nodes": StartSweep(
        Known(flights.quadrotor, 1.489138, 1e-5, {"guesses": STARTS * 2}), solved=0.0
    ),
}

TRUST: Section = [
    slow(name, by, expected, measure, sweep)
    for name, sweep in SWEEPS.items()
    for by, expected, measure in (
        ("best, from the known", at_most(sweep.known.bar), StartSweep.excess_of_best),
        ("SOLVED", between(low=sweep.solved), lambda sweep: sum(trial.solved for trial in sweep.tried)),
        ("SOLVED at no stationary point", at_most(0), lambda sweep: len(sweep.wrong)),
        ("SOLVED at other stationary points", between(), lambda sweep: len(sweep.elsewhere) - len(sweep.wrong)),
        ("SOLVED at saddles", at_most(0), lambda sweep: len(sweep.saddles)),
        ("largest difference of the rest", at_most(_SAME), StartSweep.spread),
        ("most steps", between(), lambda sweep: max(trial.iterations for trial in sweep.tried)),
    )
]
