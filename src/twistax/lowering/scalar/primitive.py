"""The JAX primitive of a scalar program: one equation, whose derivatives are scalar programs again."""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...jax_inside import Primitive, ad, batching, mlir, shaped_array
from ..small_call import apart, inside_small_call, small_call
from .derivatives import cotangent_program, is_real, tangent_program
from .emitter import as_function
from .program import ScalarProgram

__all__ = ["Derived", "Runner", "at_once", "call_program", "define", "native_p", "over_rows", "program_p"]


#: Of each result of a program.
Shapes: TypeAlias = "list[tuple[tuple[int, ...], np.dtype[Any]]]"


class Runner(ABC):
    """What runs programs on the CPU in another way than by XLA."""

    @abstractmethod
    def worthwhile(self, program: ScalarProgram, rows: int) -> bool:
        """Whether that is faster for so many bodies at once."""

    @abstractmethod
    def prepare(self, program: ScalarProgram, single: bool) -> Callable[..., list[jax.Array]] | None:
        """The program as a function of the number of rows and of arguments (rows, *shape); None: XLA runs it.

        Args:
            single: for one row; else for many. Asked once for each program.
        """


class Derived:
    """A program with its derivatives, each made when it first runs. Compared and hashed by identity.

    Args:
        program: the program; or what makes it, with the shapes and types of its results.
        runner: what runs it and its derivatives on the CPU; XLA if None.
    """

    def __init__(
        self,
        program: ScalarProgram | Callable[[], ScalarProgram],
        results: Shapes | None = None,
        runner: Runner | None = None,
    ) -> None:
        self._program = program
        self.runner = runner
        self._results = results
        self._tangents: dict[tuple[int, ...], Derived] = {}
        self._cotangents: dict[tuple[int, ...], Derived] = {}
        self._prepared: dict[bool, Callable[..., list[jax.Array]] | None] = {}
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

    @functools.cached_property
    def on_cpu(self) -> Any:
        return as_function(self.program, apart)

    def native(self, rows: int) -> Callable[..., list[jax.Array]] | None:
        """What the runner runs for so many rows; None: XLA runs it."""
        if self.runner is None or not self.runner.worthwhile(self.program, rows):
            return None
        single = rows == 1
        if single not in self._prepared:
            self._prepared[single] = self.runner.prepare(self.program, single)
        return self._prepared[single]

    @property
    def real(self) -> list[int]:
        """The results that have derivatives."""
        return [k for k, (_, dtype) in enumerate(self.results) if is_real(dtype)]

    def tangent(self, active: tuple[int, ...]) -> Derived:
        if active not in self._tangents:
            # Made when it runs: what is only transposed need not have a forward derivative at all.
            results = [self.results[k] for k in self.real]
            found = Derived(lambda: tangent_program(self.program, active), results, self.runner)
            found.origin = (self, active)
            self._tangents[active] = found
        return self._tangents[active]

    def cotangent(self, active: tuple[int, ...]) -> Derived:
        if active not in self._cotangents:
            self._cotangents[active] = Derived(cotangent_program(self.program, active), None, self.runner)
        return self._cotangents[active]


#: A program that XLA runs; it may be part of a small call.
program_p = Primitive("scalar_program")
#: One that a runner runs where that is faster. Under a name of its own: it must not become part of a small call.
native_p = Primitive("native_program")


def call_program(derived: Derived, *arguments: jax.Array) -> list[jax.Array]:
    """The results of a program; differentiable and batched as any JAX function."""
    return _bind(derived, 0, *arguments)


def _bind(derived: Derived, depth: int, *arguments: Any) -> list[Any]:
    # A loop that is compiled as one small function needs no other one inside.
    inside = inside_small_call()
    primitive = program_p if inside or derived.runner is None else native_p
    return primitive.bind(*arguments, derived=derived, depth=depth, inside=inside)


def over_rows(function: Callable[..., list[jax.Array]], arguments: Sequence[Any], depth: int) -> list[jax.Array]:
    """function(rows, *arguments) of arguments whose first `depth` axes are bodies, made one axis for it."""
    shape = jnp.shape(arguments[0])[:depth] if arguments else ()
    rows = math.prod(shape)
    found = function(rows, *(jnp.reshape(a, (rows, *jnp.shape(a)[depth:])) for a in arguments))
    return [jnp.reshape(r, (*shape, *r.shape[1:])) for r in found]


def at_once(function: Callable[..., list[jax.Array]], arguments: Sequence[Any], depth: int) -> list[jax.Array]:
    """A function of one body for all of them, as accelerators do."""
    for _ in range(depth):
        function = jax.vmap(function)
    return function(*arguments)


def _run(*arguments: Any, derived: Derived, depth: int, inside: bool) -> list[jax.Array]:
    """On the CPU: body after body, each loop compiled as one function."""
    empty = not any(jnp.size(a) for a in arguments)
    if depth == 0:
        return derived.on_cpu(*arguments) if inside or empty else small_call(derived.on_cpu, *arguments)
    if empty:
        return _run_wide(*arguments, derived=derived, depth=depth, inside=inside)

    def each(*flat: jax.Array) -> list[jax.Array]:
        return jax.lax.map(lambda row: derived.on_cpu(*row), flat)

    return over_rows(lambda rows, *flat: small_call(each, *flat), arguments, depth)


def _run_native(*arguments: Any, derived: Derived, depth: int, inside: bool) -> list[jax.Array]:
    """On the CPU, by the runner; where it does not, by XLA."""
    rows = math.prod(jnp.shape(arguments[0])[:depth] if arguments else ())
    native = derived.native(rows) if rows else None
    if native is None:
        return _run(*arguments, derived=derived, depth=depth, inside=inside)
    return over_rows(native, arguments, depth)


def _run_wide(*arguments: Any, derived: Derived, depth: int, inside: bool) -> list[jax.Array]:
    """On accelerators."""
    return at_once(derived.function, arguments, depth)


def _abstract(*arguments: Any, derived: Derived, depth: int, inside: bool) -> list[Any]:
    batch = np.shape(arguments[0])[:depth] if arguments else ()
    return [shaped_array((*batch, *shape), dtype) for shape, dtype in derived.results]


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


def define(
    primitive: Primitive,
    parameters: Sequence[str],
    abstract: Callable[..., list[Any]],
    on_cpu: Callable[..., list[jax.Array]],
    elsewhere: Callable[..., list[jax.Array]],
    **batched: Any,
) -> None:
    """Tell JAX what a primitive with results for many bodies does; its parameter `depth` counts the axes of bodies.

    Args:
        parameters: their names.
        batched: those that change inside of a batch.
    """

    @functools.partial(jax.jit, static_argnames=tuple(parameters))
    def compiled(*arguments: jax.Array, **own: Any) -> list[jax.Array]:
        return primitive.bind(*arguments, **own)

    def evaluate(*arguments: jax.Array, **own: Any) -> list[jax.Array]:
        # As every operation of JAX: compiled also where functions are not.
        with jax.disable_jit(False):
            return compiled(*arguments, **own)

    def batch(arguments: Sequence[Any], axes: Sequence[Any], **own: Any) -> tuple[list[Any], list[int]]:
        size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
        moved = [batching.bdim_at_front(a, d, size) for a, d in zip(arguments, axes, strict=True)]
        results = primitive.bind(*moved, **{**own, **batched, "depth": own["depth"] + 1})
        return results, [0] * len(results)

    primitive.multiple_results = True
    primitive.def_impl(evaluate)
    primitive.def_abstract_eval(abstract)
    batching.primitive_batchers[primitive] = batch
    mlir.register_lowering(primitive, mlir.lower_fun(elsewhere, multiple_results=True))
    mlir.register_lowering(primitive, mlir.lower_fun(on_cpu, multiple_results=True), platform="cpu")


for _primitive, _on_cpu in ((program_p, _run), (native_p, _run_native)):
    define(_primitive, ("derived", "depth", "inside"), _abstract, _on_cpu, _run_wide, inside=False)
    ad.primitive_jvps[_primitive] = _jvp
    ad.primitive_transposes[_primitive] = _transpose
