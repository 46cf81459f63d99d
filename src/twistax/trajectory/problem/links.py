"""Links between phases: the initial states of a phase as expressions of the end of the previous phase."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...checks import listed, short
from ...errors import ModelError, ShapeError
from ...expr import Expr, leaves_of, to_expr
from ...system import name_of
from ..transcription.joined import Join, Joined, drop_repeated_rows
from .stated_phase import StatedPhase
from .statement import check_leaves

#: State of the next phase -> its initial value as an expression of the last states; None for a free state.
Sources = dict[str, Expr | None]


def links_of(parts: Sequence[StatedPhase], names: Sequence[str], links: Any) -> list[Sources]:
    """The links of all phases but the first, checked.

    Raises:
        ModelError: not a list with one dict for each transition; unknown states.
        ShapeError: an expression whose shape is not that of its state.
    """
    count = len(parts) - 1
    if links is not None and (not isinstance(links, (list, tuple)) or len(links) != count):
        raise ModelError(
            f"links expects a list of length {count}, one entry for each transition between phases, got {short(links)}"
        )
    pairs = zip(parts, parts[1:], names[1:], links or [None] * count)
    return [_sources(f"links[{k}]", *pair) for k, pair in enumerate(pairs)]


def _sources(
    place: str, before: StatedPhase, after: StatedPhase, name_after: str, links: Mapping[Any, Any] | None
) -> Sources:
    if links is not None and not isinstance(links, Mapping):
        raise ModelError(f"{place} expects a dict from states to expressions, got {short(links)}")
    states, last = ({s.name: s for s in part.dynamics.states} for part in (after, before))
    sources: Sources = {}
    for name, state in states.items():
        same = name in last and last[name].key() == state.key()
        sources[name] = last[name] if same else None
    sources |= after.continuous.at_join
    for key, value in (links or {}).items():
        name = name_of(key)
        if name not in states:
            raise ModelError(f"{place} names {name!r}; the states of {name_after!r} are: {listed(states, name)}")
        sources[name] = None
        if value is not None:
            expr = to_expr(value)
            if expr.shape != states[name].shape:
                raise ShapeError(f"{place}[{name!r}] expects shape {states[name].shape}, got {expr.shape}")
            check_leaves(before.dynamics, f"{place}[{name!r}]", expr, controls=False)
            for leaf in leaves_of(expr):
                leaf.check_in_system()
            sources[name] = expr.canonicalize()
    return sources


def joined(parts: Sequence[StatedPhase], sources: Sequence[Sources], names: Sequence[str]) -> Joined:
    joins = []
    for before, after, source in zip(parts, parts[1:], sources):
        ends = after.ends
        joins.append(Join(before.shooting, after.shooting, source, ends.initial, ends.initial_fixed))
        last = {s.name: s for s in before.dynamics.states}
        same = {name for name, expr in source.items() if expr is last.get(name) and ends.initial[name] is None}
        drop_repeated_rows(before.shooting, after.shooting, same)
    return Joined([part.shooting for part in parts], joins, names)
