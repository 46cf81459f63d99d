"""What the package has of a kind, found by itself: no list of names can forget one."""

import importlib
import inspect
import pkgutil
from typing import TypeVar

import twistax

T = TypeVar("T")


def every_module() -> list[str]:
    """The modules of the package that a suite may import, all imported."""
    names = [found.name for found in pkgutil.walk_packages(twistax.__path__, "twistax.")]
    names = [name for name in names if not name.startswith(("twistax.__main__", "twistax.report", "twistax.demo"))]
    for name in names:
        importlib.import_module(name)
    return names


def concrete_classes(base: type[T]) -> list[type[T]]:
    """All classes of the package below a base, in the order of their names, but private ones and abstract ones."""
    every_module()
    waiting: list[type[T]] = [base]
    for cls in waiting:
        waiting += cls.__subclasses__()
    inside = {cls for cls in waiting if cls.__module__.startswith("twistax.") and not inspect.isabstract(cls)}
    # Reports have some for comparison, which are wrong on purpose.
    apart = ("twistax.report", "twistax.demo")
    inside = {cls for cls in inside if not cls.__name__.startswith("_") and not cls.__module__.startswith(apart)}
    return sorted(inside, key=lambda cls: (cls.__module__, cls.__qualname__))
