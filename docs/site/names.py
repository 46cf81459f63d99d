"""The public names: what `__all__` of the package and its public modules lists, and on which page each stands.

A page of the reference asks for names by a fence,

    ```{names} twistax
    expr.leaves System
    ```

which stands for the names of that namespace whose defining module begins so, or that are called so; an empty fence for
all of them.
"""

from __future__ import annotations

import functools
import inspect
import re
from types import ModuleType
from typing import Any, NamedTuple

import twistax
from twistax.expr import Expr
from twistax.integrators import Method
from twistax.scalar.backends import Backend

#: Bases that one subclasses to extend twistax: docs/extending.md says how.
INSIDE = (Expr, Method, Backend)


FENCE = re.compile(r"```\{names\} (\S+)\n(.*?)```", re.DOTALL)


class Name(NamedTuple):
    """A public name: `twistax.lie.Adjoint`, what it is, and the module that defines it."""

    path: str
    value: Any

    @property
    def module(self) -> str:
        """Where it is defined; for a value, where its class is."""
        named = hasattr(self.value, "__name__")
        return str(getattr(self.value if named else type(self.value), "__module__", ""))

    @property
    def is_node(self) -> bool:
        """A node of the language."""
        return inspect.isclass(self.value) and issubclass(self.value, Expr)

    def members(self) -> list[str]:
        """The public methods and properties of a class that have docstrings, in order of their names.

        What a public base has stands there, and what serves the inside of nodes, methods and backends on no page.
        """
        if not inspect.isclass(self.value):
            return []
        return [name for name in dir(self.value) if not name.startswith("_") and self._tells(name)]

    def _tells(self, name: str) -> bool:
        if any(issubclass(self.value, base) and hasattr(base, name) for base in INSIDE if base is not self.value):
            return False
        owner = next(base for base in self.value.__mro__ if name in vars(base))
        if owner is not self.value and any(owner is other.value for other in public_names()):
            return False
        member = inspect.getattr_static(self.value, name)
        function = getattr(member, "fget", None) or getattr(member, "__func__", None) or member
        function = getattr(function, "func", function)  # a cached property
        # A function that was assigned, such as what a node computes, is no method.
        own = inspect.isfunction(function) and function.__qualname__ == f"{owner.__qualname__}.{name}"
        return own and bool(function.__doc__) and owner.__module__.startswith("twistax")


@functools.cache
def public_names() -> tuple[Name, ...]:
    """All of them, each once, by the shortest of its paths. A second name of one thing, such as rnea, is one too."""
    found: list[Name] = []
    seen: set[tuple[int, str]] = set()

    def walk(module: ModuleType) -> None:
        inner = []
        for name in module.__all__:
            value = getattr(module, name)
            if isinstance(value, ModuleType):
                inner.append((f"{path_of[module]}.{name}", value))
            elif (id(value), name) not in seen:
                seen.add((id(value), name))
                found.append(Name(f"{path_of[module]}.{name}", value))
        for path, value in inner:
            if value.__name__.startswith("twistax") and value not in path_of:
                path_of[value] = path
                walk(value)

    path_of = {twistax: "twistax"}
    walk(twistax)
    return tuple(found)


def asked(namespace: str, wanted: str) -> list[Name]:
    """The names of a fence, in alphabetical order."""
    beginnings = tuple(wanted.split())

    def matches(name: Name) -> bool:
        module = name.module.removeprefix("twistax").removeprefix(".")
        by_module = any(module == part or module.startswith(f"{part}.") for part in beginnings)
        return not beginnings or by_module or name.path.rpartition(".")[2] in beginnings

    own = [name for name in public_names() if name.path.rpartition(".")[0] == namespace]
    return sorted(filter(matches, own), key=lambda name: name.path.lower())
