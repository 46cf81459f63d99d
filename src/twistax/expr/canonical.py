"""`canonicalize`: one pass over the expression graph, children first; shared nodes remain shared.

A node class contributes `simplify()`, whose operands are canonical. Sums and products are flattened here, because only
this pass knows the other users of an inner sum: if a shared sum were merged into each of them, it would be computed
several times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from .graph import postorder
from .operators import NODES

if TYPE_CHECKING:
    from .numerals import Formulas

_MARK = "_is_canonical"


def canonicalize_all(roots: Sequence[Any]) -> list[Any]:
    """Simpler trees of the same shapes, equal wherever the originals are finite; shared parts remain shared."""
    nodes = postorder(*roots)
    uses = Counter(id(child) for node in nodes for child in node.children()) + Counter(map(id, roots))
    absorbed = {id(c) for n in nodes if n.associative for c in n.children() if type(c) is type(n) and uses[id(c)] == 1}
    done: dict[int, Any] = {}
    operands: dict[int, list[Any]] = {}
    formulas: Formulas = {}
    for node in nodes:
        if _MARK in node.__dict__:
            done[id(node)] = node
            continue
        children: list[Any] = []
        for child in node.children():
            new = done.get(id(child))
            if new is None:
                children.extend(operands[id(child)])
            elif node.associative and type(new) is type(node) and uses[id(child)] == 1:
                children.extend(new.children())
            else:
                children.append(new)
        # A nested sum or product that its only user absorbs is simplified there, once, not at every level.
        if id(node) in absorbed:
            operands[id(node)] = children
        else:
            done[id(node)] = _settled(node.with_children(children), formulas)
    return [done[id(root)] for root in roots]


def _settled(node: Any, formulas: Formulas) -> Any:
    """Fold and simplify until nothing changes; a rewrite may build new nodes, which are simplified first."""
    while _MARK not in node.__dict__:
        node = node.with_children(
            [child if _MARK in child.__dict__ else _settled(child, formulas) for child in node.children()]
        )
        node.check_shape()
        simpler = fold(node, formulas)
        if simpler is node:
            simpler = node.simplify()
        if simpler is node:
            node.__dict__[_MARK] = True
        node = simpler
    return node


def fold(node: Any, formulas: Formulas | None = None) -> Any:
    """The Constant that a node evaluates to if all its children are constants; else the node itself.

    Args:
        formulas: cached traces of nodes that were folded before, to which that of this node is added.

    Folding computes in float64, regardless of JAX's x64 setting, so that a folded number is as exact as a literal. A
    result that is not finite is not folded, so that an evaluation reports it at its place.
    """
    children, Constant = node.children(), NODES["Constant"]
    if node.is_leaf or not children or not all(isinstance(child, Constant) for child in children):
        return node
    from .numerals import numerals  # not at import: it loads much of JAX that `import jax` does not

    node.check_shape()
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        result = numerals(
            node.evaluate,
            [child.value for child in children if isinstance(child, Constant)],
            kind=None if node.by_operators else (type(node), node.static_key()),
            formulas=formulas if node.by_values and formulas is not None else {},
        )
    if not np.isfinite(result).all():
        return node
    constant = Constant(result)
    # The transpose and the inverse of a structured matrix are structured again.
    known = any(isinstance(child, Constant) and child.folded_from is not None for child in children)
    origin = node.simplify() if known else node
    if origin.structured:
        constant.__dict__["_folded_from"] = origin
    return constant
