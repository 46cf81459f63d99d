"""The memoised walker: the values of trees from the values of their leaves, every distinct subtree once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax

from .leaves import Leaf
from .node import Expr, postorder

Read = Callable[[Leaf], jax.Array]


def evaluate_all(roots: Sequence[Expr], read: Read) -> list[jax.Array]:
    """The value of every root. Equal subtrees (by structure, not identity) are evaluated once.

    `read` gives the value of a leaf. Nothing is kept between calls: the function is pure.
    """
    memo: dict[str, jax.Array] = {}
    for node in postorder(*roots):
        key = node.key()
        if key in memo:
            continue
        if isinstance(node, Leaf):
            memo[key] = read(node)
        else:
            memo[key] = node.evaluate(*(memo[child.key()] for child in node.children()))
    return [memo[root.key()] for root in roots]
