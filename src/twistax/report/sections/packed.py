"""A problem with all its states in one vector, whose entries have different units."""

from typing import Any

import numpy as np

import twistax as tx

from ...expr.graph import substitute
from ...jax_inside import in_double
from ...system import name_of
from ...trajectory import Problem
from ...trajectory.problem.conditions import split


def packed(problem: Problem) -> Problem:
    """The same problem, of one phase and without conditions at inner nodes; states of groups stay as they are."""
    statement: dict[str, Any] = dict(problem.stated)
    system = statement["dynamics"].system
    flat = [s for s in system.states if s.group.flat]
    ends = np.cumsum([0, *(int(np.prod(s.shape)) for s in flat)])
    parts = dict(zip((s.name for s in flat), map(slice, ends[:-1].tolist(), ends[1:].tolist())))
    low, high, scale = (
        np.concatenate([np.broadcast_to(_or(getattr(s, side), absent), s.shape).ravel() for s in flat])
        for side, absent in (("min", -np.inf), ("max", np.inf), ("scale", np.nan))
    )
    x = tx.State("x", shape=(int(ends[-1]),), min=low, max=high, scale=None if np.isnan(scale).any() else scale)
    exchange = {s.key(): x[parts[s.name]] if s.shape else x[parts[s.name].start] for s in flat}
    put = lambda e: substitute(e, exchange)  # noqa: E731

    def joined(values: dict[str, Any]) -> dict[Any, Any]:
        """End values by leaf, those of the vector together, NaN where an entry is free."""
        vector = np.full(x.shape, np.nan)
        for name, part in parts.items():
            vector[part] = np.ravel(np.broadcast_to(values.pop(name, np.nan), (part.stop - part.start,)))
        return {"x": vector} | values

    rates: dict[Any, Any] = {s: put(system.rates[s.name]) for s in system.states if s.name not in parts}
    rates[x] = tx.Concat(*(put(system.rates[s.name]) for s in flat))
    constraints: Any = {name: put(constraint) for name, constraint in system.constraints.items()}
    statement["dynamics"] = tx.compile(tx.System(rates=rates, constraints=constraints))
    objective = statement["objective"]
    final, running = (None if e is None else put(e) for e in (objective.final, objective.running))
    statement["objective"] = type(objective)(final, running=running)
    for end in ("initial", "final"):
        values, conditions = split(end, statement[end])
        statement[end] = [
            joined({name_of(key): value for key, value in values.items()}),
            *map(put, conditions.values()),
        ]
    with in_double():
        xs = problem.started()[0].xs
    guess = {name_of(key): value for key, value in (statement["guess"] or {}).items()}
    path = np.concatenate([np.asarray(xs[name]).reshape(problem.nodes, -1) for name in parts], axis=1)
    statement["guess"] = {name: value for name, value in guess.items() if name not in parts} | {"x": path}
    return Problem(**statement)


def _or(value: Any, absent: float) -> Any:
    return absent if value is None else value
