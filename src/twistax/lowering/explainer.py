"""Finds what `Dynamics.explain` tells."""

from __future__ import annotations

import functools
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..expr import Constant, Expr, Inputs, evaluate_all, leaves_of
from .explain import Dependence, Explanation, count_equations, distinct_nodes, entry_names, written_nodes
from .scalar.program import scalarize
from .work import array_operations

if TYPE_CHECKING:
    from .dynamics import Dynamics

__all__ = ["Explainer"]


class Explainer:
    """Reads a compiled system; JAX's default precision stands for that of its arguments."""

    def __init__(self, dynamics: Any) -> None:
        self.dynamics: Dynamics = dynamics
        own = {leaf.name: np.zeros(leaf.shape) for leaf in (*dynamics.states, *dynamics.controls, *dynamics.parameters)}
        read = self._read(dynamics.families)
        self._shapes = {name: expr.shape for family in ("rates", "outputs") for name, expr in self._of(family)}
        x = {state.name: own[state.name] for state in dynamics.states}
        u = {control.name: own[control.name] for control in dynamics.controls if control.name in read}
        params = {p.name: own[p.name] for p in dynamics.parameters if p.name in read}
        self.inputs: Inputs = dynamics.prepare(0.0, x, u, params, reads=())

    def everything(self) -> Explanation:
        """Of all rates."""
        dynamics, inputs = self.dynamics, self.inputs
        kinds = (("states", dynamics.states), ("controls", dynamics.controls), ("parameters", dynamics.parameters))
        simplified, written = [expr for _, expr in self._of("rates")], list(dynamics.system.rates.values())
        jacobian, _ = dynamics.rate_jacobian(inputs, ("x", "u", "params"))
        rates = jacobian.rates
        entries = [name for state in dynamics.states for name in entry_names(state.name, self._shapes[state.name])]
        numbers = [rates.graph.numbers[i] for i in rates.flat]
        before, after = self._jaxpr(written), self._jaxpr(simplified)
        leaves, structure = jax.tree.flatten((inputs.t, inputs.x, inputs.u, inputs.params))
        emission, _ = dynamics.emission("rates", structure, tuple((a.shape, a.dtype) for a in leaves))
        start = time.perf_counter()
        called = functools.partial(dynamics.evaluate, "rates", in_loop=False)
        jax.jit(called).lower(inputs.t, inputs.x, inputs.u, inputs.params).compile()
        return Explanation(
            leaves={kind: [leaf.name for leaf in own] for kind, own in kinds},
            unused=self._unused(),
            baked=list(dynamics.baked),
            nodes=(written_nodes(written), distinct_nodes(simplified)),
            equations=(count_equations(before), count_equations(after)),
            operations=(dict(sorted(array_operations(before).items())), rates.counts()),
            constants={name: n for name, n in zip(entries, numbers, strict=True) if n is not None},
            patterns=jacobian.pattern,
            backend=emission.reason,
            compile_seconds=time.perf_counter() - start,
        )

    def one(self, of: str) -> Dependence:
        """Of one rate or output, or an entry of it."""
        name, _, rest = of.partition("[")
        if name not in self._shapes:
            raise InputError(f"explain expects a rate or an output, got {of!r}; there are: {', '.join(self._shapes)}")
        family = "rates" if name in self.dynamics.families["rates"] else "outputs"
        inputs = self.inputs
        arrays = {"t": inputs.t, **inputs.x, **inputs.u, **inputs.params}

        def function(*values: jax.Array) -> list[jax.Array]:
            at = dict(zip(arrays, values, strict=True))
            groups = [{key: at[key] for key in group} for group in (inputs.x, inputs.u, inputs.params)]
            return [self.dynamics.as_written(family, at["t"], *groups)[name]]

        program = scalarize(function, *(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arrays.values()))
        if rest:
            entries = entry_names(name, self._shapes[name])
            wanted = of.replace(" ", "").replace(",", ", ")
            if wanted not in entries:
                raise InputError(f"{name} has no entry {of!r}; it has {entries[0]} to {entries[-1]}")
            (nodes,) = program.outputs
            program = program.restricted([nodes.reshape(-1)[[entries.index(wanted)]]])
        return Dependence.of(of, program, list(arrays))

    def _of(self, family: str) -> list[tuple[str, Expr]]:
        """The expressions of a family of which each name has one."""
        return [(name, expr) for name, (expr,) in self.dynamics.families[family].items()]

    def _read(self, families: Iterable[str]) -> set[str]:
        """The names that any of the families reads."""
        return set().union(*(self.dynamics.reads[family] for family in families))

    def _unused(self) -> list[str]:
        """A line for each control or parameter that no rate needs."""
        lines = []
        by_rates, by_any = self._read(["rates"]), self._read(self.dynamics.families)
        for leaf in (*self.dynamics.controls, *self.dynamics.parameters):
            kind = type(leaf).__name__
            if leaf.name not in by_any:
                lines.append(f"{kind} {leaf.name!r} is not used: nothing depends on it")
            elif leaf.name not in by_rates:
                lines.append(f"{kind} {leaf.name!r} is not used by any rate")
        return lines

    def _jaxpr(self, roots: list[Expr]) -> Any:
        """What the roots amount to in arrays, of all leaves that they read."""
        dtype = self.inputs.dtype
        leaves = {leaf.key(): leaf for leaf in leaves_of(*roots) if not isinstance(leaf, Constant)}
        inputs = Inputs(jnp.zeros((), dtype), {}, {}, {}, dtype)

        def function(values: dict[str, jax.Array]) -> list[jax.Array]:
            return evaluate_all(roots, lambda leaf: values[leaf.key()] if leaf.key() in leaves else leaf.read(inputs))

        shapes = {key: jax.ShapeDtypeStruct(leaf.shape, dtype) for key, leaf in leaves.items()}
        return jax.make_jaxpr(function)(shapes).jaxpr
