"""Detection of expressions that are not finite for any state."""

from __future__ import annotations

import numpy as np

from ..errors import ModelError
from ..expr import Add, Block, Concat, Constant, Constraint, Div, Expr, Hstack, Mul, Neg, Stack, Sub, Vstack, find_path

#: Nodes whose value has a NaN if an operand has one.
_PASSING = (Add, Sub, Mul, Div, Neg, Stack, Concat, Block, Hstack, Vstack)


def need_finite(place: str, root: Expr) -> None:
    """Raise ModelError if an expression (for a constraint, its residual) is not finite for any state."""
    root = root.residual() if isinstance(root, Constraint) else root
    if (not_finite := _not_finite(root)) is not None:
        raise ModelError(
            f"{place} is never finite: it expects finite numbers, got {not_finite!r}.\n"
            f"  at: {find_path(root, not_finite)}\n  fix: use a tx.Parameter for an unknown value"
        )


def _not_finite(root: Expr) -> Constant | None:
    """A constant that makes the value NaN whatever the states are, or that is the value and infinite; None if none."""
    if isinstance(root, Constant) and not np.isfinite(root.value).all():
        return root
    waiting, seen = [root], set[int]()
    while waiting:
        node = waiting.pop()
        if isinstance(node, Constant) and np.isnan(node.value).any():
            return node
        # Other nodes may drop the entry, or choose another branch.
        if isinstance(node, _PASSING) and id(node) not in seen:
            seen.add(id(node))
            waiting.extend(node.children())
    return None
