"""The functions of a compiled system as scalar programs that call nothing, for writers of other languages."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...expr import Inputs, Leaf
from ..functions import Functions
from ..scalar.graph import Limits
from ..scalar.program import ScalarProgram, emitted_form, scalarize

__all__ = ["ExportedFunction", "Exporter", "Port"]

#: LU with pivots is unrolled up to the size that Cholesky is.
_LIMITS = Limits(pivoted=12, table=256, equations=100_000)


@dataclasses.dataclass(frozen=True)
class Port:
    """An array that goes into a function or comes out of it.

    Attributes:
        kind: "t", "x", "u" or "p" of arguments; "rate", "output", "constraint" or "jacobian" of results.
        name: of the leaf or the result; empty for the time.
        shape: of the array.
    """

    kind: str
    name: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        size = 1
        for n in self.shape:
            size *= n
        return size


@dataclasses.dataclass(frozen=True)
class ExportedFunction:
    """One function.

    Attributes:
        name: "rates", "outputs", "constraints" or "jacobian".
        results: what it gives, in order; empty arrays are left out.
        program: from all arguments, in order, to the results; without calls.
        arrays: the same in JAX arrays, not by way of scalars: what references are computed with.
    """

    name: str
    results: tuple[Port, ...]
    program: ScalarProgram
    arrays: Callable[..., list[jax.Array]]


class Exporter:
    """The functions of a compiled system in one precision, whatever JAX's x64 switch says.

    Arguments of all of them are the time, the states, the controls and the parameters, in the order of declaration.

    Args:
        dynamics: those of the compiled system.
        dtype: float64 or float32.
        checked: as of `tx.XLA`: keep 0 x, 0 / x and x - x, which differ from zero where x is not finite.
    """

    def __init__(self, dynamics: Functions, dtype: Any, checked: bool = False) -> None:
        self.dynamics = dynamics
        self.dtype, self.checked = np.dtype(dtype), checked
        self.leaves: dict[str, tuple[Leaf, ...]] = {
            "x": dynamics.states,
            "u": dynamics.controls,
            "p": dynamics.parameters,
        }
        self.arguments = (
            Port("t", "", ()),
            *(Port(kind, leaf.name, leaf.shape) for kind, leaves in self.leaves.items() for leaf in leaves),
        )

    def family(self, name: str) -> ExportedFunction:
        """Rates, outputs or constraints.

        Raises:
            ModelError: a part has no form in scalars, or the program is too large.
        """
        kind = {"rates": "rate", "outputs": "output", "constraints": "constraint"}[name]

        def arrays(*values: jax.Array) -> list[jax.Array]:
            return list(self._by_name(name, *values).values())

        names: list[str] = []

        def traced(*values: jax.Array) -> list[jax.Array]:
            found = self._by_name(name, *values)
            names.extend(found)  # here, because JAX would hand them back sorted
            return list(found.values())

        with self.precision():
            closed = jax.make_jaxpr(traced)(*self._shapes())
            program = self._alone(name, scalarize(closed, checked=self.checked))
        ports = [Port(kind, own, nodes.shape) for own, nodes in zip(names, program.outputs, strict=True)]
        return _without_empty(ExportedFunction(name, tuple(ports), program, arrays))

    def jacobian(self, wrt: Sequence[str]) -> ExportedFunction:
        """The derivatives of the rates in the tangent space, a matrix (n, m) for each of "x", "u", "params" in wrt.

        Raises:
            ModelError: a part has no form in scalars, or the program is too large.
            InputError: another entry in wrt.
        """
        with self.precision():
            found, _ = self.dynamics.rate_jacobian(
                self._inputs(jnp.zeros(p.shape, self.dtype) for p in self.arguments), tuple(wrt)
            )
            program = self._alone("jacobian", found.program)
        ports = [Port("jacobian", kind, block.shape) for kind, block in found.blocks.items()]

        def arrays(*values: jax.Array) -> list[jax.Array]:
            return _reference_jacobian(self, wrt, values)

        return _without_empty(ExportedFunction("jacobian", tuple(ports), program, arrays))

    def precision(self) -> Any:
        """A context in which JAX works in this precision."""
        return jax.enable_x64(self.dtype == np.float64)

    def _shapes(self) -> list[jax.ShapeDtypeStruct]:
        return [jax.ShapeDtypeStruct(port.shape, self.dtype) for port in self.arguments]

    def _inputs(self, values: Any) -> Inputs:
        t, *rest = values
        given: dict[str, dict[str, jax.Array]] = {"x": {}, "u": {}, "p": {}}
        for port, value in zip(self.arguments[1:], rest, strict=True):
            given[port.kind][port.name] = value
        return Inputs(t, given["x"], given["u"], given["p"], t.dtype)

    def _by_name(self, family: str, *values: jax.Array) -> dict[str, jax.Array]:
        given = self._inputs(values)
        return self.dynamics.as_written(family, given.t, dict(given.x), dict(given.u), dict(given.params))

    def _alone(self, name: str, program: ScalarProgram) -> ScalarProgram:
        """The program with every call unrolled."""
        form = emitted_form(program, limits=_LIMITS)
        if form.calls:
            unread = sorted({e.primitive.name for call in form.calls for e in call.jaxpr.jaxpr.eqns})
            raise ModelError(
                f"the {name} call {', '.join(unread)}, which {'has' if len(unread) == 1 else 'have'} no form in "
                "scalars.\n  fix: bake the parameters it works on, write it with other nodes, or leave this function "
                f"out; solves are unrolled up to {_LIMITS.pivoted} x {_LIMITS.pivoted}, tables up to "
                f"{_LIMITS.table} places"
            )
        return form


def _without_empty(function: ExportedFunction) -> ExportedFunction:
    """The function without results that have no entry."""
    kept = [k for k, port in enumerate(function.results) if port.size]
    program = function.program.restricted([function.program.outputs[k] for k in kept])

    def arrays(*values: jax.Array) -> list[jax.Array]:
        found = function.arrays(*values)
        return [found[k] for k in kept]

    return ExportedFunction(function.name, tuple(function.results[k] for k in kept), program, arrays)


def _reference_jacobian(exporter: Exporter, wrt: Sequence[str], values: Sequence[jax.Array]) -> list[jax.Array]:
    """The same derivatives by JAX, on arrays."""
    dynamics, given = exporter.dynamics, exporter._inputs(values)

    def rates(x: dict[str, jax.Array], u: dict[str, jax.Array], params: dict[str, jax.Array]) -> jax.Array:
        found = dynamics.as_written("rates", given.t, x, u, params)
        return jnp.concatenate([found[state.name].reshape(-1) for state in dynamics.states])

    def moved(values: dict[str, jax.Array], d: jax.Array) -> dict[str, jax.Array]:
        result, start = {}, 0
        for name, value in values.items():
            result[name] = value + d[start : start + value.size].reshape(value.shape)
            start += value.size
        return result

    x, u, p = dict(given.x), dict(given.u), dict(given.params)
    along: dict[str, tuple[int, Callable[[jax.Array], jax.Array]]] = {
        "x": (dynamics.group.dimension, lambda d: rates(dynamics.group.retract(x, d), u, p)),
        "u": (sum(v.size for v in u.values()), lambda d: rates(x, moved(u, d), p)),
        "params": (sum(v.size for v in p.values()), lambda d: rates(x, u, moved(p, d))),
    }
    return [jax.jacfwd(function)(jnp.zeros(n, given.dtype)) for n, function in (along[kind] for kind in wrt)]
