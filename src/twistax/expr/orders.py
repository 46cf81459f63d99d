"""Which order the 6-vectors of a system have, [v; w] or [w; v], and an error where two orders meet.

Orders flow through the graph: a Lie node fixes the order of its six-dimensional operands and result; sums, products and
solves hand it on; a state shares it with its rate. Values that must agree form one class; a class with two orders is a
mistake somewhere, and both places are named.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..errors import OrderError
from ..groups import Order
from .leaves import Constant, State
from .node import Expr, find_path, postorder

_SIX = ((6,), (6, 6))


class _Classes:
    """Union-find over structural keys; a class remembers its order and the first node that fixed it."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._fixed: dict[str, tuple[Order, str]] = {}

    def _find(self, key: str) -> str:
        while self._parent.setdefault(key, key) != key:
            self._parent[key] = self._parent[self._parent[key]]
            key = self._parent[key]
        return key

    def fix(self, key: str, order: Order, place: str) -> None:
        root = self._find(key)
        other, where = self._fixed.setdefault(root, (order, place))
        if other != order:
            raise _conflict(other, where, order, place)

    def link(self, keys: Iterable[str]) -> None:
        roots = [self._find(key) for key in keys]
        for root in roots[1:]:
            first = self._find(roots[0])
            root = self._find(root)
            if root == first:
                continue
            mine, theirs = self._fixed.get(first), self._fixed.get(root)
            if mine and theirs and mine[0] != theirs[0]:
                raise _conflict(*mine, *theirs)
            self._parent[root] = first
            if theirs and not mine:
                self._fixed[first] = theirs


def _conflict(order: Order, place: str, other: Order, other_place: str) -> OrderError:
    return OrderError(
        f"two twist orders meet: {order!r} and {other!r}.\n  at: {place}\n  and: {other_place}\n"
        "  fix: give both places the same order=, or put a tx.lie.Reorder between them"
    )


def check_orders(roots: Mapping[str, Expr], rates: Mapping[State, Expr]) -> None:
    """Raise OrderError if a [v; w] value meets a [w; v] value.

    Args:
        roots: every expression of a system, by the name used in messages.
        rates: the rate of every state: a pose's rate has the order of its group, a 6-vector state that of its rate.
    """
    classes = _Classes()
    seen: set[str] = set()
    for name, root in roots.items():
        for node in postorder(root):
            if node.key() not in seen:
                seen.add(node.key())
                _visit(node, classes, name, root)
    for state, rate in rates.items():
        if state.order is not None and rate.shape == (6,):
            classes.fix(_key(rate), state.order, f"the rate of pose {state.name!r}, declared with {state.order!r}")
        elif state.shape == rate.shape == (6,):
            classes.link([_key(state), _key(rate)])


def _visit(node: Expr, classes: _Classes, name: str, root: Expr) -> None:
    children = node.children()
    operands, result = node.twist_orders()
    place = ""
    for value, order in [*zip(children, operands, strict=True), (node, result)]:
        if order is not None and _carries(value):
            place = place or f"{name}: {find_path(root, node)}"
            classes.fix(_key(value), order, place)
    if node.keeps_order:
        classes.link([_key(value) for value in [*children, node] if _carries(value)])


def _carries(value: Expr) -> bool:
    """Whether a value has an order: six-dimensional, and no constant, which may stand anywhere."""
    return value.shape in _SIX and not isinstance(value, Constant)


def _key(value: Expr) -> str:
    return value.key()
