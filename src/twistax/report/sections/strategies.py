"""The benefit of each strategy around the interior-point method: published problems from several starts, with and
without it.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple

from ...trajectory import Strategy
from ..harness.expected import between
from ..harness.measurement import MeasuredCase, Section, slow
from .optimal import PROBLEMS

#: Starts of each problem: its guess, and that guess perturbed. The relative difference of costs of one optimum.
_SEEDS, _SAME = (None, 1, 2, 3), 1e-4

_USED: dict[str, tuple[Strategy, ...]] = {
    "all strategies": tuple(Strategy),
    **{f"without {it.name}": tuple(other for other in Strategy if other is not it) for it in Strategy},
    "none": (),
}


class _Count(NamedTuple):
    solved: int
    best: int  # SOLVED at the best optimum of its problem
    steps: int


@functools.cache
def _tries(used: Sequence[Strategy]) -> dict[tuple[str, int | None], tuple[bool, float, int]]:
    """Whether each problem is SOLVED from each start, at what cost, and in how many steps."""
    tries = {}
    for (name, it), seed in itertools.product(PROBLEMS.items(), _SEEDS):
        result = it.problem.solve(seed=seed, strategies=used)
        tries[name, seed] = result.solved, float(result.cost), result.iterations
    return tries


def _count(used: Sequence[Strategy]) -> _Count:
    tries, count = _tries(used), _Count(0, 0, 0)
    for (name, _), (solved, cost, steps) in tries.items():
        is_best = solved and abs(cost / PROBLEMS[name].result.cost - 1.0) <= _SAME
        count = _Count(count.solved + solved, count.best + is_best, count.steps + steps)
    return count


def _rows(name: str, used: tuple[Strategy, ...]) -> list[MeasuredCase]:
    total = len(PROBLEMS) * len(_SEEDS)
    return [
        slow(name, f"SOLVED, of {total}", between(), lambda: float(_count(used).solved)),
        slow(name, f"at the best optimum, of {total}", between(), lambda: float(_count(used).best)),
        slow(name, "steps in all", between(), lambda: float(_count(used).steps)),
    ]


STRATEGIES: Section = [check for name, used in _USED.items() for check in _rows(name, used)]
