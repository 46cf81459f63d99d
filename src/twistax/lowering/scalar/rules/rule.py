"""What a rule is, and helpers that rules share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np

from ..graph import Graph, Nodes

__all__ = ["Rule", "each", "nodes"]

#: rule(graph, equation, *arrays of nodes) -> the arrays of the results, or None where it does not apply.
Rule: TypeAlias = Callable[..., "list[Nodes] | None"]


def nodes(flat: Iterable[int], shape: Iterable[int]) -> Nodes:
    """An array of nodes."""
    return np.array(list(flat), np.int64).reshape(tuple(shape))


def each(g: Graph, function: Callable[..., int], *arrays: Nodes) -> Nodes:
    """A function of nodes on arrays, entry by entry."""
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    flat: list[list[Any]] = [
        (a if a.shape == shape else np.broadcast_to(a, shape)).reshape(-1).tolist() for a in arrays
    ]
    return nodes(map(function, *flat), shape)
