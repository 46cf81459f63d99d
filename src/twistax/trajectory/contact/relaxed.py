"""Solves of a problem with complementarity constraints, whose relaxation goes to the value of its parameter.

Source: S. Scholtes, Convergence properties of a regularization scheme for mathematical programs with complementarity
constraints, SIAM Journal on Optimization 11 (2001), equation (1).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...expr import Parameter, leaves_of
from ...expr.operations.complementarity import Complementarity
from ...jax_inside import in_double
from ...system import entry_names, name_of
from ..strategy.status import AT_OPTIMUM
from ..strategy.strategies import Strategy
from ..transcription.point_values import PointValues

#: The first relaxation over a typical product, each over the one before, and the largest ratio after failures. On a
#: hopper the sequence takes 121 iterations; from a tenth, tenfold each, 1,190.
_FIRST, _LOWER, _LEAST = 0.01, 0.3, 0.8
#: The most iterations of a warm solve, which takes few where it does not fail.
_MOST = 150
#: Saddles are left at relaxations above this share of a typical product, and at the last one: between these every
#: search comes back.
_OPEN = 1e-4


def relaxations(problem: Any) -> dict[str, Any]:
    """The name of each entry of a complementarity constraint, with its relaxation, an expression."""
    rows = dict[str, Any]()
    for segment, part in zip(problem.shooting.segments, problem.parts):
        for name, constraint in part.dynamics.system.constraints.items():
            if isinstance(constraint, Complementarity):
                entries = entry_names(name, constraint.residual().check_shape())
                rows |= {problem.shooting.named(segment, entry): constraint.rhs for entry in entries}
    return rows


def products(result: Any) -> dict[str, float]:
    """The largest value of each entry of a complementarity constraint."""
    names, left = result.problem.shooting.names.astype(str), dict[str, float]()
    for name, limit in relaxations(result.problem).items():
        known = {leaf.name: result.params[leaf.name] for leaf in leaves_of(limit) if isinstance(leaf, Parameter)}
        most = float(np.max(PointValues.of([limit])(np.zeros(1), {}, {}, known)))
        left[name] = most - float(result.slacks[names == name].min()) + result.violations[name]
    return left


def lowered(problem: Any, options: Any, solve: Callable[[Any], Any]) -> Any:
    """The result with the last relaxations, after solves with larger ones.

    Args:
        solve: solves with other options.
    """
    begin = time.perf_counter()
    changed = {name_of(key): value for key, value in (options.params or {}).items()}
    last = _last(problem, changed)
    if not last:
        return solve(options)
    size = _typical(problem, options)
    ratio, value, solved = _LOWER, _FIRST * size, list[Any]()
    best = None
    while True:
        params = changed | {name: max(value, least) for name, least in last.items()}
        is_last = value <= min(last.values())
        other = {} if best is None else options.again(warm=best)
        if best is not None:
            leaving = (Strategy.LEAVING_SADDLES,) if is_last or value > _OPEN * size else ()
            kept = tuple(it for it in options.strategies if it in leaving)
            other |= {"max_iterations": min(options.max_iterations, _MOST), "strategies": kept}
        if options.max_seconds is not None:
            other["max_seconds"] = max(options.max_seconds - (time.perf_counter() - begin), 1e-3)
        if not is_last:
            other |= {"refine": None, "between": None, "mesh_tolerance": np.inf}
        else:
            other |= {"refine": options.refine, "between": options.between}
        result = solve(dataclasses.replace(options, **{**other, "params": params}))
        solved.append(result)
        if result.status in AT_OPTIMUM:
            best, reached = result, value
            if is_last:
                break
        elif best is None or ratio > _LEAST:
            break
        else:
            ratio = ratio**0.5
        value = reached * ratio
    return dataclasses.replace(
        solved[-1],
        message=f"{solved[-1].message} {_remark(solved, best, size)}",
        iterations=sum(result.iterations for result in solved),
        compile_seconds=sum(result.compile_seconds for result in solved),
        solve_seconds=sum(result.solve_seconds for result in solved),
    )


def _last(problem: Any, changed: Mapping[str, Any]) -> dict[str, float]:
    """The values of the parameters that are relaxations."""
    leaves = {leaf.name for limit in relaxations(problem).values() for leaf in leaves_of(limit)}
    free = {box.name for box in problem.border.boxes}
    values = problem.values(changed)
    return {name: float(values[name]) for name in sorted(leaves - free) if name in values}


def _typical(problem: Any, options: Any) -> float:
    """By how much a move of all unknowns by their units changes the products at most."""
    with in_double():
        plain, instance, *_ = problem.started(**options.arguments)
        core = problem.core(options.needed, plain, instance)
        sizes = core.measure.row_sizes(core.units(plain, instance, is_guess=True))
    return float(sizes[np.isin(problem.shooting.names.astype(str), list(relaxations(problem)))].max())


def _remark(solved: list[Any], best: Any, size: float) -> str:
    count = f"{len(solved)} relaxations of complementarity"
    if best is not solved[-1]:
        return f"It is the last of {count}; smaller ones were not reached."
    largest = max(solved[-1].complementarity.values(), default=0.0)
    return f"{count}: the largest product that is left is {largest:.2g}, where a typical one is {size:.2g}."
