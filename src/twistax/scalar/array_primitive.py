"""A function of arrays as one equation of JAX, inside of which array types carry no mesh information."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import (
    ClosedJaxpr,
    Primitive,
    drops_dead_results,
    jaxpr_as_fun,
    of_one_device,
    spread,
    weakly_kept,
    with_results,
)
from .jax_primitive import Differentiable, Shapes, call_program, differentiable
from .program import Rows

Result = TypeVar("Result")


@weakly_kept
class ArrayProgram(Differentiable):
    """A function of arrays that JAX executes, with JAX's derivatives.

    Args:
        program: the function, of plain arrays.
    """

    def __init__(self, program: ClosedJaxpr) -> None:
        super().__init__()
        self.program = program
        self._parts: dict[tuple[bool, ...], ArrayProgram] = {}

    @property
    def results(self) -> Shapes:
        return [(v.aval.shape, np.dtype(v.aval.dtype)) for v in self.program.jaxpr.outvars]

    @property
    def real(self) -> list[int]:
        """All inexact results, complex ones too."""
        return [k for k, (_, dtype) in enumerate(self.results) if jnp.issubdtype(dtype, jnp.inexact)]

    @functools.cached_property
    def function(self) -> Callable[..., list[jax.Array]]:
        run = jaxpr_as_fun(self.program)
        return lambda *a: [jnp.asarray(value) for value in run(*a)]

    def primitive(self, inside: bool) -> Primitive:
        return _array_program_p

    def kernel(self, rows: int, platform: str) -> Rows | None:
        return None

    def made(self, program: ClosedJaxpr) -> ArrayProgram:
        """A derived function of the same class."""
        return ArrayProgram(program)

    def with_results(self, used: tuple[bool, ...]) -> ArrayProgram:
        """The function that computes only the results that are used, of the same arguments."""
        if used not in self._parts:
            self._parts[used] = self.made(with_results(self.program, used))
        return self._parts[used]

    def _tangent(self, active: tuple[int, ...]) -> ArrayProgram:
        def tangent(arguments: list[Any], tangents: list[Any]) -> list[Any]:
            return list(jax.jvp(self._of(active, arguments), [arguments[k] for k in active], tangents)[1])

        return self._derivative(tangent, [self.program.jaxpr.invars[k].aval for k in active])

    def _cotangent(self, active: tuple[int, ...]) -> ArrayProgram:
        def cotangent(arguments: list[Any], cotangents: list[Any]) -> list[Any]:
            return list(jax.vjp(self._of(active, arguments), *(arguments[k] for k in active))[1](cotangents))

        return self._derivative(cotangent, [jax.ShapeDtypeStruct(*self.results[k]) for k in self.real])

    def transposed(self, linear: tuple[int, ...]) -> ArrayProgram:
        def back(arguments: list[Any], cotangents: list[Any]) -> list[Any]:
            shapes = [jax.ShapeDtypeStruct(arguments[k].shape, arguments[k].dtype) for k in linear]
            return list(jax.linear_transpose(self._of(linear, arguments), *shapes)(cotangents))

        return self._derivative(back, [jax.ShapeDtypeStruct(*self.results[k]) for k in self.real])

    def _of(self, active: tuple[int, ...], arguments: Sequence[Any]) -> Callable[..., list[jax.Array]]:
        """The real results as a function of some of the arguments."""

        def function(*given_values: jax.Array) -> list[jax.Array]:
            merged = list(arguments)
            for k, value in zip(active, given_values, strict=True):
                merged[k] = value
            results = self.function(*merged)
            return [results[k] for k in self.real]

        return function

    def _derivative(self, derivative: Callable[[list[Any], list[Any]], list[Any]], more: Sequence[Any]) -> ArrayProgram:
        avals: list[Any] = [v.aval for v in self.program.jaxpr.invars]
        count = len(avals)
        shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in [*avals, *more]]
        with of_one_device():
            closed = jax.make_jaxpr(lambda *values: derivative(list(values[:count]), list(values[count:])))(*shapes)
        return self.made(closed)


#: From the number of members of a batch and a platform to a kernel; None: JAX runs the function.
Kernels: TypeAlias = "Callable[[int, str], Rows | None]"


@weakly_kept
class KernelOfArrays(ArrayProgram):
    """A function of arrays, with kernels for it if there are any.

    Args:
        program: the function.
        make: makes the kernels of a jaxpr; None: it has no native form.
        alone: whether one member alone is a kernel too.

    Attributes:
        inside_kernels: of a function without derivatives that stays a call in scalar programs: what writes it in their
            kernels; None: it is unrolled there.
    """

    inside_kernels: Any = None

    def __init__(
        self, program: ClosedJaxpr, make: Callable[[ClosedJaxpr], Kernels | None], *, alone: bool = False
    ) -> None:
        super().__init__(program)
        self._make, self._alone = make, alone
        self.exports_kernels = alone

    @functools.cached_property
    def kernels(self) -> Kernels | None:
        """What makes its kernels; None: JAX runs it."""
        return self._make(self.program)

    def primitive(self, inside: bool) -> Primitive:
        return _batched_p

    def kernel(self, rows: int, platform: str) -> Rows | None:
        # One member alone is not read as scalars, which takes longer than XLA takes to compile it.
        return None if (rows == 1 and not self._alone) or self.kernels is None else self.kernels(rows, platform)

    def made(self, program: ClosedJaxpr) -> KernelOfArrays:
        return KernelOfArrays(program, self._make, alone=self._alone)


#: A function, or one that runs in parts.
_array_program_p = Primitive("whole_function")
#: A function that is a kernel in batches. Under a name of its own: it may be part of scalar programs.
_batched_p = Primitive("batched_function")
for _primitive in (_array_program_p, _batched_p):
    differentiable(_primitive)


def _dead_code(used: Sequence[bool], eqn: Any) -> tuple[list[bool], Any]:
    """JAX's rule for results that nothing reads: kernels do not compute them."""
    if not any(used):
        return [False] * len(eqn.invars), None
    if not all(used):
        program = eqn.params["program"].with_results(tuple(used))
        eqn = eqn.replace(
            outvars=[v for v, use in zip(eqn.outvars, used, strict=True) if use],
            params={**eqn.params, "program": program},
        )
    return [True] * len(eqn.invars), eqn


drops_dead_results(_batched_p, _dead_code)


def is_array_program(eqn: Any) -> bool:
    """Whether an equation of a jaxpr is a function that is executed in parts."""
    return eqn.primitive is _array_program_p


def written_out(eqn: Any) -> ClosedJaxpr | None:
    """The jaxpr of an equation that is a function of arrays, for one member; None for other equations."""
    is_function = eqn.primitive in (_array_program_p, _batched_p) and not eqn.params["batch"].depth
    return eqn.params["program"].program if is_function else None


def on_any_mesh(function: Callable[..., Result], *arguments: Any) -> Result:
    """The call function(*arguments), as one equation if the types of arrays have shardings over a mesh.

    Otherwise loops inside of the function would need these shardings too. It must not close over traced values.
    Arguments and result are pytrees of arrays.
    """
    leaves, structure = jax.tree.flatten(arguments)
    if not spread(leaves):
        return function(*arguments)
    structures: list[Any] = []

    def flat(*leaves: jax.Array) -> list[jax.Array]:  # JAX's caches must not hold what pytrees name
        results, shape = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
        structures.append(shape)
        return results

    with of_one_device():
        closed = jax.make_jaxpr(flat)(*(jax.ShapeDtypeStruct(jnp.shape(a), jnp.result_type(a)) for a in leaves))
    if closed.effects:
        return function(*arguments)
    result: Result = jax.tree.unflatten(structures[0], call_program(ArrayProgram(closed), *leaves))
    return result
