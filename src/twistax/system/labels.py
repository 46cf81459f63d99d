"""Names and units of the entries of states and controls, for plots and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from ..checks import listed, short
from ..errors import ModelError
from ..expr import Leaf

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
