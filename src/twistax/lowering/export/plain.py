"""Values without code in them: what a saved file may hold, and how it is written as JSON and arrays."""

from __future__ import annotations

import dataclasses
import importlib
import math
import re
import sys
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ...expr import Expr
from ...groups import ANGULAR_FIRST, LINEAR_FIRST, SE3, SO3, Group

__all__ = ["PlainReader", "PlainWriter", "class_of", "reference", "unknown_class"]

_PACKAGE = __name__.partition(".")[0]

#: Values of which there is one object.
_KNOWN: tuple[Any, ...] = (LINEAR_FIRST, ANGULAR_FIRST, SO3, SE3)


class PlainWriter:
    """Writes numbers, text, arrays, slices, tuples, lists, expressions, and frozen dataclasses of this package.

    Args:
        arrays: where arrays go; a value holds the place of its array.
        place: the place of an expression among those written.
    """

    def __init__(self, arrays: list[NDArray[Any]], place: Callable[[Expr], int]) -> None:
        self._arrays, self._place = arrays, place

    def write(self, value: Any, where: str) -> Any:
        """The value as JSON.

        Raises:
            ModelError: there is no plain form; names where it stands.
        """
        if value is None or isinstance(value, (bool, str)) or type(value) is int:
            return value
        if isinstance(value, float):
            return float(value) if math.isfinite(value) else {"float": repr(float(value))}
        if value is Ellipsis:
            return {"ellipsis": None}
        if isinstance(value, Expr):
            return {"node": self._place(value)}
        if isinstance(value, slice):
            return {"slice": [self.write(v, where) for v in (value.start, value.stop, value.step)]}
        if isinstance(value, (tuple, list)):
            return {type(value).__name__: [self.write(v, where) for v in value]}
        if isinstance(value, np.generic) and value.dtype.kind in "biu":
            return {"number": [value.dtype.str, int(value)]}
        if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            self._arrays.append(value)
            return {"array": len(self._arrays) - 1}
        if dataclasses.is_dataclass(value) and not isinstance(value, type) and _constructible(type(value)):
            fields = {f.name: self.write(getattr(value, f.name), where) for f in dataclasses.fields(value)}
            return {"value": [reference(type(value)), fields]}
        raise ModelError(
            f"{where} is {value!r}, which cannot be saved: files hold numbers, text, arrays and values of twistax, no "
            "code.\n  fix: a group or a value of your own must be a frozen dataclass of such"
        )


class PlainReader:
    """Reads what `PlainWriter` wrote.

    Args:
        arrays: those of the file.
        node: the expression at a place.
    """

    def __init__(self, arrays: list[NDArray[Any]], node: Callable[[int], Expr]) -> None:
        self._arrays, self._node = arrays, node

    def read(self, written: Any) -> Any:
        """The value.

        Raises:
            ModelError: a class that is not known here.
        """
        if not isinstance(written, dict):
            return written
        ((kind, content),) = written.items()
        return self._READERS[kind](self, content)

    def _value(self, content: Any) -> Any:
        named, fields = content
        cls = class_of(named)
        if cls is None or not _constructible(cls):
            raise ModelError(unknown_class(named))
        found = cls(**{name: self.read(value) for name, value in fields.items()})
        return next((known for known in _KNOWN if known == found), found)

    def _array(self, place: int) -> NDArray[Any]:
        return self._arrays[place]

    _READERS: ClassVar[dict[str, Callable[[Any, Any], Any]]] = {
        "float": lambda self, text: float(text),
        "ellipsis": lambda self, _: Ellipsis,
        "node": lambda self, place: self._node(place),
        "slice": lambda self, ends: slice(*map(self.read, ends)),
        "tuple": lambda self, values: tuple(map(self.read, values)),
        "list": lambda self, values: list(map(self.read, values)),
        "number": lambda self, pair: np.dtype(pair[0]).type(pair[1]),
        "array": _array,
        "value": _value,
    }


def reference(cls: type) -> str:
    """How a file names a class."""
    return f"{cls.__module__}:{cls.__qualname__}"


def class_of(named: str) -> type | None:
    """The class of that name: of this package, or defined by whoever runs. No other module is ever imported."""
    module, _, name = named.partition(":")
    if module not in sys.modules and re.fullmatch(rf"{_PACKAGE}(\.[A-Za-z]\w*)+", module):
        try:
            importlib.import_module(module)
        except ImportError:
            return None
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found if isinstance(found, type) and reference(found) == named else _node_class(named)


def _node_class(named: str) -> type | None:
    """A node class that is no attribute of its module: defined in a function."""
    waiting: list[type[Expr]] = [Expr]
    found = None
    while waiting:
        cls = waiting.pop()
        waiting += cls.__subclasses__()
        found = cls if reference(cls) == named else found
    return found


def _constructible(cls: type) -> bool:
    """Whether a file may make values of a class: frozen dataclasses of this package, and groups and backends."""
    from ..backends import Backend

    frozen = dataclasses.is_dataclass(cls) and cls.__dataclass_params__.frozen  # type: ignore[attr-defined]
    return frozen and (cls.__module__.partition(".")[0] == _PACKAGE or issubclass(cls, (Group, Backend)))


def unknown_class(named: str) -> str:
    """What to say of a class that is not known."""
    module, _, name = named.partition(":")
    return (
        f"the file has a {name} of the module {module!r}, which is not known here.\n"
        f"  fix: import what defines it before tx.load, in a version that has it"
    )
