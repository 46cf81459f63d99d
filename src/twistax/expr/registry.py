"""All node classes, found by walking the subclasses of `Expr`."""

from __future__ import annotations

from .node import Expr


def all_nodes() -> list[type[Expr]]:
    """Every node class of this package, sorted by module and name. Bases marked `abstract` are left out."""
    found: list[type[Expr]] = []
    waiting: list[type[Expr]] = [Expr]
    package = __name__.split(".")[0]
    while waiting:
        cls = waiting.pop()
        waiting.extend(cls.__subclasses__())
        if not cls.abstract and cls.__module__.split(".")[0] == package:
            found.append(cls)
    return sorted(set(found), key=lambda cls: (cls.__module__, cls.__qualname__))
