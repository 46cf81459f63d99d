"""The functions of a compiled system as scalar programs that call nothing, for writers of other languages."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...expr import Inputs
from ..functions import Functions
from ..scalar.graph import Limits
from ..scalar.program import ScalarProgram, emitted_form, scalarize

#: LU with pivots is unrolled up to the size that Cholesky is.
_LIMITS = Limits(pivoted=12, table=256, equations=100_000)


@dataclasses.dataclass(frozen=True)
class Port:
    """An array that goes into a function or comes out of it."""

    kind: str  # "t", "x", "u" or "p" of arguments; "rate", "output", "constraint" or "jacobian" of results
    name: str  # of the leaf or the result; empty for the time
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        return math.prod(self.shape)


@dataclasses.dataclass(frozen=True)
class ExportedFunction:
    """One function."""

    name: str  # "rates", "outputs", "constraints" or "jacobian"
    results: tuple[Port, ...]  # what it gives, in order; empty arrays are left out
    program: ScalarProgram  # from all arguments, in order, to the results; without calls
    arrays: Callable[..., list[jax.Array]]  # the same in JAX arrays: what references are computed with


class Exporter:
    """The functions of a compiled system in one precision, whatever JAX's x64 switch says.

    Arguments of all of them are the time, the states, the controls and the parameters, in the order of declaration.
    `checked` is as of `tx.XLA`: keep 0 x, 0 / x and x - x, which differ from zero where x is not finite.
    """

    def __init__(self, dynamics: Functions, dtype: Any, checked: bool = False) -> None:
        self.dynamics, self.dtype, self.checked = dynamics, np.dtype(dtype), checked
        leaves = {"x": dynamics.states, "u": dynamics.controls, "p": dynamics.parameters}
        ports = [Port(kind, leaf.name, leaf.shape) for kind, own in leaves.items() for leaf in own]
        self.arguments = (Port("t", "", ()), *ports)

    def family(self, name: str) -> ExportedFunction:
        """Rates, outputs or constraints.

        Raises:
            ModelError: a part has no form in scalars, or the program is too large.
        """

        def arrays(*values: jax.Array) -> list[jax.Array]:
            given = self._inputs(values)
            found = self.dynamics.as_written(name, given.t, dict(given.x), dict(given.u), dict(given.params))
            return list(found.values())

        with self._precision():
            closed = jax.make_jaxpr(arrays)(*(jax.ShapeDtypeStruct(p.shape, self.dtype) for p in self.arguments))
            program = scalarize(closed, checked=self.checked)
            return self._exported(name, name.removesuffix("s"), list(self.dynamics.families[name]), program, arrays)

    def jacobian(self, wrt: Sequence[str]) -> ExportedFunction:
        """The derivatives of the rates in the tangent space, a matrix (n, m) for each of "x", "u", "params" in wrt.

        Raises:
            ModelError: a part has no form in scalars, or the program is too large.
            InputError: another entry in wrt.
        """
        with self._precision():
            inputs = self._inputs(jnp.zeros(p.shape, self.dtype) for p in self.arguments)
            found, _ = self.dynamics.rate_jacobian(inputs, tuple(wrt))

            def arrays(*values: jax.Array) -> list[jax.Array]:
                return self._differentiated(wrt, self._inputs(values))

            return self._exported("jacobian", "jacobian", list(found.blocks), found.program, arrays)

    def _exported(
        self,
        name: str,
        kind: str,
        results: Sequence[str],
        program: ScalarProgram,
        arrays: Callable[..., list[jax.Array]],
    ) -> ExportedFunction:
        """A function with every call unrolled, without results that have no entry."""
        form = emitted_form(program, limits=_LIMITS)
        if form.calls:
            unread = sorted({e.primitive.name for call in form.calls for e in call.jaxpr.jaxpr.eqns})
            raise ModelError(
                f"the {name} call {', '.join(unread)}, which {'has' if len(unread) == 1 else 'have'} no form in "
                "scalars.\n  fix: bake the parameters it works on, write it with other nodes, or leave this function "
                f"out; solves are unrolled up to {_LIMITS.pivoted} x {_LIMITS.pivoted}, tables up to "
                f"{_LIMITS.table} places"
            )
        kept = [k for k, nodes in enumerate(form.outputs) if nodes.size]
        ports = tuple(Port(kind, results[k], form.outputs[k].shape) for k in kept)
        restricted = form.restricted([form.outputs[k] for k in kept])

        def present(*values: jax.Array) -> list[jax.Array]:
            found = arrays(*values)
            return [found[k] for k in kept]

        return ExportedFunction(name, ports, restricted, present)

    def _precision(self) -> Any:
        """A context in which JAX works in this precision."""
        return jax.enable_x64(self.dtype == np.float64)

    def _inputs(self, values: Iterable[Any]) -> Inputs:
        t, *rest = values
        given: dict[str, dict[str, jax.Array]] = {"x": {}, "u": {}, "p": {}}
        for port, value in zip(self.arguments[1:], rest, strict=True):
            given[port.kind][port.name] = value
        return Inputs(t, given["x"], given["u"], given["p"], t.dtype)

    def _differentiated(self, wrt: Sequence[str], given: Inputs) -> list[jax.Array]:
        """The same derivatives by JAX, on arrays."""
        group, states = self.dynamics.group, self.dynamics.states

        def rates(d: jax.Array, u: dict[str, jax.Array], params: dict[str, jax.Array]) -> jax.Array:
            found = self.dynamics.as_written("rates", given.t, group.retract(dict(given.x), d), u, params)
            return jnp.concatenate([found[state.name].reshape(-1) for state in states])

        zero = jnp.zeros(group.dimension, given.t.dtype)
        arguments: dict[str, Any] = {"x": zero, "u": dict(given.u), "params": dict(given.params)}
        found = []
        for kind in wrt:
            blocks = [jnp.zeros((zero.size, 0), zero.dtype)]
            if jax.tree.leaves(arguments[kind]):
                by = jax.jacfwd(rates, list(arguments).index(kind))(*arguments.values())
                columns = [by] if kind == "x" else [by[name] for name in arguments[kind]]
                blocks += [column.reshape(group.dimension, -1) for column in columns]
            found.append(jnp.concatenate(blocks, axis=1))
        return found
