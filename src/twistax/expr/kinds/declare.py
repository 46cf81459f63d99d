"""Declaration of the kind and unit of an expression."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from ...errors import ModelError
from ..graph import FACTS
from ..leaves import Constant, Leaf
from ..node import Expr, to_expr
from .kinds import Kind, declared

#: The attributes for kind and unit of `known_as`, and the mark that requires a check of the system.
_KNOWN, _CHECKED = FACTS


def declare(value: Any, kind: Kind | None = None, unit: Any = None) -> Expr:
    """The same expression with a declared kind and unit: `tx.kinds.declare(R.T @ F, tx.FreeVector("body"), "N")`.

    A system that contains it is checked for this kind. Nothing else changes: the key of the expression, and therefore
    compiled programs, do not depend on the declaration. The results of `canonicalize` and `replace` have no
    declaration. States, controls and parameters declare their kind by `kind=` and `unit=`.

    Args:
        value: an expression, or numbers.
        kind: its kind, with the frames, such as `tx.Point("world")`; see `tx.kinds`.
        unit: unit of all entries, such as "m/s"; for a six-vector, the unit of its angular part.
    Raises: ModelError for a kind of another shape, or an unknown unit.

    Units: the declared ones.

    Example: `outputs={"tip": tx.kinds.declare(arm.pose("tip")[:3, 3], tx.Point("base"))}`
    """
    expr = to_expr(value)
    if kind is None and unit is None:
        raise ModelError(
            "declare expects a kind or a unit, got neither.\n  fix: for example tx.kinds.declare(x, unit='m')"
        )
    if isinstance(expr, Constant):
        return Constant(expr.value, **declared("a constant", expr.shape, kind, unit))
    same = known_as(expr, kind, unit)
    same.__dict__[_CHECKED] = True
    return same


Node = TypeVar("Node", bound=Expr)


def known_as(expr: Node, kind: Kind | None = None, unit: Any = None) -> Node:
    """The same expression with a known kind and unit, used in systems with declared kinds.

    Used by this package for its states, outputs and wrenches. It does not by itself require a check, so that models
    without declarations are not checked. Raises the errors of `declare`.
    """
    facts = declared(f"{type(expr).__name__}", expr.shape, kind, unit)
    same: Node = object.__new__(type(expr))
    same.__dict__.update(expr.__dict__)
    same.__dict__[_KNOWN] = facts["kind"], facts["unit"]
    return same


def renamed_frames(node: Node, names: Mapping[str, str]) -> Node:
    """The node with other names of frames and bodies in what it declares."""
    known, changes = known_of(node), dict[str, Any]()
    if known is not None and known[0] is not None and known[0].names() & names.keys():
        changes[_KNOWN] = known[0].renamed(names), known[1]
    if isinstance(node, Leaf) and node.kind is not None and node.kind.names() & names.keys():
        changes["kind"] = node.kind.renamed(names)
    if not changes:
        return node
    same: Node = object.__new__(type(node))
    same.__dict__.update(node.__dict__ | changes)
    return same


def declares(node: Expr) -> bool:
    """Whether a node requires a check of its system."""
    return _CHECKED in node.__dict__ or (isinstance(node, Leaf) and node.declares)


def known_of(node: Expr) -> tuple[Kind | None, Any] | None:
    """The kind and the unit from `known_as` or `declare`; None without them."""
    known: tuple[Kind | None, Any] | None = node.__dict__.get(_KNOWN)
    return known


def kind_of(node: Expr) -> Kind | None:
    """The kind that a leaf or another expression declares."""
    known = known_of(node)
    kind = node.kind if isinstance(node, Leaf) else None
    return kind or (known[0] if known else None)
