"""Graphs of nodes: every node once, children first, without recursion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..checks import callable_with, short
from ..errors import OperationError

if TYPE_CHECKING:
    import jax

    from .leaves import Leaf
    from .node import Expr


def postorder(*roots: Expr) -> list[Expr]:
    """Every node below the roots once (by identity), children before parents."""
    seen: set[int] = set()
    order: list[Expr] = []
    stack: list[tuple[Expr, bool]] = [(root, False) for root in reversed(roots)]
    while stack:
        node, done = stack.pop()
        if done:
            order.append(node)
            continue
        if id(node) in seen:
            continue
        seen.add(id(node))
        stack.append((node, True))
        stack.extend((child, False) for child in reversed(node.children()) if id(child) not in seen)
    return order


def traverse(expr: Expr, visit: Callable[[Expr], None]) -> None:
    """Call `visit` on every node below `expr`, children first, each once. Raises OperationError."""
    if not hasattr(expr, "children"):
        raise OperationError(f"traverse expects an expression, got {short(expr)}")
    callable_with("traverse", visit, ["node"], OperationError)
    for node in postorder(expr):
        visit(node)


def leaves_of(*roots: Expr) -> Iterator[Leaf]:
    """Every leaf below the roots, each object once."""
    return (node for node in postorder(*roots) if node.is_leaf)  # type: ignore[misc]


def substitute(root: Expr, exchange: Mapping[str, Expr]) -> Expr:
    """The tree with every leaf whose key is in `exchange` replaced; parts without such a leaf stay the same objects."""
    done: dict[int, Expr] = {}
    for node in postorder(root):
        children = node.children()
        if children:
            done[id(node)] = node.with_children([done[id(child)] for child in children])
        else:
            done[id(node)] = exchange.get(node.key(), node)
    return done[id(root)]


def find_path(root: Expr, target: Expr) -> str:
    """How to reach `target` from `root`: `Solve.b -> Sub.right -> Adjoint`. The middle of a long way is left out."""
    parents: dict[int, tuple[Expr, str]] = {}
    stack = [root]
    seen = {id(root)}
    while stack:
        node = stack.pop()
        if node is target:
            break
        for name, child in node.outline():
            if id(child) not in seen:
                seen.add(id(child))
                parents[id(child)] = (node, name)
                stack.append(child)
    steps = [type(target).__name__]
    current: Expr = target
    while id(current) in parents:
        parent, name = parents[id(current)]
        steps.append(f"{type(parent).__name__}.{name}")
        current = parent
    steps.reverse()
    if len(steps) > 12:
        steps[5:-6] = ["..."]
    return " -> ".join(steps)


def bottom_up(root: Expr, slot: str, compute: Callable[[Expr], Any]) -> Any:
    """Compute a cached property for every node below `root`, children first, without recursion."""
    if slot not in root.__dict__:
        stack = [root]
        while stack:
            node = stack[-1]
            if slot in node.__dict__:
                stack.pop()
                continue
            waiting = [child for child in node.children() if slot not in child.__dict__]
            if waiting:
                stack.extend(waiting)
            else:
                node.__dict__[slot] = compute(node)
                stack.pop()
    return root.__dict__[slot]


def evaluate_all(roots: Sequence[Expr], read: Callable[[Leaf], jax.Array]) -> list[jax.Array]:
    """The value of every root. Equal subtrees (by structure, not identity) are evaluated once.

    `read` gives the value of a leaf. Nothing is kept between calls: the function is pure.
    """
    memo: dict[str, jax.Array] = {}
    return [_value(root, read, memo) for root in roots]


def _value(root: Expr, read: Callable[[Leaf], jax.Array], memo: dict[str, jax.Array]) -> jax.Array:
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
        if key not in memo and node.is_leaf:
            memo[key] = read(node)  # type: ignore[arg-type]
        elif key not in memo:
            memo[key] = node.evaluate_on_demand([memo[c.key()] for c in node.eager_children()], value_of)
    return memo[root.key()]
