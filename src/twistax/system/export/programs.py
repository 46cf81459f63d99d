"""The functions of a compiled system as scalar programs without calls, for export to other languages."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...expr import Inputs
from ...scalar.program import ScalarProgram, called_names
from ...scalar.reader import emitted_form, scalarize
from ..functions import Functions
from ..jacobian import blocks_in_arrays
from .control_flow import LIMITS, foreign_calls

#: Of steps with which references are computed, in units of time.
TEST_STEP = 2.0**-7


@dataclasses.dataclass(frozen=True)
class Port:
    """An array that is an argument or a result of a function."""

    #: "t", "x", "u", "params", "h" of arguments; "rate", "output", "constraint", "jacobian", "next" of results; of
    #: filters "P", the covariance, "z", a measured value, and "nis".
    kind: str
    name: str  # of the leaf or the result; empty for the time and the length of a step
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def by_value(self) -> bool:
        """Whether C passes it as a number, not as a pointer."""
        return self.kind in ("t", "h")


@dataclasses.dataclass(frozen=True)
class ExportedFunction:
    """One function."""

    name: str  # "rates", "outputs", "constraints", "jacobian" or "step"
    results: tuple[Port, ...]  # what it gives, in order; empty arrays are left out
    program: ScalarProgram  # from all arguments, in order, to the results; without calls
    arrays: Callable[..., list[jax.Array]]  # the same in JAX arrays: what references are computed with
    extra: tuple[Port, ...] = ()  # arguments after those of all functions
    trial: tuple[np.ndarray, ...] = ()  # of these, with which references are computed


class Exporter:
    """The functions of a compiled system in one precision, independent of JAX's x64 setting.

    Arguments of all of them are the time, the states, the controls and the parameters, in the order of declaration.
    `checked` is as for `tx.XLA`: 0 x, 0 / x and x - x, which differ from zero if x is not finite, are not simplified.
    Controls named in `without` are omitted. `loops` is whether the language has loops.
    """

    def __init__(
        self,
        dynamics: Functions,
        dtype: Any,
        checked: bool = False,
        without: Collection[str] = (),
        loops: bool = False,
    ) -> None:
        self.dynamics, self.dtype, self.checked, self.loops = dynamics, np.dtype(dtype), checked, loops
        controls = [control for control in dynamics.controls if control.name not in without]
        leaves = {"x": dynamics.states, "u": controls, "params": dynamics.parameters}
        ports = [Port(kind, leaf.name, leaf.shape) for kind, of_kind in leaves.items() for leaf in of_kind]
        self.arguments = (Port("t", "", ()), *ports)
        self._places = tuple((port.kind, port.name) for port in self.arguments)

    def family(self, name: str) -> ExportedFunction:
        """Rates, outputs or constraints.

        Raises:
            ModelError: a part has no scalar form, or the program is too large.
        """

        def arrays(*values: jax.Array) -> list[jax.Array]:
            return list(self.dynamics.as_written(name, *self.dynamics.by_kind(self._places, values)).values())

        with jax.enable_x64(self.dtype == np.float64):
            closed = jax.make_jaxpr(arrays)(*(jax.ShapeDtypeStruct(p.shape, self.dtype) for p in self.arguments))
            program = scalarize(closed, checked=self.checked)
            return exported(
                name, name.removesuffix("s"), list(self.dynamics.families[name]), program, arrays, self.loops
            )

    def jacobian(self, wrt: Sequence[str]) -> ExportedFunction:
        """The derivatives of the rates in the tangent space: a matrix (n, m) for each of "x", "u", "params" in wrt.

        Raises:
            ModelError: a part has no scalar form, or the program is too large.
            InputError: an unknown entry in wrt.
        """
        with jax.enable_x64(self.dtype == np.float64):
            zeros = [jnp.zeros(p.shape, self.dtype) for p in self.arguments]
            inputs = Inputs(*self.dynamics.by_kind(self._places, zeros), self.dtype)
            derivatives, _ = self.dynamics.rate_jacobian(inputs, tuple(wrt))
            rates = lambda *values: self.dynamics.flat_rates(self._places, *values)[0]  # noqa: E731

            def arrays(*values: jax.Array) -> list[jax.Array]:
                return list(blocks_in_arrays(rates, self.dynamics.group, self._places, wrt, values).values())

            return exported("jacobian", "jacobian", list(derivatives.blocks), derivatives.program, arrays, self.loops)

    def step(self, advance: Callable[..., Mapping[str, jax.Array]]) -> ExportedFunction:
        """The states after one step of length h with constant controls.

        Args:
            advance: a pure and traceable function of t, x, u, params and h.
        Raises:
            ModelError: the step has no scalar form, or the program is too large.
        """
        results = [Port("next", state.name, state.shape) for state in self.dynamics.states]
        by_result = lambda *values: [advance(*values)[port.name] for port in results]  # noqa: E731
        return self.function("step", results, by_result, {Port("h", "", ()): np.asarray(TEST_STEP)})

    def function(
        self,
        name: str,
        results: Sequence[Port],
        function: Callable[..., list[jax.Array]],
        extra: Mapping[Port, np.ndarray],
    ) -> ExportedFunction:
        """A function of t, x, u, params and additional arguments, which have values for the reference computation.

        Raises:
            ModelError: it has no scalar form, or the program is too large.
        """

        def arrays(*values: jax.Array) -> list[jax.Array]:
            count = len(self.arguments)
            return function(*self.dynamics.by_kind(self._places, values[:count]), *values[count:])

        with jax.enable_x64(self.dtype == np.float64):
            shaped = [jax.ShapeDtypeStruct(p.shape, self.dtype) for p in (*self.arguments, *extra)]
            program = scalarize(jax.make_jaxpr(arrays)(*shaped), checked=self.checked)
            exported_function = exported(name, "", [port.name for port in results], program, arrays, self.loops)
        kept = tuple(port for port, nodes in zip(results, program.outputs, strict=True) if nodes.size)
        return dataclasses.replace(exported_function, results=kept, extra=tuple(extra), trial=tuple(extra.values()))


def exported(
    name: str,
    kind: str,
    results: Sequence[str],
    program: ScalarProgram,
    arrays: Callable[..., list[jax.Array]],
    loops: bool = False,
) -> ExportedFunction:
    """A function with all calls inlined, without empty results; with `loops` loops and branches with loops stay."""
    form = emitted_form(program, limits=dataclasses.replace(LIMITS, functions=loops))
    if foreign := foreign_calls(form, loops):
        first = "an explicit method for steps, or " if name == "step" else ""
        raise ModelError(
            f"the {name} call {called_names(foreign)}, without a scalar form.\n  fix: {first}"
            "make the parameters that it reads constants by bake=, write it with other nodes, or leave this function "
            f"out; linear solves are unrolled up to {LIMITS.pivoted} x {LIMITS.pivoted}, tables up to {LIMITS.table} "
            "entries"
        )
    kept = [k for k, nodes in enumerate(form.outputs) if nodes.size]
    ports = tuple(Port(kind, results[k], form.outputs[k].shape) for k in kept)
    restricted = form.restricted([form.outputs[k] for k in kept])

    def present(*values: jax.Array) -> list[jax.Array]:
        results = arrays(*values)
        return [results[k] for k in kept]

    return ExportedFunction(name, ports, restricted, present)
