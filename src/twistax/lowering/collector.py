"""Python's search for garbage in cycles, left out while a program is made.

A program is millions of objects that stay. The search looks through all of them again and again, an eighth of the time
of compiling a humanoid, and finds next to nothing.
"""

import contextlib
import gc
import threading
from collections.abc import Iterator

_LOCK = threading.Lock()
#: How many threads and calls around one another want no search, and whether there was one before the first.
_state = {"within": 0, "was_on": False}


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """No search meanwhile, in any thread. What is in no cycle is freed as always; afterwards all is as it was."""
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
