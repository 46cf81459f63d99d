"""Which order the six-vectors of a system have, [v; w] or [w; v], and an error where two orders meet.

Orders flow through the graph: a Lie node fixes the order of its six-dimensional operands and result; sums, products and
solves hand it on; a state shares it with its rate. Values that must agree form one class; a class with two orders is a
mistake somewhere, and both places are named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping

from ..errors import OrderError
from ..groups import Order
from .leaves import Constant, State
from .node import Expr, find_path

#: The shapes an order concerns: twists, wrenches and momenta, and the operators on them.
_SIX = ((6,), (6, 6))


@dataclasses.dataclass(frozen=True)
class _Place:
    """What fixed an order: a node below a named root, or the root itself."""

    order: Order
    name: str
    root: Expr
    node: Expr
    value: Expr

    def __str__(self) -> str:
        path = "" if self.value is self.root else f" {find_path(self.root, self.node)},"
        return f"{self.name}:{path} {_short(self.value)} is {self.order!r}"


class _Classes:
    """Union-find over structural keys; a class remembers its order and the first place that fixed it."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._fixed: dict[str, _Place] = {}

    def _find(self, key: str) -> str:
        while self._parent.setdefault(key, key) != key:
            self._parent[key] = self._parent[self._parent[key]]
            key = self._parent[key]
        return key

    def fix(self, place: _Place) -> None:
        self._agree(self._find(place.value.key()), place)

    def link(self, values: Iterable[Expr]) -> None:
        roots = [self._find(value.key()) for value in values]
        for root in roots[1:]:
            first, root = self._find(roots[0]), self._find(root)
            if root != first:
                self._parent[root] = first
                if root in self._fixed:
                    self._agree(first, self._fixed[root])

    def _agree(self, root: str, place: _Place) -> None:
        known = self._fixed.setdefault(root, place)
        if known.order != place.order:
            raise OrderError(
                f"two orders of six-vectors meet: {known.order!r} and {place.order!r}.\n"
                f"  at: {known}\n  and: {place}\n"
                "  fix: give both places the same order=, or put a tx.lie.Reorder between them"
            )


def check_orders(roots: Mapping[str, Expr], rates: Mapping[State, Expr]) -> None:
    """Raise OrderError if a [v; w] value meets a [w; v] value.

    Args:
        roots: every expression of a system, by the name used in messages.
        rates: the rate of every state: a pose's rate has the order of its group, another state that of its rate.
    """
    classes = _Classes()
    seen: set[str] = set()
    for name, root in roots.items():
        for node in _below(root, seen):
            operands, result = node.twist_orders()
            for value, order in [*zip(node.children(), operands, strict=True), (node, result)]:
                if order is not None and _carries(value):
                    classes.fix(_Place(order, name, root, node, value))
            if node.keeps_order:
                classes.link(value for value in [*node.children(), node] if _carries(value))
    for state, rate in rates.items():
        if not _carries(rate):
            continue
        if state.order is not None:
            classes.fix(_Place(state.order, f"the rate of the pose {state.name!r}", rate, rate, rate))
        elif state.shape == rate.shape:
            classes.link([state, rate])


def _below(root: Expr, seen: set[str]) -> Iterator[Expr]:
    """Every node below the root that was not seen yet, those inside the body of a Vmap too."""
    stack = [root]
    while stack:
        node = stack.pop()
        if node.key() not in seen:
            seen.add(node.key())
            yield node
            stack.extend(child for _, child in reversed(node.outline()))


def _carries(value: Expr) -> bool:
    """Whether a value has an order: six-dimensional, and no constant, which may stand anywhere."""
    return value.shape in _SIX and not isinstance(value, Constant)


def _short(value: Expr, longest: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= longest else f"{text[:longest]}..."
