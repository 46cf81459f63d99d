"""Constant folding: a node over constants is a constant."""

from __future__ import annotations

import jax
import numpy as np

from .leaves import Constant, Leaf
from .node import Expr
from .numerals import numerals


def fold(node: Expr) -> Expr:
    """The Constant a node amounts to when all its children are constants; else the node itself.

    Folding is done in float64, whatever the switch says, so that a folded number is as good as one typed in.
    A result that is not finite is not folded: the run shall show it where it happens.
    """
    children = node.children()
    if isinstance(node, Leaf) or not children or not all(isinstance(child, Constant) for child in children):
        return node
    node.check_shape()
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        result = numerals(
            node.evaluate,
            [child.value for child in children if isinstance(child, Constant)],
            traced=not node.by_operators,
        )
    if not np.isfinite(result).all():
        return node
    constant = Constant(result)
    # The transpose and the inverse of such a matrix are such matrices again.
    known = any(isinstance(child, Constant) and child.folded_from is not None for child in children)
    origin = node.simplify() if known else node
    if origin.structured:
        constant.__dict__["_folded_from"] = origin
    return constant
