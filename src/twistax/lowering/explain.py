"""What a compiled system computes and what was left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import jax

from ..expr import Expr, postorder


@dataclasses.dataclass(frozen=True)
class Explanation:
    """What was left out of a compiled system, with counts before and after. Print it.

    Attributes:
        leaves: kind -> names, in order.
        unused: one line per control or parameter that no rate needs.
        baked: names of parameters folded into the code.
        nodes: (tree nodes as written, distinct nodes after canonicalize).
        equations: (jaxpr equations as written, after).
    """

    leaves: dict[str, list[str]]
    unused: list[str]
    baked: list[str]
    nodes: tuple[int, int]
    equations: tuple[int, int]

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        lines = [f"{kind}: {', '.join(names) or 'none'}" for kind, names in self.leaves.items()]
        lines.append(f"nodes of the rates: {self.nodes[0]} as written, {self.nodes[1]} distinct after simplification")
        lines.append(
            f"equations of the rates: {self.equations[0]} as written, {self.equations[1]} after simplification"
        )
        if self.baked:
            lines.append(f"baked in: {', '.join(self.baked)}")
        return "\n".join(lines + self.unused)


def written_nodes(roots: Iterable[Expr]) -> int:
    """Nodes of the trees as one would write them out: shared parts counted each time."""
    roots = list(roots)
    sizes: dict[int, int] = {}
    for node in postorder(*roots):
        sizes[id(node)] = 1 + sum(sizes[id(child)] for child in node.children())
    return sum(sizes[id(root)] for root in roots)


def distinct_nodes(roots: Iterable[Expr]) -> int:
    """Nodes that differ in structure."""
    return len({node.key() for node in postorder(*roots)})


def count_equations(jaxpr: Any) -> int:
    """Equations of a jaxpr, inner ones included and calls themselves not."""
    total = 0
    for equation in jaxpr.eqns:
        inner = [
            p for p in jax.tree_util.tree_leaves(list(equation.params.values()), is_leaf=_is_jaxpr) if _is_jaxpr(p)
        ]
        total += sum(count_equations(getattr(p, "jaxpr", p)) for p in inner) if inner else 1
    return total


def _is_jaxpr(value: Any) -> bool:
    return hasattr(value, "eqns") or hasattr(value, "jaxpr")
