"""Names and units of the entries of states and controls, for plots and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from ..checks import listed, short
from ..errors import ModelError
from ..expr import Expr, Leaf, State, postorder
from ..groups import Order

#: Of a leaf: a pair of name and unit for each entry, row by row.
Labels: TypeAlias = Mapping[Any, Iterable[Sequence[str]]]


def checked_labels(labels: Labels | None, leaves: Iterable[Leaf]) -> dict[str, tuple[tuple[str, str], ...]]:
    """The labels by name of a leaf. Raises ModelError for unknown names, or pairs of another number or type."""
    if labels is not None and not isinstance(labels, Mapping):
        raise ModelError(f"labels must be a dict from states and controls to pairs, got {type(labels).__name__}")
    known = {leaf.name: leaf for leaf in leaves}
    checked = dict[str, tuple[tuple[str, str], ...]]()
    for key, pairs in (labels or {}).items():
        name = key.name if isinstance(key, Leaf) else key
        if name not in known:
            raise ModelError(f"labels names {name!r}; it expects one of {listed(known, str(name))}")
        entries = (
            tuple(tuple(pair) if isinstance(pair, Sequence) else () for pair in pairs)
            if isinstance(pairs, Iterable)
            else ()
        )
        size = math.prod(known[name].shape)
        if len(entries) != size or not all(len(e) == 2 and all(isinstance(part, str) for part in e) for e in entries):
            raise ModelError(
                f"labels[{name!r}] expects a pair of name and unit for each entry, {size} of them, got {short(pairs)}"
            )
        checked[name] = tuple((label, unit) for label, unit in entries)
    return checked


def declared_labels(system: Any) -> dict[str, tuple[tuple[str, str], ...]]:
    """Labels of the states and controls that declare a unit, or the kind of a six-vector, and have no labels."""
    linear = linear_places(system.states, system.rates.values())
    labels = dict[str, tuple[tuple[str, str], ...]]()
    for leaf in (*system.states, *system.controls):
        flat = not isinstance(leaf, State) or leaf.group.flat
        if leaf.name in system.labels or leaf.unit is None or not flat:
            continue
        units = [leaf.unit.text or str(leaf.unit)] * math.prod(leaf.shape)
        if leaf.kind is not None and leaf.kind.space is not None:
            if linear is None or leaf.kind.halves is None or leaf.unit != type(leaf.kind).unit:
                continue
            units = [leaf.kind.halves[k % 6 not in linear] for k in range(len(units))]
        places = [", ".join(map(str, place)) for place in np.ndindex(*leaf.shape)] if leaf.shape else [""]
        names = [f"{leaf.name}[{place}]" if place else leaf.name for place in places]
        labels[leaf.name] = tuple(zip(names, units, strict=True))
    return labels


def linear_places(states: Iterable[State], roots: Iterable[Expr]) -> range | None:
    """Which entries of six-vectors are linear; None where nothing says in which order they are."""
    orders = [state.order for state in states] + [getattr(node, "order", None) for node in postorder(*roots)]
    for order in orders:
        if isinstance(order, Order):
            return range(3) if order.linear_leads else range(3, 6)
    return None
