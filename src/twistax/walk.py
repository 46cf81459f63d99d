"""The one way through a graph: every node once, what stands below it first, without recursion."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import TypeVar

N = TypeVar("N")


def walk(roots: Iterable[N], below: Callable[[N], Sequence[N]], name: Callable[[N], Hashable] = id) -> Iterator[N]:
    """Every node below the roots once, after all that stand below it.

    Args:
        below: what must come before a node; asked once, when the node is met.
        name: equal for nodes that count as one.
    """
    seen: set[Hashable] = set()
    stack = [(root, False) for root in reversed(list(roots))]
    while stack:
        node, ready = stack.pop()
        if ready:
            yield node
        elif (own := name(node)) not in seen:
            seen.add(own)
            stack.append((node, True))
            stack.extend((other, False) for other in reversed(below(node)))
