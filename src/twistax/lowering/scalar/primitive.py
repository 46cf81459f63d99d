"""The JAX primitive of a scalar program: one equation, whose derivatives are scalar programs again."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from ..small_call import inside_small_call, small_call
from .derivatives import cotangent_program, is_real, tangent_program
from .emitter import as_function
from .program import ScalarProgram

__all__ = ["Derived", "call_program", "program_p"]


#: Of each result of a program.
Shapes: TypeAlias = "list[tuple[tuple[int, ...], np.dtype[Any]]]"


class Derived:
    """A program with its derivatives, each made when it first runs. Compared and hashed by identity.

    Args:
        program: the program; or what makes it, with the shapes and types of its results.
    """

    def __init__(self, program: ScalarProgram | Callable[[], ScalarProgram], results: Shapes | None = None) -> None:
        self._program = program
        self._results = results
        self._tangents: dict[tuple[int, ...], Derived] = {}
        self._cotangents: dict[tuple[int, ...], Derived] = {}
        #: Of a program made by `tangent`: which one it is a derivative of, and along which arguments.
        self.origin: tuple[Derived, tuple[int, ...]] | None = None

    @functools.cached_property
    def program(self) -> ScalarProgram:
        return self._program if isinstance(self._program, ScalarProgram) else self._program()

    @functools.cached_property
    def results(self) -> Shapes:
        if self._results is not None:
            return self._results
        return [(nodes.shape, dtype) for nodes, dtype in zip(self.program.outputs, self.program.types, strict=True)]

    @functools.cached_property
    def function(self) -> Any:
        return as_function(self.program)

    @property
    def real(self) -> list[int]:
        """The results that have derivatives."""
        return [k for k, (_, dtype) in enumerate(self.results) if is_real(dtype)]

    def tangent(self, active: tuple[int, ...]) -> Derived:
        if active not in self._tangents:
            # Made when it runs: what is only transposed need not have a forward derivative at all.
            found = Derived(lambda: tangent_program(self.program, active), [self.results[k] for k in self.real])
            found.origin = (self, active)
            self._tangents[active] = found
        return self._tangents[active]

    def cotangent(self, active: tuple[int, ...]) -> Derived:
        if active not in self._cotangents:
            self._cotangents[active] = Derived(cotangent_program(self.program, active))
        return self._cotangents[active]


program_p = Primitive("scalar_program")
program_p.multiple_results = True


def call_program(derived: Derived, *arguments: jax.Array) -> list[jax.Array]:
    """The results of a program; differentiable and batched as any JAX function."""
    return _bind(derived, 0, *arguments)


def _bind(derived: Derived, depth: int, *arguments: Any) -> list[Any]:
    # A loop that is compiled as one small function needs no other one inside.
    return program_p.bind(*arguments, derived=derived, depth=depth, inside=inside_small_call())


def _run(*arguments: Any, derived: Derived, depth: int, inside: bool) -> list[jax.Array]:
    """On the CPU: body after body, each loop compiled as one function."""
    if depth == 0:
        if inside or not any(jnp.size(a) for a in arguments):
            return derived.function(*arguments)
        return small_call(derived.function, *arguments)
    shape = jnp.shape(arguments[0])[:depth]
    flat = [jnp.reshape(a, (math.prod(shape), *jnp.shape(a)[depth:])) for a in arguments]
    if not any(jnp.size(a) for a in arguments):
        return _run_wide(*arguments, derived=derived, depth=depth, inside=inside)

    def each(*flat: jax.Array) -> list[jax.Array]:
        return jax.lax.map(lambda row: derived.function(*row), flat)

    return [jnp.reshape(r, (*shape, *r.shape[1:])) for r in small_call(each, *flat)]


def _run_wide(*arguments: Any, derived: Derived, depth: int, inside: bool) -> list[jax.Array]:
    """On accelerators: all bodies at once."""
    function = derived.function
    for _ in range(depth):
        function = jax.vmap(function)
    return function(*arguments)


def _abstract(*arguments: Any, derived: Derived, depth: int, inside: bool) -> list[Any]:
    batch = np.shape(arguments[0])[:depth] if arguments else ()
    return [jax.core.ShapedArray((*batch, *shape), dtype) for shape, dtype in derived.results]


def _jvp(
    primals: Sequence[Any], tangents: Sequence[Any], *, derived: Derived, depth: int, inside: bool
) -> tuple[list[Any], list[Any]]:
    results = _bind(derived, depth, *primals)
    active = tuple(k for k, t in enumerate(tangents) if type(t) is not ad.Zero)
    moved = iter(_bind(derived.tangent(active), depth, *primals, *(tangents[k] for k in active)))
    real = set(derived.real)
    return results, [
        next(moved) if k in real else ad.Zero(jax.typeof(r).to_tangent_aval()) for k, r in enumerate(results)
    ]


def _transpose(cotangents: Sequence[Any], *arguments: Any, derived: Derived, depth: int, inside: bool) -> list[Any]:
    if derived.origin is None:
        raise NotImplementedError("only the derivative of a scalar program is linear")
    origin, active = derived.origin
    count = len(arguments) - len(active)
    given = [ad.instantiate_zeros(c) for c in cotangents]
    linear = [k for k, a in enumerate(arguments[count:]) if ad.is_undefined_primal(a)]
    back = origin.cotangent(tuple(active[k] for k in linear))
    result: list[Any] = [None] * len(arguments)
    for k, value in zip(linear, _bind(back, depth, *arguments[:count], *given), strict=True):
        result[count + k] = value
    return result


def _batched(
    arguments: Sequence[Any], axes: Sequence[Any], *, derived: Derived, depth: int, inside: bool
) -> tuple[list[Any], list[int]]:
    size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
    moved = [
        jnp.broadcast_to(a, (size, *jnp.shape(a))) if d is None else jnp.moveaxis(a, d, 0)
        for a, d in zip(arguments, axes, strict=True)
    ]
    results = program_p.bind(*moved, derived=derived, depth=depth + 1, inside=False)
    return results, [0] * len(results)


program_p.def_impl(jax.jit(_run, static_argnames=("derived", "depth", "inside")))
program_p.def_abstract_eval(_abstract)
ad.primitive_jvps[program_p] = _jvp
ad.primitive_transposes[program_p] = _transpose
batching.primitive_batchers[program_p] = _batched
mlir.register_lowering(program_p, mlir.lower_fun(_run_wide, multiple_results=True))
mlir.register_lowering(program_p, mlir.lower_fun(_run, multiple_results=True), platform="cpu")
