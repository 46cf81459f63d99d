"""The order of six-vectors in a system, [v; w] or [w; v], with an error if two orders are mixed.

An order belongs to an axis of length six: a twist has one such axis, a 6x6 operator two, and the Jacobian of an arm
with six joints one for the twist and another for the joints. Orders propagate along axes: a Lie node determines those
of its operands and its result, a sum requires one order of all terms, a product passes on the axes that are not summed
over, and a state has the order of its rate. Axes that must agree form a class; two orders in a class are an error,
whose message names both places. The two axes of a 6x6 matrix form no class, because one of them may be that of joints;
but it is an error if both are six-vectors of different order.

Indexing and joining stop the propagation. Constants, and expressions of constants and scalars only, have no order and
may be used anywhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TypeAlias

from ..errors import OrderError
from ..groups import Order
from .graph import find_path, postorder
from .leaves import Constant, Leaf, State
from .node import Expr

_SIX = 6
_Token: TypeAlias = tuple[object, ...]
#: An axis of a value: what stands for the value, and the axis counted from the last, -1.
_Slot: TypeAlias = tuple[_Token, int]


@dataclasses.dataclass(frozen=True)
class _OrderPlace:
    """The place that fixed an order: a node below a named root, or the root itself."""

    order: Order
    name: str
    root: Expr
    node: Expr
    value: Expr

    def __str__(self) -> str:
        path = "" if self.node is self.root else f" {find_path(self.root, self.node)},"
        return f"{self.name}:{path} {short(self.value)} is {self.order!r}"


class _Classes:
    """Union-find over slots; a class remembers its order and the first place that fixed it."""

    def __init__(self) -> None:
        self._parent: dict[_Slot, _Slot] = {}
        self._fixed: dict[_Slot, _OrderPlace] = {}

    def _find(self, slot: _Slot) -> _Slot:
        while self._parent.setdefault(slot, slot) != slot:
            self._parent[slot] = self._parent[self._parent[slot]]
            slot = self._parent[slot]
        return slot

    def place_of(self, slot: _Slot) -> _OrderPlace | None:
        """The place that fixed the order of an axis, or None."""
        return self._fixed.get(self._find(slot))

    def fix(self, slot: _Slot, place: _OrderPlace) -> None:
        _agree(self._fixed.setdefault(self._find(slot), place), place)

    def link(self, slots: Sequence[_Slot]) -> None:
        for other in slots[1:]:
            kept, gone = self._find(slots[0]), self._find(other)
            if kept != gone:
                self._parent[gone] = kept
                if gone in self._fixed:
                    self.fix(kept, self._fixed[gone])


def _agree(known: _OrderPlace | None, place: _OrderPlace | None, where: str = "") -> None:
    """Raise OrderError if two places fix different orders."""
    if known and place and known.order != place.order:
        raise OrderError(
            f"two orders of six-vectors are combined{where}: {known.order!r} and {place.order!r}.\n"
            f"  at: {known}\n  and: {place}\n"
            "  fix: give both places the same order=, or put a tx.lie.Reorder between them"
        )


@dataclasses.dataclass(frozen=True)
class _Scope:
    """The scope of values: the system, or the body of one Vmap, whose elements have no name outside."""

    key: str = ""
    outer: _Scope | None = None
    #: Keys of the leaves that the body of a Vmap takes from outside.
    captured: frozenset[str] = frozenset()

    def of(self, value: Expr) -> _Scope:
        """The scope of a value met here: a leaf from outside keeps its own."""
        return self.outer.of(value) if self.outer is not None and value.key() in self.captured else self


class _Flow:
    """Walks all expressions of a system and collects constraints on orders from their nodes."""

    def __init__(self) -> None:
        self._classes = _Classes()
        self._free: dict[_Token, bool] = {}
        self._operators: dict[_Token, tuple[str, Expr]] = {}

    def read(self, name: str, root: Expr) -> None:
        self._read(name, root, root, _Scope())

    def _read(self, name: str, root: Expr, below: Expr, scope: _Scope) -> None:
        """Everything below a node, children first, including bodies of Vmaps; each node once."""
        for node in postorder(below):
            if _token(scope, node) in self._free:
                continue
            for body in bodies(node):
                self._read(name, root, body, _body_scope(scope, node))
            self._free[_token(scope, node)] = self._is_free(scope, node)
            operands, result = node.twist_orders()
            for value, order in [*zip(node.children(), operands, strict=True), (node, result)]:
                if order is not None:
                    self._fix(_OrderPlace(order, name, root, node, value), scope)
            for axes in node.shared_orders():
                six = [(value, axis) for value, axis in axes if value.shape[axis] == _SIX]
                self._classes.link([self._slot(scope, node, value, axis) for value, axis in six])
            for value in [*node.children(), node]:
                if len(_axes(value)) == 2:
                    self._operators.setdefault(self._slot(scope, node, value, -1)[0], (name, value))

    def read_rate(self, state: State, rate: Expr) -> None:
        """The rate of a pose has the order of its group, another state that of its rate."""
        if state.order is not None:
            self._fix(_OrderPlace(state.order, f"the rate of the pose {state.name!r}", rate, rate, rate), _Scope())
        elif state.shape == rate.shape:
            for axis in _axes(rate):
                self._classes.link([self._slot(_Scope(), state, value, axis) for value in (state, rate)])

    def _fix(self, place: _OrderPlace, scope: _Scope) -> None:
        for axis in place.node.twist_axes(place.value):
            if place.value.shape[axis] == _SIX:
                self._classes.fix(self._slot(scope, place.node, place.value, axis), place)

    def check_operators(self) -> None:
        """A 6x6 matrix takes and gives one order, where both its sides are known to be six-vectors."""
        for token, (name, value) in self._operators.items():
            known, place = (self._classes.place_of((token, axis)) for axis in (-1, -2))
            # Writing a value out takes as long as all the rest.
            if known and place and known.order != place.order:
                _agree(known, place, f" on the two sides of {name}: {short(value)}")

    def _is_free(self, scope: _Scope, node: Expr) -> bool:
        """Whether no part of the value has an order."""
        if isinstance(node, Leaf):
            return isinstance(node, Constant)
        if node.twist_orders()[1] is not None:
            return False
        linked = [value for axes in node.shared_orders() for value, axis in axes if value.shape[axis] == _SIX]
        sources = [value for value in linked if value is not node] or node.children()
        return all(self._free[_token(scope, value)] for value in sources)

    def _slot(self, scope: _Scope, parent: Expr, value: Expr, axis: int) -> _Slot:
        """The axis of a value as its parent sees it: a value without order is another one at every place."""
        token = _token(scope, value)
        return ((*token, parent.key()) if self._free.get(token, False) else token), axis


def check_orders(roots: Mapping[str, Expr], rates: Mapping[State, Expr]) -> None:
    """Raise OrderError if a [v; w] value is combined with a [w; v] value.

    Args:
        roots: every expression of a system, by the name used in messages.
        rates: the rate of every state. The rate of a pose has the order of its group; any other state has the order of
            its rate.
    """
    flow = _Flow()
    for name, root in roots.items():
        flow.read(name, root)
    for state, rate in rates.items():
        flow.read_rate(state, rate)
    flow.check_operators()


def _token(scope: _Scope, value: Expr) -> _Token:
    return scope.of(value).key, value.key()


def _body_scope(scope: _Scope, node: Expr) -> _Scope:
    captured = frozenset(child.key() for child in node.children() if isinstance(child, Leaf))
    return _Scope(f"{scope.key}/{node.key()}", scope, captured)


def _axes(value: Expr) -> list[int]:
    """The axes of a vector (6,) or an operator (6, 6), counted from the last."""
    shape = value.shape
    return [-1 - i for i in range(len(shape))] if shape in ((_SIX,), (_SIX, _SIX)) else []


def bodies(node: Expr) -> list[Expr]:
    """The expressions that a node contains besides its children."""
    if type(node).outline is Expr.outline:
        return []
    children = {id(child) for child in node.children()}
    return [part for _, part in node.outline() if id(part) not in children]


def short(value: Expr, longest: int = 60) -> str:
    """The text of a value, truncated if it is long."""
    text = repr(value)
    return text if len(text) <= longest else f"{text[:longest]}..."
