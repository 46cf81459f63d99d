"""The memoised walker: the values of trees from the values of their leaves, every distinct subtree once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax

from .leaves import Leaf
from .node import Expr

Read = Callable[[Leaf], jax.Array]


def evaluate_all(roots: Sequence[Expr], read: Read) -> list[jax.Array]:
    """The value of every root. Equal subtrees (by structure, not identity) are evaluated once.

    `read` gives the value of a leaf. Nothing is kept between calls: the function is pure.
    """
    memo: dict[str, jax.Array] = {}
    return [_value(root, read, memo) for root in roots]


def _value(root: Expr, read: Read, memo: dict[str, jax.Array]) -> jax.Array:
    """The value of `root`; what is computed on the way is added to `memo`."""

    def value_of(branch: Expr) -> jax.Array:
        # A branch sees what is known already. What it computes may exist in the branch only, so it keeps its own memo.
        return _value(branch, read, dict(memo))

    stack = [root]
    while stack:
        node = stack[-1]
        key = node.key()
        waiting = [] if key in memo else [c for c in node.eager_children() if c.key() not in memo]
        if waiting:
            stack.extend(reversed(waiting))
            continue
        stack.pop()
        if key in memo:
            continue
        if isinstance(node, Leaf):
            memo[key] = read(node)
        else:
            memo[key] = node.evaluate_on_demand([memo[c.key()] for c in node.eager_children()], value_of)
    return memo[root.key()]
