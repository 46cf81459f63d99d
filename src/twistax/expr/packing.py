"""Nodes as a flat table, so that pickle does not recurse into them."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ..scalar.walk import walk
from .operators import Operators

#: A key may count objects of this process; what looks up a table is made of its numbers.
_MADE_AGAIN = ("_key", "_lookup")


class _Place(int):
    """The place of a node in the table."""


def pack(value: Any) -> tuple[list[tuple[type[Any], dict[str, Any]]], Any]:
    """Nodes, or tuples, lists and dicts of them, as a table of nodes, operands first, which pickle reads without
    recursion.

    Raises:
        pickle.PicklingError: a node contains an object that cannot be pickled.
    """
    nodes = list(walk(_nodes_in(value), lambda node: list(_nodes_in(node.__dict__))))
    places = {id(node): _Place(k) for k, node in enumerate(nodes)}
    table = []
    for node in nodes:
        fields = {name: value for name, value in node.__dict__.items() if name not in _MADE_AGAIN}
        _check_pickles(node, fields)
        table.append((type(node), _exchanged(fields, lambda node: places[id(node)])))
    return table, _exchanged(value, lambda node: places[id(node)])


def unpack(table: list[tuple[type[Any], dict[str, Any]]], value: Any) -> Any:
    """The packed nodes."""
    nodes: list[Any] = []
    for cls, fields in table:
        node = object.__new__(cls)
        node.__dict__.update(_exchanged(fields, nodes.__getitem__))
        nodes.append(node)
    return _exchanged(value, nodes.__getitem__)


def _nodes_in(value: Any) -> Iterator[Any]:
    if isinstance(value, Operators):
        yield value
    elif type(value) in (tuple, list, dict):
        for entry in value.values() if type(value) is dict else value:
            yield from _nodes_in(entry)


def _exchanged(value: Any, other: Callable[[Any], Any]) -> Any:
    """The same with what stands for each node or place in it."""
    if isinstance(value, (_Place, Operators)):
        return other(value)
    if type(value) in (tuple, list):
        return type(value)(_exchanged(entry, other) for entry in value)
    return {name: _exchanged(entry, other) for name, entry in value.items()} if type(value) is dict else value


def _check_pickles(node: Any, fields: Mapping[str, Any]) -> None:
    """Raise PicklingError that names the node with something that pickle refuses; cloudpickle accepts more."""
    values = {"class": type(node)} | {name: value for name, value in fields.items() if callable(value)}
    for name, value in values.items():
        try:
            if not isinstance(value, Operators):
                pickle.dumps(value)
        except Exception as error:  # of whatever kind its class raises
            if "cloudpickle" not in sys.modules:
                raise pickle.PicklingError(
                    f"the node {node!r} cannot be pickled for its {name} {value!r}: {error}.\n"
                    "  fix: define it at the top level of a module that can be imported"
                ) from error
