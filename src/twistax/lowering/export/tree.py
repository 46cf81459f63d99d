"""Expressions as a list of nodes, arguments first: class by name, fields as plain values, shared parts once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ...expr import Constant, Expr, Leaf
from .plain import PlainReader, PlainWriter, class_of, reference, unknown_class

__all__ = ["read_nodes", "read_only", "write_nodes"]

_SHAPE, _ORIGIN = "_shape", "_folded_from"


def write_nodes(roots: Iterable[Expr], arrays: list[NDArray[Any]]) -> tuple[list[Any], dict[int, int]]:
    """The nodes below the roots as JSON, and the place of each by its id.

    Raises:
        ModelError: a field that has no plain form.
    """
    places: dict[int, int] = {}
    written: list[Any] = []
    writer = PlainWriter(arrays, lambda node: places[id(node)])
    for node in _in_order(roots):
        name = type(node).__name__
        fields = {key: writer.write(value, f"{name}.{key}") for key, value in _fields(node).items()}
        places[id(node)] = len(written)
        written.append([reference(type(node)), fields])
    return written, places


def read_nodes(written: Sequence[Any], arrays: list[NDArray[Any]]) -> list[Expr]:
    """The nodes again.

    Raises:
        ModelError: a class that is not known here, or has other fields than it had.
    """
    nodes: list[Expr] = []
    reader = PlainReader(arrays, lambda place: nodes[place])
    for named, fields in written:
        cls = class_of(named)
        if cls is None or not issubclass(cls, Expr):
            raise ModelError(unknown_class(named))
        node = object.__new__(cls)
        values = {name: reader.read(value) for name, value in fields.items()}
        declared = {field.name for field in cls._fields}
        if declared != {name for name in values if name not in (_SHAPE, _ORIGIN)}:
            raise ModelError(
                f"{cls.__name__} has the fields {sorted(declared)}, in the file {sorted(values)}.\n"
                "  fix: load it with the version that saved it"
            )
        node.__dict__.update(values)
        node.validate()
        node._seal()
        nodes.append(node)
    return nodes


def _fields(node: Expr) -> dict[str, Any]:
    """What makes a node, by name."""
    fields = {field.name: getattr(node, field.name) for field in node._fields}
    if isinstance(node, Leaf):
        fields[_SHAPE] = node.shape
    if isinstance(node, Constant) and node.folded_from is not None:
        fields[_ORIGIN] = node.folded_from
    return fields


def _in_order(roots: Iterable[Expr]) -> list[Expr]:
    """Every node once, those in its fields before it; without recursion, for trees of any depth."""
    done: dict[int, Expr] = {}
    stack = [(root, False) for root in roots][::-1]
    while stack:
        node, ready = stack.pop()
        if ready:
            done.setdefault(id(node), node)
        elif id(node) not in done:
            stack.append((node, True))
            inner = [part for value in _fields(node).values() for part in _expressions(value)]
            stack += [(part, False) for part in reversed(inner) if id(part) not in done]
    return list(done.values())


def _expressions(value: Any) -> list[Expr]:
    if isinstance(value, Expr):
        return [value]
    if isinstance(value, (tuple, list)):
        return [part for entry in value for part in _expressions(entry)]
    return []


def read_only(arrays: Iterable[NDArray[Any]]) -> list[NDArray[Any]]:
    """Arrays that nobody may write to, as the leaves hold them."""
    found = [np.asarray(a) for a in arrays]
    for array in found:
        array.setflags(write=False)
    return found
