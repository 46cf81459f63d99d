"""Traversal of expression graphs: every node once, children first, without recursion."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar, runtime_checkable

from ..checks import callable_with, short
from ..errors import ModelError, OperationError
from ..scalar.walk import walk

if TYPE_CHECKING:
    import jax


@runtime_checkable
class Node(Protocol):
    """The interface of nodes for traversal and printing; `Expr` is the implementation."""

    is_leaf: ClassVar[bool]
    precedence: ClassVar[int]

    def children(self) -> Sequence[Any]: ...
    def eager_children(self) -> Sequence[Any]: ...
    def outline(self) -> Sequence[tuple[str, Any]]: ...
    def with_children(self, children: Any) -> Any: ...
    def key(self) -> str: ...
    def check_shape(self) -> tuple[int, ...]: ...
    def evaluate_on_demand(self, values: Any, branches: Any) -> Any: ...
    def details(self) -> list[str]: ...
    def to_text(self, *operands: str) -> str: ...


N = TypeVar("N", bound=Node)

#: What a node says of itself besides its fields, for the check of a system.
FACTS = ("_known_as", "_checked")

#: So many nodes may be evaluated more than once.
_ANEW = 20_000


def postorder(*roots: N) -> list[N]:
    """Every node below the roots once (by identity), children before parents."""
    return list(walk(roots, lambda node: node.children()))


def traverse(expr: N, visit: Callable[[N], None]) -> None:
    """Call `visit` on every node below `expr`, children first, each once. Raises OperationError if it is not an
    expression.
    """
    if not hasattr(expr, "children"):
        raise OperationError(f"traverse expects an expression, got {short(expr)}")
    callable_with("traverse", visit, ["node"], OperationError)
    for node in postorder(expr):
        visit(node)


def leaves_of(*roots: Node) -> Iterator[Any]:
    """Every leaf below the roots, each object once."""
    return (node for node in postorder(*roots) if node.is_leaf)


def other_leaves(root: Node, placeholders: Sequence[Node]) -> list[Any]:
    """The leaves below a root that are not placeholders, each key once."""
    keys = {placeholder.key() for placeholder in placeholders}
    return [leaf for key, leaf in {leaf.key(): leaf for leaf in leaves_of(root)}.items() if key not in keys]


def substitute(root: N, exchange: Mapping[str, N], relabel: Callable[[N], N] | None = None) -> N:
    """The tree with every leaf whose key is in `exchange` replaced; parts without such a leaf remain the same
    objects.

    `relabel` returns the replacement of any other node: the same node with other declarations.
    """
    done: dict[int, N] = {}
    for node in postorder(root):
        children = node.children()
        if not children and node.key() in exchange:
            done[id(node)] = exchange[node.key()]
            continue
        new = node.with_children([done[id(child)] for child in children]) if children else node
        new = new if new is node else with_facts(new, node)
        done[id(node)] = new if relabel is None else relabel(new)
    return done[id(root)]


def with_facts(new: N, old: Node) -> N:
    """A node that says of itself what another one says besides its fields."""
    facts = {name: old.__dict__[name] for name in FACTS if name in old.__dict__}
    if not facts:
        return new
    same: N = object.__new__(type(new))
    same.__dict__.update(new.__dict__ | facts)
    return same


def find_path(root: Node, target: Node) -> str:
    """The path from `root` to `target`: `Solve.b -> Sub.right -> Adjoint`. The middle of a long path is omitted."""
    parents: dict[int, tuple[Node, str]] = {}
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
    current: Node = target
    while id(current) in parents:
        parent, name = parents[id(current)]
        steps.append(f"{type(parent).__name__}.{name}")
        current = parent
    steps.reverse()
    if len(steps) > 12:
        steps[5:-6] = ["..."]
    return " -> ".join(steps)


def bottom_up(root: N, slot: str, compute: Callable[[N], Any]) -> Any:
    """Compute a cached property for every node below `root`, children first."""
    if slot not in root.__dict__:
        if all(slot in child.__dict__ for child in root.children()):  # the case of nearly every call
            root.__dict__[slot] = compute(root)
            return root.__dict__[slot]
        for node in walk([root], lambda node: [child for child in node.children() if slot not in child.__dict__]):
            node.__dict__[slot] = compute(node)
    return root.__dict__[slot]


# ---- values ----------------------------------------------------------------------------------------------------------

#: Equal for equal subtrees.
_key: Callable[[Node], str] = operator.methodcaller("key")


def evaluate_all(roots: Sequence[Node], read: Callable[[Any], jax.Array]) -> list[jax.Array]:
    """The value of every root. Subtrees of equal structure are evaluated once.

    Subexpressions that all branches of a node need are evaluated before it, not separately in each branch.

    `read` returns the value of a leaf. Nothing is cached between calls: the function is pure.

    Raises:
        ModelError: nested branches share subexpressions that not all of them need, so that these would be evaluated in
            every branch, too often.
    """
    from .numerals import FORMULAS  # not at import: it loads much of JAX that `import jax` does not

    memo: dict[str, jax.Array] = {}
    distinct = list(walk(roots, lambda node: node.children(), _key))
    shared, needs = _shared_by_branches(roots, distinct)
    count = 0

    def values(roots: Sequence[Node], scope: Hashable, known: int) -> list[jax.Array]:
        """The values of roots in a scope; bit k of `known` says whether shared node k was evaluated around it."""
        fresh, known = needs.get(scope, 0) & ~known, needs.get(scope, 0) | known
        first = []
        while fresh:
            first.append(shared[(fresh & -fresh).bit_length() - 1])
            fresh &= fresh - 1
        for node in walk([*first, *roots], waiting, _key):
            if node.key() not in memo:
                memo[node.key()] = read(node) if node.is_leaf else value(node, known)
        return [memo[root.key()] for root in roots]

    def waiting(node: Node) -> list[Node]:
        return [child for child in node.eager_children() if child.key() not in memo]

    def value(node: Node, known: int) -> jax.Array:
        nonlocal count
        count += 1
        if count > len(distinct) + _ANEW:
            raise ModelError(
                "branches of tx.Cond share subexpressions that none of them always needs, so each branch "
                f"evaluates them again: {len(distinct):,} nodes become more than {count - 1:,}.\n"
                "  fix: use tx.Where in place of tx.Cond if both sides may be evaluated"
            )
        eager = node.eager_children()
        branches = [
            functools.partial(branch, root, (node.key(), k), known)
            for k, root in enumerate(node.children()[len(eager) :])
        ]
        operands = [memo[child.key()] for child in eager]
        return node.evaluate_on_demand(operands, branches) if branches else FORMULAS.value(node, operands)

    def branch(root: Node, scope: Hashable, known: int) -> jax.Array:
        before = len(memo)
        (value,) = values([root], scope, known)
        while len(memo) > before:  # what was evaluated here exists in the branch only
            memo.popitem()
        return value

    return values(roots, None, 0)


def function_of(root: Node, placeholders: Sequence[Node], known: Mapping[str, Any]) -> Callable[..., jax.Array]:
    """The value of a root as a function of the values of placeholders; `known` contains those of other leaves by
    key.
    """

    def value(*values: jax.Array) -> jax.Array:
        by_key = {**known, **{leaf.key(): value for leaf, value in zip(placeholders, values, strict=True)}}
        return evaluate_all([root], lambda leaf: by_key[leaf.key()])[0]

    return value


def _shared_by_branches(roots: Sequence[Node], order: Sequence[Node]) -> tuple[list[Node], dict[Hashable, int]]:
    """The nodes that stand in more than one scope, operands first, and which of them each scope needs for certain.

    A branch is a scope, (key of the node, place), and so is what is outside of all, None. Bit k of a number is node k.
    """
    if all(len(node.eager_children()) == len(node.children()) for node in order):
        return [], {}
    # Scopes from the roots down. What stands in several is a scope of its own, by its key.
    scopes: dict[str, Hashable] = {root.key(): None for root in roots}
    for node in reversed(order):
        eager = len(node.eager_children())
        for k, child in enumerate(node.children()):
            of_child = scopes[node.key()] if k < eager else (node.key(), k - eager)
            if not child.is_leaf and scopes.setdefault(child.key(), of_child) != of_child:
                scopes[child.key()] = child.key()
    shared: list[Node] = []
    needs: dict[Hashable, int] = {}

    def need(scope: Hashable, child: Node) -> None:
        if scopes.get(child.key()) == child.key():
            needs[scope] = needs.get(scope, 0) | needs[child.key()]

    for node in order:
        scope, eager = scopes.get(node.key()), len(node.eager_children())
        for child in node.children()[:eager]:
            need(scope, child)
        alternatives = []
        for k, child in enumerate(node.children()[eager:]):
            need((node.key(), k), child)
            alternatives.append(needs.get((node.key(), k), 0))
        if alternatives:
            needs[scope] = needs.get(scope, 0) | functools.reduce(operator.and_, alternatives)
        if scope == node.key():
            needs[scope] = needs.get(scope, 0) | 1 << len(shared)
            shared.append(node)
    for root in roots:
        need(None, root)
    return shared, needs
