"""What a compiled system computes and what was left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..expr import Expr, postorder
from ..jax_inside import inner_jaxprs
from .scalar.program import ScalarProgram

__all__ = ["Dependence", "Explanation", "count_equations", "distinct_nodes", "entry_names", "written_nodes"]


@dataclasses.dataclass(frozen=True)
class Explanation:
    """What was left out of a compiled system, with counts before and after. Print it.

    Attributes:
        leaves: kind -> names, in order.
        unused: one line per control or parameter that no rate needs.
        baked: names of parameters folded into the code.
        nodes: (tree nodes as written, distinct nodes after canonicalize).
        equations: (jaxpr equations as written, after).
        operations: operations on scalars of the rates by kind: (in arrays as written, as a scalar program).
        constants: entry of a rate -> its value, where it depends on nothing.
        patterns: "x", "u" and "params" -> where the Jacobian of the rates is not structurally zero, (n, columns).
        backend: how the rates run, and why.
        compile_seconds: how long XLA took for one call of the rates.
    """

    leaves: dict[str, list[str]]
    unused: list[str]
    baked: list[str]
    nodes: tuple[int, int]
    equations: tuple[int, int]
    operations: tuple[dict[str, int], dict[str, int]]
    constants: dict[str, float]
    patterns: dict[str, NDArray[Any]]
    backend: str
    compile_seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Plain data; patterns as nested lists of truth values."""
        found = dataclasses.asdict(self)
        found["patterns"] = {kind: pattern.tolist() for kind, pattern in self.patterns.items()}
        return found

    def picture(self) -> str:
        """The pattern of the Jacobian by states and controls in characters: a row is a rate, # may differ from zero."""
        shown = [self.patterns[kind] for kind in ("x", "u") if self.patterns[kind].size]
        rows = [
            "|" + "|".join("".join("#" if entry else "." for entry in block[i]) for block in shown) + "|"
            for i in range(len(shown[0]) if shown else 0)
        ]
        return "\n".join(rows)

    def plot(self, axes: Any) -> None:
        """The pattern by states, then controls, on Matplotlib axes."""
        blocks = [self.patterns["x"], self.patterns["u"]]
        axes.spy(np.concatenate(blocks, axis=1), markersize=4)
        axes.axvline(blocks[0].shape[1] - 0.5, color="0.6", linewidth=0.8)
        axes.set_xlabel("tangents of the states, then controls")
        axes.set_ylabel("rates")

    def __str__(self) -> str:
        before, after = (sum(counts.values()) for counts in self.operations)
        lines = [f"{kind}: {', '.join(names) or 'none'}" for kind, names in self.leaves.items()]
        lines.append(f"nodes of the rates: {self.nodes[0]} as written, {self.nodes[1]} distinct after simplification")
        lines.append(
            f"equations of the rates: {self.equations[0]} as written, {self.equations[1]} after simplification"
        )
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.operations[1].items())
        lines.append(f"operations of the rates: {before} in arrays, {after} as scalars ({kinds or 'none'})")
        if self.constants:
            lines.append("constant rates: " + ", ".join(f"{k} = {v:g}" for k, v in self.constants.items()))
        for kind, pattern in self.patterns.items():
            if pattern.size:
                lines.append(f"Jacobian by {kind}: {int(pattern.sum())} of {pattern.size} entries are not zero")
        lines.append(f"runs as {self.backend}; compiled in {self.compile_seconds:.2f} s")
        if self.baked:
            lines.append(f"baked in: {', '.join(self.baked)}")
        return "\n".join(lines + self.unused)


@dataclasses.dataclass(frozen=True)
class Dependence:
    """What one rate or output, or one entry of it, depends on. Print it.

    Attributes:
        name: of what was asked for.
        reads: the entries of t, states, controls and parameters that it depends on.
        operations: on scalars by kind that it takes.
        value: its value where it depends on nothing and is one number, else None.
    """

    name: str
    reads: list[str]
    operations: dict[str, int]
    value: float | None

    @classmethod
    def of(cls, name: str, program: ScalarProgram, names: Sequence[str]) -> Dependence:
        """Of the results of a program whose arguments have these names."""
        g = program.graph
        entries = {
            node: entry
            for argument, nodes in zip(names, program.inputs, strict=True)
            for node, entry in zip(nodes.reshape(-1).tolist(), entry_names(argument, nodes.shape), strict=True)
        }
        reads = [entries[i] for i in program.live if i in entries]
        value = g.numbers[program.flat[0]] if len(program.flat) == 1 else None
        return cls(name, reads, program.counts(), value)

    def __str__(self) -> str:
        if self.value is not None:
            return f"{self.name} is {self.value:g} always"
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.operations.items())
        lines = [f"{self.name} depends on: {', '.join(self.reads) or 'nothing'}"]
        return "\n".join([*lines, f"operations: {sum(self.operations.values())} ({kinds or 'none'})"])


def entry_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """The names of all entries of an array: V[0], g[0, 3]; the name alone where there is one entry."""
    if not shape:
        return [name]
    return [f"{name}[{', '.join(map(str, index))}]" for index in np.ndindex(*shape)]


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
        inner = inner_jaxprs(equation)
        total += sum(count_equations(each.jaxpr) for each in inner) if inner else 1
    return total
