"""A problem with all its states in one vector, whose entries then have units of their own."""

from __future__ import annotations

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
    stated: dict[str, Any] = dict(problem.stated)
    system = stated["dynamics"].system
    flat = [s for s in system.states if s.group.flat]
    ends = np.cumsum([0, *(int(np.prod(s.shape)) for s in flat)])
    parts = dict(zip((s.name for s in flat), map(slice, ends[:-1].tolist(), ends[1:].tolist())))
    low, high, scale = (
        np.concatenate([np.broadcast_to(_given(getattr(s, side), absent), s.shape).ravel() for s in flat])
        for side, absent in (("min", -np.inf), ("max", np.inf), ("scale", np.nan))
    )
    x = tx.State("x", shape=(int(ends[-1]),), min=low, max=high, scale=None if np.isnan(scale).any() else scale)
    exchange = {s.key(): x[parts[s.name]] if s.shape else x[parts[s.name].start] for s in flat}
    put = lambda e: substitute(e, exchange)  # noqa: E731

    def whole(values: dict[str, Any]) -> dict[Any, Any]:
        """End values by leaf, those of the vector together, NaN where an entry is free."""
        found = np.full(x.shape, np.nan)
        for name, part in parts.items():
            found[part] = np.ravel(np.broadcast_to(values.pop(name, np.nan), (part.stop - part.start,)))
        return {"x": found} | values

    rates: dict[Any, Any] = {s: put(system.rates[s.name]) for s in system.states if s.name not in parts}
    rates[x] = tx.Concat(*(put(system.rates[s.name]) for s in flat))
    constraints: Any = {name: put(each) for name, each in system.constraints.items()}
    stated["dynamics"] = tx.compile(tx.System(rates=rates, constraints=constraints))
    objective = stated["objective"]
    final, running = (None if e is None else put(e) for e in (objective.final, objective.running))
    stated["objective"] = type(objective)(final, running=running)
    for end in ("initial", "final"):
        values, asked = split(end, stated[end])
        stated[end] = [whole({name_of(key): value for key, value in values.items()}), *map(put, asked.values())]
    with in_double():
        xs = problem.started()[0].xs
    guess = {name_of(key): value for key, value in (stated["guess"] or {}).items()}
    own = np.concatenate([np.asarray(xs[name]).reshape(problem.nodes, -1) for name in parts], axis=1)
    stated["guess"] = {name: value for name, value in guess.items() if name not in parts} | {"x": own}
    return Problem(**stated)


def _given(value: Any, absent: float) -> Any:
    return absent if value is None else value
