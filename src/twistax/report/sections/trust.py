"""Whether SOLVED can be trusted: problems in other units, with wider limits, from several starts, on one mesh each."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

import twistax as tx

from ...expr import Control, State
from ...expr.graph import substitute
from ...groups import Euclidean
from ...trajectory import TrajectoryResult
from ..checks import Section, at_most, between, slow
from . import problems
from .problems import Known, Statement

#: How many of a new unit make an old one, by how much limits are wider, and starts of each.
SIZES, WIDTHS, STARTS = (1e-6, 1.0, 1e6), (1.0, 1e2, 1e4), 4
_SOLVES = float(len(SIZES) * len(WIDTHS) * STARTS)
#: Relative differences of costs of one optimum, and a tolerance that shows whether a solution is one.
_SAME, _CLOSER = 1e-4, 1e-9
#: Limits that bind nothing lie so many times as far as the optimum reaches.
_FAR = 2.0


@dataclasses.dataclass(frozen=True)
class Restated:
    """Gives a problem in other units, and with limits that bind nothing.

    An old unit is `size` new ones for the first state, 1 / size for the next, and so on over states and controls; size
    for times, 1 / size for the objective. Limits of the final time are `width` times as far apart. Sides of states
    and controls that have no limit get one, `width` times as far as `reach` says, by name.
    """

    size: float
    width: float
    reach: Mapping[str, float]

    def __call__(self, stated: Statement) -> Statement:
        """The same problem."""
        system, options = stated.system, dict(stated.options)
        leaves: list[State | Control] = [*system.states, *system.controls]
        sizes = dict(zip((leaf.name for leaf in leaves), itertools.cycle((self.size, 1.0 / self.size))))
        sizes |= {s.name: 1.0 for s in system.states if not isinstance(s.group, Euclidean)}
        fresh = {leaf.name: self._leaf(leaf, sizes[leaf.name]) for leaf in leaves}
        exchange = {leaf.key(): fresh[leaf.name] / sizes[leaf.name] for leaf in leaves if sizes[leaf.name] != 1.0}
        exchange |= {leaf.key(): fresh[leaf.name] for leaf in leaves if sizes[leaf.name] == 1.0}
        exchange[tx.Time().key()] = tx.Time() / self.size
        new = functools.partial(substitute, exchange=exchange)
        rates = {fresh[name]: sizes[name] / self.size * new(rate) for name, rate in system.rates.items()}
        final, running = stated.objective.final, stated.objective.running
        objective = type(stated.objective)(
            None if final is None else new(final) / self.size,
            running=None if running is None else new(running) / self.size**2,
        )
        for end in ("initial", "final"):
            options[end] = {fresh[s.name]: sizes[s.name] * np.asarray(value) for s, value in options[end].items()}
        times = np.asarray(options["final_time"]) * self.size
        options["final_time"] = (times[0] / self.width, times[1] * self.width) if times.ndim else float(times)
        if "final_time_guess" in options:
            options["final_time_guess"] *= self.size
        constraints: Any = {name: new(each) for name, each in system.constraints.items()}
        return Statement(tx.System(rates=rates, constraints=constraints), objective, options)

    def _leaf(self, leaf: State | Control, size: float) -> Any:
        if isinstance(leaf, State) and not isinstance(leaf.group, Euclidean):
            return leaf
        far = _FAR * self.width * self.reach[leaf.name]
        low, high = (self._limit(limit, side * far) * size for limit, side in ((leaf.min, -1.0), (leaf.max, 1.0)))
        return type(leaf)(leaf.name, shape=leaf.shape, min=low, max=high)

    @staticmethod
    def _limit(limit: Any, far: float) -> Any:
        return np.asarray(far if limit is None else np.where(np.isfinite(limit), limit, far))


@dataclasses.dataclass(frozen=True)
class Tried:
    """One solve: whether it was SOLVED, at which cost in the old unit, in how many steps, whether that cost stays."""

    solved: bool
    cost: float
    iterations: int
    stays: Callable[[], bool]


class Sweep:
    """All solves of one problem.

    Args:
        known: it, and its optimum.
        others: how many solves may end at other stationary points: optima, or saddles, which a closer solve keeps, too.
    """

    def __init__(self, known: Known, others: int = 0) -> None:
        self.known, self.others = known, others

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
        plain = self.known.plain
        if not plain.solved:
            raise RuntimeError(
                f"how far the optimum reaches is not known: plainly stated it ends in {plain.status.name}"
            )
        reach = {name: float(np.abs(values).max()) for name, values in (plain.xs | plain.us).items()}
        return [each for own in itertools.product(SIZES, WIDTHS) for each in self._of(Restated(*own, reach))]

    def _of(self, restated: Restated) -> Iterator[Tried]:
        problem = self.known.make(restated=restated)

        def stays(result: TrajectoryResult) -> bool:
            closer = problem.solve(warm=result, tolerance=_CLOSER)
            return closer.solved and abs(closer.cost / result.cost - 1.0) <= _SAME

        for start in range(STARTS):
            result = problem.solve(seed=start or None)
            yield Tried(result.solved, result.cost * restated.size, result.iterations, functools.partial(stays, result))

    @functools.cached_property
    def best(self) -> float:
        """The cost of the best that was found."""
        costs = [each.cost for each in self.tried if each.solved]
        sign = self.known.problem.sign
        return sign * min((sign * cost for cost in costs), default=math.nan)

    @functools.cached_property
    def elsewhere(self) -> list[Tried]:
        """SOLVED at other costs than the best one."""
        return [each for each in self.tried if each.solved and not abs(each.cost / self.best - 1.0) <= _SAME]

    @functools.cached_property
    def wrong(self) -> list[Tried]:
        """Those of them at no stationary point: a closer solve does not stay."""
        return [each for each in self.elsewhere if not each.stays()]

    def apart(self) -> float:
        """The best, relative to the known optimum."""
        return abs(self.best / self.known.optimum - 1.0)

    def spread(self) -> float:
        """The largest relative difference of those at the best."""
        same = [each.cost for each in self.tried if each.solved and each not in self.elsewhere]
        return max((abs(cost / self.best - 1.0) for cost in same), default=math.nan)


_of = functools.partial
_FAST = _of(problems.fastest, 1.0, (0.5, 6.0), 1.0)

SWEEPS = {
    "least time of a mass: 2 s, 21 nodes": Sweep(Known(_FAST, 2.0, 1e-5)),
    "brachistochrone: 1.80160 s, 51 nodes": Sweep(Known(problems.brachistochrone, 1.80160, 1e-3), others=16),
    "Bryson-Denham: 4, 61 nodes": Sweep(Known(problems.bryson_denham, 4.0, 5e-3)),
    "Goddard: 1.01284, 51 nodes": Sweep(Known(problems.goddard, 1.01284, 1e-5)),
    "cart-pole of Kelly: 58.8077, 51 nodes": Sweep(Known(problems.cart_pole, 58.8077, 1e-2), others=11),
    "half turn of Bilimoria and Wie: 3.24307 s, 51 nodes": Sweep(Known(problems.reorientation, 3.24307, 1e-3)),
    "rendezvous, norm as cost: 1.212619, 31 nodes": Sweep(
        Known(_of(problems.rendezvous, "norm as cost"), 1.212619, 1e-5)
    ),
    "rendezvous, a slack: 1.212619, 31 nodes": Sweep(
        Known(_of(problems.rendezvous, "norm below a slack"), 1.212619, 1e-5)
    ),
    "hypersensitive: 1.33, 41 nodes": Sweep(Known(problems.hypersensitive, 1.3308069, 5e-2)),
}

TRUST: Section = [
    slow(name, by, expected, measure, sweep)
    for name, sweep in SWEEPS.items()
    for by, expected, measure in (
        ("best, from the known", at_most(sweep.known.bar), Sweep.apart),
        ("SOLVED", between(low=_SOLVES), lambda own: sum(each.solved for each in own.tried)),
        ("SOLVED at no stationary point", at_most(0), lambda own: len(own.wrong)),
        ("SOLVED at other stationary points", at_most(sweep.others), lambda own: len(own.elsewhere) - len(own.wrong)),
        ("largest difference of the rest", at_most(_SAME), Sweep.spread),
        ("most steps", between(), lambda own: max(each.iterations for each in own.tried)),
    )
]
