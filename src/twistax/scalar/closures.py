"""The traced values that a function closes over: collected, and replaced for a while."""

from __future__ import annotations

import contextlib
import functools
import threading
import types
from collections.abc import Callable, Iterator
from typing import Any

import jax

from ..jax_inside import is_traced

#: Variables of functions are changed for a while.
_LOCK = threading.RLock()


def closed_over(function: Callable[..., Any]) -> list[Any]:
    """The traced values in the variables of enclosing functions, in defaults, partial functions and owners of methods.

    Also those within pytrees, and within functions, that stand there. Attributes of other objects are not looked at.
    """
    traced: dict[int, Any] = {}
    with replaced(function, lambda value: traced.setdefault(id(value), value)):
        return list(traced.values())


@contextlib.contextmanager
def replaced(function: Callable[..., Any], by: Callable[[Any], Any]) -> Iterator[Callable[..., Any]]:
    """The function with `by(value)` in place of each traced value, within a context: for one thread at a time."""
    with _LOCK, contextlib.ExitStack() as after:
        yield _changed(function, by, set(), after)


def _changed(value: Any, by: Callable[[Any], Any], seen: set[int], after: contextlib.ExitStack) -> Any:
    """A value with traced values replaced; the value itself if there are none, and for functions, whose variables
    change.

    Args:
        seen: functions that were met: they may hold one another.
        after: what puts their variables back.
    """
    inner = functools.partial(_changed, by=by, seen=seen, after=after)
    if isinstance(value, types.FunctionType):
        if id(value) not in seen:
            seen.add(id(value))
            filled = [(cell, "cell_contents") for cell in value.__closure__ or () if hasattr(cell, "cell_contents")]
            for place, name in [(value, "__defaults__"), (value, "__kwdefaults__"), *filled]:
                old = getattr(place, name)
                new = inner(old)
                if new is not old:
                    after.callback(setattr, place, name, old)
                    setattr(place, name, new)
        return value
    if isinstance(value, types.MethodType):
        owner = inner(value.__self__)
        return value if owner is value.__self__ else types.MethodType(value.__func__, owner)
    if isinstance(value, functools.partial) and not isinstance(value, jax.tree_util.Partial):  # which is a pytree
        parts = (value.func, value.args, value.keywords)
        new = inner(parts)
        return value if new is parts else type(value)(new[0], *new[1], **new[2])
    leaves, structure = jax.tree.flatten(value)
    if leaves and leaves[0] is value:
        return by(value) if is_traced(value) else value
    changed = list(map(inner, leaves))
    same = all(a is b for a, b in zip(leaves, changed, strict=True))
    return value if same else jax.tree.unflatten(structure, changed)
