"""Solves of a problem with complementarity constraints, with relaxations that decrease to the value of their parameter.

Source: S. Scholtes, Convergence properties of a regularization scheme for mathematical programs with complementarity
constraints, SIAM Journal on Optimization 11 (2001), equation (1).
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...checks import number
from ...errors import ModelError
from ...expr import Parameter, leaves_of
from ...expr.operations.comparisons import Complementarity
from ...jax_inside import in_double
from ...system import entry_names, name_of
from ..strategy.status import AT_OPTIMUM, Status
from ..strategy.strategies import Strategy
from ..transcription.point_values import PointValues

#: The ratio of the first relaxation to a typical product, of each relaxation to the previous one, and the largest ratio
#: after failures. The hop of `tests/trajectory/test_complementarity.py` takes 171 iterations in this sequence.
_FIRST, _LOWER, _LEAST = 0.01, 0.3, 0.8
#: The ratio of the first relaxation of a guess to that of the guess before it, and the number of first relaxations. Of
#: six guesses of the hop of the tests on 21 nodes, none to two find the better contact sequence with the largest first
#: relaxation and all with the smallest one; of a push with 31 nodes the largest one finds the best.
_NEXT, _FIRSTS = 0.1, 4
#: The maximal number of iterations of a warm start; a successful one takes few.
_MOST = 150
#: After these statuses a smaller relaxation is tried.
_GOING_ON = (*AT_OPTIMUM, Status.STALLED, Status.MAX_ITERATIONS, Status.INFEASIBLE)
#: After these statuses no other guess is tried.
_ENDED = (Status.OUT_OF_TIME, Status.STOPPED)
#: Attributes of a result that are sums over all solves.
_TOTALS = ("iterations", "compile_seconds", "solve_seconds")
#: Searches leave saddle points at relaxations above this fraction of a typical product, and at the last one; in
#: between, every search returns to the saddle.
_OPEN = 1e-4
#: The ratio of the relaxation of gaps to the tolerance. Final values at rest on the ground leave the gap of the node
#: before no interior. With a hundredth, as in IPOPT, the hop of the tests takes a tenth of the iterations.
_INTERIOR = 1e-2


def relaxations(problem: Any) -> dict[str, Any]:
    """The name of each entry of a complementarity constraint, with the expression of its relaxation."""
    rows = dict[str, Any]()
    for segment, part in zip(problem.shooting.segments, problem.parts):
        for name, constraint in part.dynamics.system.constraints.items():
            if isinstance(constraint, Complementarity):
                entries = entry_names(name, constraint.residual().check_shape())
                rows |= {problem.shooting.named(segment, entry): constraint.rhs for entry in entries}
    return rows


def products(result: Any) -> dict[str, float]:
    """The largest value of each entry of a complementarity constraint."""
    shooting, left = result.problem.shooting, dict[str, float]()
    names = np.where(shooting.exists, shooting.names.astype(str), "")
    for name, limit in relaxations(result.problem).items():
        known = {leaf.name: result.params[leaf.name] for leaf in leaves_of(limit) if isinstance(leaf, Parameter)}
        most = float(np.max(PointValues.of([limit])(np.zeros(1), {}, {}, known)))
        left[name] = most - float(result.slacks[names == name].min(initial=np.inf)) + result.violations[name]
    return {name: value for name, value in left.items() if np.isfinite(value)}


def lowered(problem: Any, options: Any, solve: Callable[[Any], Any]) -> Any:
    """The result with the final relaxations, after solves with larger ones; the best one of all guesses.

    With large relaxations all guesses lead to the same point. So each guess has relaxations down to the last one, and
    each starts with a smaller relaxation than the guess before it.

    Args:
        solve: solves with other options.
    """
    begin = time.perf_counter()
    if not isinstance(options.params or {}, Mapping):
        return solve(options)  # the error names the expected values
    changed = {name_of(key): value for key, value in (options.params or {}).items()}
    last = _last(problem, changed)
    if not last:
        return solve(options)
    results: list[Any] = []
    while len(results) < options.guesses and all(result.status not in _ENDED for result in results):
        number = len(results)
        seed = options.seed if number == 0 else (options.seed or 0) + number
        one = dataclasses.replace(options, guesses=1, seed=seed, max_seconds=_left(options, begin))
        first = _FIRST * _NEXT ** (number % _FIRSTS)
        results.append(_from_one_guess(problem, one, solve, changed, last, first))
    best = min(results, key=lambda result: (result.status not in AT_OPTIMUM, problem.sign * result.cost))
    totals = {name: sum(getattr(result, name) for result in results) for name in _TOTALS}
    return dataclasses.replace(best, tries=tuple(itertools.chain(*(result.tries for result in results))), **totals)


def _left(options: Any, begin: float) -> float | None:
    """The seconds that are left of a solve."""
    return None if options.max_seconds is None else max(options.max_seconds - (time.perf_counter() - begin), 1e-3)


def _from_one_guess(
    problem: Any,
    options: Any,
    solve: Callable[[Any], Any],
    changed: dict[str, Any],
    last: dict[str, float],
    first: float,
) -> Any:
    """The result with the final relaxations, from one guess.

    Args:
        changed, last: the parameters of the solve, and those that are relaxations.
        first: the ratio of the first relaxation to a typical product.
    """
    begin = time.perf_counter()
    size = _typical(problem, options)
    every: list[Any] = []

    def at(value: float, start: Any) -> Any:
        """The result with this relaxation, from the guess or from the result with a larger relaxation."""
        is_last = value <= min(last.values())
        other: dict[str, Any] = {"params": changed | {name: max(value, least) for name, least in last.items()}}
        if not is_last:
            other |= {"refine": None, "between": None, "mesh_tolerance": np.inf}
        other["max_seconds"] = _left(options, begin)
        if start is not None:
            useful = [Strategy.IMPLICIT_STEPS, *[Strategy.LEAVING_SADDLES] * (is_last or value > _OPEN * size)]
            other |= dict.fromkeys(("guess", "final_time_guess", "seed")) | {"guesses": 1, "warm": start}
            other["strategies"] = tuple(it for it in options.strategies if it in useful)
            other["max_iterations"] = min(options.max_iterations, _MOST)
        every.append(solve(dataclasses.replace(options, **other)))
        return every[-1]

    value, ratio = first * size, _LOWER
    best = result = at(value, None)
    if result.status is Status.INFEASIBLE and result.iterations <= 1:  # by the fixed initial and final values alone
        return result
    while result.status in _GOING_ON and value > min(last.values()) and ratio < _LEAST:
        following = value * ratio
        result = at(following, best)
        if result.status not in AT_OPTIMUM:
            result = at(following, None)  # from the guess, for another contact sequence
        if result.status in AT_OPTIMUM:
            best, value = result, following
        else:
            ratio = ratio**0.5
    return dataclasses.replace(
        result,
        message=f"{result.message} {_remark(len(every), result, best, size)}{_impacts(problem)}",
        **{name: sum(getattr(solved, name) for solved in every) for name in _TOTALS},
    )


def with_interior(problem: Any, core: Any, point: Any, instance: Any) -> Any:
    """The data of a problem whose gaps may be negative by a hundredth of the tolerance times their typical changes."""
    contacts = [name.rpartition(": ")[0] for name in relaxations(problem) if name.endswith(": complementarity")]
    is_gap = np.isin(problem.shooting.names.astype(str), [f"{name}: gap" for name in contacts])
    if not is_gap.any():
        return instance
    sizes = core.measure.row_sizes(core.units(point, instance, is_guess=True))
    return instance.with_margins(np.where(is_gap, -_INTERIOR * core.tolerance * sizes, 0.0))


def _last(problem: Any, changed: Mapping[str, Any]) -> dict[str, float]:
    """The values of the parameters that are relaxations. Raises ModelError for one that is not positive."""
    leaves = {leaf.name for limit in relaxations(problem).values() for leaf in leaves_of(limit)}
    free = {box.name for box in problem.border.boxes}
    values = problem.values(changed)
    last = {name: float(values[name]) for name in sorted(leaves - free) if name in values}
    for name, value in last.items():
        number(f"solve: relaxation {name!r}", value, "a positive number", lambda e: 0.0 < e < np.inf, ModelError)
    return last


def _typical(problem: Any, options: Any) -> float:
    """A bound of the change of the products under moves of all unknowns by their units."""
    with in_double():
        plain, instance, *_ = problem.started(**options.arguments)
        core = problem.core(options.needed, plain, instance)
        sizes = core.measure.row_sizes(core.units(plain, instance, is_guess=True))
    return float(sizes[np.isin(problem.shooting.names.astype(str), list(relaxations(problem)))].max())


def _impacts(problem: Any) -> str:
    if all(part.transcription.scheme.at_end for part in problem.parts):
        return ""
    return " With this transcription impacts are not inelastic; with Collocation(tx.tableaus.RADAU_IIA1) they are."


def _remark(count: int, result: Any, best: Any, size: float) -> str:
    if best is not result:
        return f"It is the last of {count} solves with smaller and smaller relaxations of complementarity."
    largest = max(result.complementarity.values(), default=0.0)
    return (
        f"The last of {count} relaxations of complementarity: the largest product that is left is {largest:.2g}, where "
        f"a typical one is {size:.2g}."
    )
