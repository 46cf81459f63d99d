"""Explanations: what a compiled system computes, and what the simplification removed."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Sequence
from decimal import Decimal
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..checks import listed
from ..errors import InputError, ModelError
from ..expr import Constant, Expr, Inputs, evaluate_all, leaves_of, postorder
from ..expr.kinds.inference import infer_kinds
from ..jax_inside import all_equations, inner_jaxprs
from ..progress import watching
from ..scalar.backends import array_operations
from ..scalar.graph import TooLarge
from ..scalar.reader import scalarize
from .functions import Functions
from .system import System

_LEFT_OUT = "the Jacobian is left out: it takes too many scalars"


@dataclasses.dataclass(frozen=True)
class Explanation:
    """The counts of a compiled system before and after simplification, and what was removed. Print it.

    Attributes:
        leaves: kind -> names, in order.
        unused: one line per control or parameter that no rate needs.
        baked: names of the parameters that are constants of the compiled system.
        nodes: (tree nodes as written, distinct nodes after `canonicalize`).
        equations: (jaxpr equations as written, after).
        operations: the number of scalar operations of the rates by kind: (in arrays as written, as a scalar program).
        constants: entry of a rate -> its value, if it is constant.
        patterns: "x", "u" and "params" -> where the Jacobian of the rates is not structurally zero, (n, columns). Empty
            if the Jacobian takes too many scalars.
        backend: how the rates are executed, and why.
        compile_seconds: XLA's compile time of a call of the rates.
        without_kernel: the name of each `tx.Function` that native kernels do not support, with the reason.
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
    without_kernel: dict[str, str]

    def as_dict(self) -> dict[str, Any]:
        """The attributes as plain data, with patterns as nested lists of booleans."""
        patterns = {kind: pattern.tolist() for kind, pattern in self.patterns.items()}
        return {**dataclasses.asdict(self), "patterns": patterns}

    def picture(self) -> str:
        """The pattern of the Jacobian by states and controls in characters: a row is a rate, # may differ from zero."""
        if not self.patterns:
            return _LEFT_OUT
        shown = [np.where(self.patterns[kind], "#", ".") for kind in ("x", "u") if self.patterns[kind].size]
        return "\n".join("|" + "|".join("".join(row) for row in rows) + "|" for rows in zip(*shown, strict=True))

    def plot(self, axes: Any) -> None:
        """The pattern by states, then controls, on Matplotlib axes.

        Raises:
            ModelError: there is no pattern.
        """
        if not self.patterns:
            raise ModelError(f"there is no pattern to plot: {_LEFT_OUT}")
        blocks = [self.patterns["x"], self.patterns["u"]]
        axes.spy(np.concatenate(blocks, axis=1), markersize=4)
        axes.axvline(blocks[0].shape[1] - 0.5, color="0.6", linewidth=0.8)
        axes.set_xlabel("tangents of the states, then controls")
        axes.set_ylabel("rates")

    def __str__(self) -> str:
        before, after = (sum(counts.values()) for counts in self.operations)
        lines = [f"{kind}: {', '.join(names) or 'none'}" for kind, names in self.leaves.items()]
        # A tree with shared parts may have more nodes, written out, than there are atoms.
        written = str(self.nodes[0]) if self.nodes[0] < 10**9 else f"{Decimal(self.nodes[0]):.1e}"
        lines.append(f"nodes of the rates: {written} as written, {self.nodes[1]} distinct after simplification")
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
        if not self.patterns:
            lines.append(_LEFT_OUT)
        lines.append(f"runs as {self.backend}; compiled in {self.compile_seconds:.2f} s")
        for name, reason in self.without_kernel.items():
            lines.append(f"Function {name!r} runs by XLA, without a native kernel: {reason}")
        if self.baked:
            lines.append(f"baked in: {', '.join(self.baked)}")
        return "\n".join(lines + self.unused)


@dataclasses.dataclass(frozen=True)
class Dependence:
    """The dependencies of one rate or output, or of one entry of it. Print it.

    Attributes:
        name: the name of the rate, output or entry.
        reads: the entries of t, states, controls and parameters that it depends on.
        operations: the number of scalar operations by kind.
        value: its value if it is a single constant, else None.
    """

    name: str
    reads: list[str]
    operations: dict[str, int]
    value: float | None

    def __str__(self) -> str:
        if self.value is not None:
            return f"{self.name} is {self.value:g} always"
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.operations.items())
        lines = [f"{self.name} depends on: {', '.join(self.reads) or 'nothing'}"]
        return "\n".join([*lines, f"operations: {sum(self.operations.values())} ({kinds or 'none'})"])


@dataclasses.dataclass(frozen=True)
class KindsExplanation:
    """The known kinds, frames and units: declared, inferred from operators, or open. Print it.

    Attributes:
        leaves, rates, outputs: name -> a text about its kind.
        of_kind: "states", "controls" and "parameters" -> names, in order.
        declared: the names of the leaves that declare a kind or a unit.
        open: the names of leaves without a known kind, then of rates and outputs, such as "rate of q".
    """

    leaves: dict[str, str]
    rates: dict[str, str]
    outputs: dict[str, str]
    of_kind: dict[str, list[str]]
    declared: list[str]
    open: list[str]

    def __str__(self) -> str:
        families = {kind: {name: self.leaves[name] for name in names} for kind, names in self.of_kind.items()}
        families |= {"rates": self.rates, "outputs": self.outputs}
        width = max(len(name) for values in families.values() for name in values)
        lines = []
        for family, values in families.items():
            lines += [family] if values else []
            for name, text in values.items():
                origin = "  (declared)" if name in self.declared and family in self.of_kind else ""
                lines.append(f"  {name:{width}s}  {text}{origin}")
        if self.open:
            lines.append(f"nothing is known of: {', '.join(self.open)}")
        return "\n".join(lines)


def explain_kinds(system: System) -> KindsExplanation:
    """Implements `Dynamics.explain(kinds=True)`. Raises KindError for contradictions."""
    roots = {
        **{f"rates[{name!r}]": rate for name, rate in system.rates.items()},
        **{f"outputs[{name!r}]": expr for name, expr in system.outputs.items()},
        **{f"constraints[{name!r}]": expr for name, expr in system.constraints.items()},
    }
    of_kind = {"states": system.states, "controls": system.controls, "parameters": system.parameters}
    leaves = [leaf for of_one in of_kind.values() for leaf in of_one]
    known = infer_kinds(roots, {state: system.rates[state.name] for state in system.states}, leaves)
    named: dict[str, dict[str, Expr]] = {"": {leaf.name: leaf for leaf in leaves}}
    named |= {"rate of ": system.rates, "output ": system.outputs}
    texts = ({name: known.description(expr) for name, expr in exprs.items()} for exprs in named.values())
    of_leaves, of_rates, of_outputs = texts
    return KindsExplanation(
        of_leaves,
        of_rates,
        of_outputs,
        of_kind={kind: [leaf.name for leaf in of_one] for kind, of_one in of_kind.items()},
        declared=[leaf.name for leaf in leaves if leaf.declares],
        open=[what + name for what, exprs in named.items() for name, e in exprs.items() if not known.knows(e)],
    )


@watching("explain")
def explain(functions: Functions) -> Explanation:
    """Implements `Dynamics.explain()`. Arguments are in JAX's default precision."""
    inputs = functions.zeros()
    places, arrays = functions.flat(inputs)
    try:
        jacobian, _ = functions.rate_jacobian(inputs, ("x", "u", "params"))
        rates, patterns = jacobian.rates, jacobian.pattern
    except TooLarge:
        rates, patterns = scalarize(functools.partial(functions.flat_rates, places), *arrays), {}
    kinds = {"states": functions.states, "controls": functions.controls, "parameters": functions.parameters}
    written = list(functions.system.rates.values())
    simplified = [expr for (expr,) in functions.families["rates"].values()]
    entries = [entry for name, (rate,) in functions.families["rates"].items() for entry in _entries(name, rate.shape)]
    numbers = [rates.graph.numbers[i] for i in rates.flat]
    before, after = (_jaxpr(roots, inputs.dtype) for roots in (written, simplified))
    distinct = len({node.key() for node in postorder(*simplified)})
    start = time.perf_counter()
    arguments = (inputs.t, inputs.x, inputs.u, inputs.params)
    jax.jit(functools.partial(functions.evaluate, "rates", in_loop=False)).lower(*arguments).compile()
    seconds = time.perf_counter() - start
    leaves, structure = jax.tree.flatten(arguments)
    emission, _ = functions.emission("rates", structure, tuple((a.shape, a.dtype) for a in leaves))
    return Explanation(
        leaves={kind: [leaf.name for leaf in of_kind] for kind, of_kind in kinds.items()},
        unused=_unused(functions),
        baked=list(functions.baked),
        nodes=(_written_nodes(written), distinct),
        equations=(count_equations(before), count_equations(after)),
        operations=(dict(sorted(array_operations(before).items())), rates.counts()),
        constants={name: n for name, n in zip(entries, numbers, strict=True) if n is not None},
        patterns=patterns,
        backend=emission.reason,
        compile_seconds=seconds,
        without_kernel=functions.without_kernel,
    )


def explain_one(functions: Functions, of: str) -> Dependence:
    """Implements `Dynamics.explain(of)` for one rate or output, or an entry of it.

    Raises:
        InputError: no rate or output has that name, or it has no such entry.
    """
    name, _, rest = str(of).partition("[")
    families = {known: family for family in ("outputs", "rates") for known in functions.families[family]}
    if name not in families:
        known = [*functions.families["rates"], *functions.families["outputs"]]
        raise InputError(f"explain expects a rate or an output, got {of!r}; there are: {listed(known, of)}")
    places, arrays = functions.flat(functions.zeros())

    def function(*values: jax.Array) -> list[jax.Array]:
        return [functions.as_written(families[name], *functions.by_kind(places, values))[name]]

    program = scalarize(function, *arrays)
    if rest:
        (nodes,) = program.outputs
        entries, wanted = _entries(name, nodes.shape), of.replace(" ", "").replace(",", ", ")
        if wanted not in entries:
            raise InputError(f"explain: {name} has no entry {of!r}; it has: {entries[0]} to {entries[-1]}")
        program = program.restricted([nodes.reshape(-1)[[entries.index(wanted)]]])
    inputs = {
        node: entry
        for (_, argument), nodes in zip(places, program.inputs, strict=True)
        for node, entry in zip(nodes.reshape(-1).tolist(), _entries(argument, nodes.shape), strict=True)
    }
    reads = [inputs[i] for i in program.live if i in inputs]
    value = program.graph.numbers[program.flat[0]] if len(program.flat) == 1 else None
    return Dependence(of, reads, program.counts(), value)


def count_equations(jaxpr: Any) -> int:
    """The number of equations of a jaxpr, including inner ones and excluding calls."""
    return sum(not inner_jaxprs(equation) for equation in all_equations(jaxpr))


def _unused(functions: Functions) -> list[str]:
    """A line for each control or parameter that no rate needs."""
    by_rates, by_any = functions.reads["rates"], set().union(*functions.reads.values())
    unused = [leaf for leaf in (*functions.controls, *functions.parameters) if leaf.name not in by_rates]
    return [
        f"{type(leaf).__name__} {leaf.name!r} is not used"
        + (" by any rate" if leaf.name in by_any else ": nothing depends on it")
        for leaf in unused
    ]


def _entries(name: str, shape: tuple[int, ...]) -> list[str]:
    """The names of all entries of an array: V[0], g[0, 3]; the name alone where there is one entry."""
    return [f"{name}[{', '.join(map(str, index))}]" for index in np.ndindex(*shape)] if shape else [name]


def _written_nodes(roots: Sequence[Expr]) -> int:
    """The number of nodes of the written trees: shared parts count each time."""
    sizes: dict[int, int] = {}
    for node in postorder(*roots):
        sizes[id(node)] = 1 + sum(sizes[id(child)] for child in node.children())
    return sum(sizes[id(root)] for root in roots)


def _jaxpr(roots: Sequence[Expr], dtype: Any) -> Any:
    """The jaxpr of the roots in arrays, as a function of all leaves that they read."""
    leaves = {leaf.key(): leaf for leaf in leaves_of(*roots) if not isinstance(leaf, Constant)}
    inputs = Inputs(jnp.zeros((), dtype), {}, {}, {}, dtype)

    def function(values: dict[str, jax.Array]) -> list[jax.Array]:
        return evaluate_all(roots, lambda leaf: values[leaf.key()] if leaf.key() in leaves else leaf.read(inputs))

    shapes = {key: jax.ShapeDtypeStruct(leaf.shape, dtype) for key, leaf in leaves.items()}
    return jax.make_jaxpr(function)(shapes).jaxpr
