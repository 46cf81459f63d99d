"""The one way through a graph: every node once, what stands below first, without recursion; and time to build one."""

from __future__ import annotations

import contextlib
import gc
import threading
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
        elif (key := name(node)) not in seen:
            seen.add(key)
            stack.append((node, True))
            stack.extend((other, False) for other in reversed(below(node)))


_LOCK = threading.Lock()
#: The number of threads and nested calls that have paused the garbage collector; whether it ran before the first.
_state = {"within": 0, "was_on": False}


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Python does not look for garbage in cycles meanwhile, in any thread; afterwards all is as it was.

    Large graphs are millions of objects that stay. The search looks through all of them again and again, an eighth of
    the time of compiling a humanoid, and finds next to nothing. What is in no cycle is freed as always.
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
