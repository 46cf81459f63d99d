"""Traversal of a graph, operands first and without recursion; and a context without garbage collection."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import TypeVar

N = TypeVar("N")


def walk(roots: Iterable[N], below: Callable[[N], Sequence[N]], name: Callable[[N], Hashable] = id) -> Iterator[N]:
    """The roots and every node below them once, in postorder.

    Args:
        below: the operands of a node; called once for each.
        name: a key, equal for nodes that count as one.
    """
    seen: set[Hashable] = set()
    stack = [(root, False) for root in reversed(list(roots))]
    while stack:
        node, ready = stack.pop()
        if ready:
            yield node
        elif (key := name(node)) not in seen:
            seen.add(key)
            stack.append((node, True))
            stack.extend((other, False) for other in reversed(below(node)))


_LOCK = threading.Lock()
#: The number of threads and nested calls that have paused the garbage collector; whether it ran before the first.
_state = {"within": 0, "was_on": False}


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Pause the collector of cyclic garbage in all threads; restore it afterwards.

    Large graphs are millions of objects that stay alive. The collector visits all of them again and again, an eighth
    of the time to compile a humanoid, and frees next to nothing. Objects in no cycle are freed as always.
    """
    with _LOCK:
        if _state["within"] == 0:
            _state["was_on"] = gc.isenabled()
            gc.disable()
        _state["within"] += 1
    try:
        yield
    finally:
        with _LOCK:
            _state["within"] -= 1
            if _state["within"] == 0 and _state["was_on"]:
                gc.enable()
