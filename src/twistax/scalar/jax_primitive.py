"""Compiled functions as primitives of JAX: batching, lowering, and scalar programs with their derivatives."""

from __future__ import annotations

import dataclasses
import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import (
    Primitive,
    ad,
    batching,
    by_one_device,
    is_shared_out,
    jet,
    mlir,
    needs_devices,
    on_axes,
    placed_as,
    shaped_array,
    shared_out,
    varying_alike,
    weakly_kept,
)
from .derivatives import cotangent_program, is_real, tangent_program
from .program import Batch, Rows, ScalarProgram
from .small_call import inside_small_call, not_inlined, small_call
from .targets.xla import as_function, without_barriers

#: Shape and type of each result of a program.
Shapes: TypeAlias = "list[tuple[tuple[int, ...], np.dtype[Any]]]"
#: The platforms of JAX with kernels. An equation is lowered for one of them.
PLATFORMS = ("cpu", "cuda")


class Runner(Protocol):
    """The interface for executing programs without XLA, for calls with enough operations."""

    @property
    def least(self) -> int: ...

    @property
    def alone(self) -> bool:
        """Whether it runs programs also inside of what could be one small function."""

    def prepare(self, program: ScalarProgram, single: bool, platform: str = "cpu") -> Rows | None:
        """A function that runs the program; None: XLA does. Called once for each program and platform.

        Args:
            single: for one row; else for many.
        """


class Computed(ABC):
    """The function of an equation. Compared and hashed by identity.

    Attributes:
        results: the shapes and types of the results.
        function: from arguments to results of one member; pure and traceable.
        exports_kernels: whether exported programs, too, call its kernels, by their names.
    """

    results: Any
    function: Any
    exports_kernels = True
    written_out = False

    def by_xla(self, arguments: Sequence[Any], batch: Batch, inside: bool, platform: str) -> list[jax.Array]:
        """The computation for XLA on a platform without a kernel, `inside` a small call or not."""
        return batch.each(self.function, arguments)

    @abstractmethod
    def kernel(self, rows: int, platform: str) -> Rows | None:
        """A function that runs a batch of that many members on a platform in place of XLA; None: there is none."""


class Differentiable(Computed):
    """The function of an equation with its derivatives, each built when it is first needed.

    Attributes:
        origin: of one made by `tangent`: which one it is a derivative of, and along which arguments.
    """

    def __init__(self) -> None:
        self._tangents: dict[tuple[int, ...], Differentiable] = {}
        self._cotangents: dict[tuple[int, ...], Differentiable] = {}
        self.origin: tuple[Differentiable, tuple[int, ...]] | None = None

    @abstractmethod
    def primitive(self, inside: bool) -> Primitive:
        """The primitive of JAX, `inside` a small call or not."""

    @abstractmethod
    def _tangent(self, active: tuple[int, ...]) -> Differentiable:
        """(arguments, tangents of the active ones) -> tangents of the real results."""

    @abstractmethod
    def _cotangent(self, active: tuple[int, ...]) -> Differentiable:
        """(arguments, cotangents of the real results) -> cotangents of the active arguments."""

    @property
    def real(self) -> list[int]:
        """The results that have derivatives."""
        return [k for k, (_, dtype) in enumerate(self.results) if is_real(dtype)]

    @abstractmethod
    def transposed(self, linear: tuple[int, ...]) -> Differentiable:
        """`cotangent` of a function that is linear in these arguments, whatever their values.

        Raises:
            NotImplementedError: it is not.
        """

    def tangent(self, active: tuple[int, ...]) -> Differentiable:
        if active not in self._tangents:
            derivative = self._tangents[active] = self._tangent(active)
            derivative.origin = (self, active)
        return self._tangents[active]

    def cotangent(self, active: tuple[int, ...]) -> Differentiable:
        if active not in self._cotangents:
            self._cotangents[active] = self._cotangent(active)
        return self._cotangents[active]


@weakly_kept
class Derived(Differentiable):
    """A program with its derivatives.

    Args:
        program: the program; or what makes it, with the shapes and types of its results.
        runner: what runs it and its derivatives where it can; XLA if None.
    """

    def __init__(
        self,
        program: ScalarProgram | Callable[[], ScalarProgram],
        results: Shapes | None = None,
        runner: Runner | None = None,
    ) -> None:
        super().__init__()
        self._program = program
        self.runner = runner
        self._results = results
        self._prepared: dict[tuple[bool, str], Rows | None] = {}

    @functools.cached_property
    def program(self) -> ScalarProgram:
        return self._program if isinstance(self._program, ScalarProgram) else self._program()

    @functools.cached_property
    def results(self) -> Shapes:
        if self._results is not None:
            return self._results
        return [(nodes.shape, dtype) for nodes, dtype in zip(self.program.outputs, self.program.types, strict=True)]

    @functools.cached_property
    def function(self) -> Callable[..., list[jax.Array]]:
        return as_function(self.program)

    @functools.cached_property
    def _in_pieces(self) -> Any:
        return as_function(self.program, not_inlined)

    def kernel(self, rows: int, platform: str) -> Rows | None:
        """The kernel for a batch of that many members on a platform; None: XLA runs it."""
        if self.runner is None or self.program.operations * rows < self.runner.least:
            return None
        return self.native(rows == 1, platform)

    def native(self, single: bool, platform: str = "cpu") -> Rows | None:
        """The kernel for one member or for several, whatever the number of operations."""
        if self.runner is not None and (single, platform) not in self._prepared:
            self._prepared[single, platform] = self.runner.prepare(self.program, single, platform)
        return self._prepared.get((single, platform))

    def by_xla(self, arguments: Sequence[Any], batch: Batch, inside: bool, platform: str) -> list[jax.Array]:
        """On the CPU one member after the other, as small functions, or `inside` of one."""
        if platform != "cpu":
            return super().by_xla(arguments, batch, inside, platform)
        empty = not any(jnp.size(a) for a in arguments)
        if batch.depth == 0:
            return self._in_pieces(*arguments) if inside or empty else small_call(self._in_pieces, *arguments)
        if empty:
            return batch.each(self.function, arguments)

        def every(*flat: jax.Array) -> list[jax.Array]:
            def one(row: dict[int, jax.Array]) -> list[jax.Array]:
                return self._in_pieces(*(row[k] if k in row else flat[k][0] for k in range(len(flat))))

            return jax.lax.map(one, {k: a for k, a in enumerate(flat) if k not in batch.shared})

        return batch.rows(lambda rows, *flat: small_call(every, *flat), arguments)

    def primitive(self, inside: bool) -> Primitive:
        joins = self.runner is None or (inside and not self.runner.alone)
        return _program_p if joins else _native_p

    def _tangent(self, active: tuple[int, ...]) -> Derived:
        # Made when it runs: a program that is only transposed may have no forward derivative.
        results = [self.results[k] for k in self.real]
        return type(self)(lambda: tangent_program(self.program, active), results, self.runner)

    def _cotangent(self, active: tuple[int, ...]) -> Derived:
        return type(self)(cotangent_program(self.program, active), None, self.runner)

    def transposed(self, linear: tuple[int, ...]) -> Differentiable:
        back = self.cotangent(linear)
        assert isinstance(back, Derived)
        moving = back.program.depending(linear)
        if any(i in moving for i in back.program.flat):
            raise NotImplementedError(NOT_LINEAR)
        return back


#: A program that XLA runs; it may be part of a small call.
_program_p = Primitive("scalar_program")
#: A program that a runner runs where that is faster. It has another name, and never becomes part of a small call.
_native_p = Primitive("native_program")


#: JAX's error for a function that is not linear as a transformation expects.
NOT_LINEAR = (
    "a compiled function cannot be transposed: it is not linear in the arguments that are asked for.\n"
    "  fix: jax.vjp and jax.grad differentiate functions that are not linear"
)

#: No batch.
_ONE = Batch()


def call_program(program: Differentiable, *arguments: Any, batch: Batch = _ONE) -> list[Any]:
    """The results of a program, for one member or many; differentiable and batched as any JAX function."""
    # A loop compiled as one small function needs no further ones inside.
    inside = inside_small_call()
    return program.primitive(inside).bind(*varying_alike(arguments), program=program, batch=batch, inside=inside)


# ---- rules of JAX for them -------------------------------------------------------------------------------------------


def _by_xla(*arguments: Any, program: Computed, batch: Batch, inside: bool, platform: str) -> list[jax.Array]:
    return program.by_xla(arguments, batch, inside, platform)


def by_kernel(*arguments: Any, program: Computed, batch: Batch, inside: bool, platform: str) -> list[jax.Array]:
    """The kernel for a platform, if there is one."""
    rows = math.prod(batch.shape(arguments))
    kernel = program.kernel(rows, platform) if rows else None
    if kernel is None:
        return program.by_xla(arguments, batch, inside, platform)
    return batch.rows(kernel, arguments)


def _elsewhere(*arguments: Any, program: Computed, batch: Batch, inside: bool) -> list[jax.Array]:
    return batch.each(program.function, arguments)


def _abstract(*arguments: Any, program: Computed, batch: Batch, inside: bool) -> list[Any]:
    sizes, depth, shared = batch.shape(arguments), batch.depth, batch.shared
    return [placed_as(shaped_array((*sizes, *s), dtype), depth, shared, arguments) for s, dtype in program.results]


def _jvp(
    primals: Sequence[Any], tangents: Sequence[Any], *, program: Differentiable, batch: Batch, inside: bool
) -> tuple[list[Any], list[Any]]:
    results = call_program(program, *primals, batch=batch)
    active = tuple(k for k, t in enumerate(tangents) if type(t) is not ad.Zero)
    # A tangent has the shape of its argument.
    shared = {len(primals) + j for j, k in enumerate(active) if k in batch.shared}
    tangent_batch = dataclasses.replace(batch, shared=batch.shared | shared)
    moved = iter(call_program(program.tangent(active), *primals, *(tangents[k] for k in active), batch=tangent_batch))
    real = set(program.real)
    return results, [
        next(moved) if k in real else ad.Zero(jax.typeof(r).to_tangent_aval()) for k, r in enumerate(results)
    ]


def _transpose(
    cotangents: Sequence[Any], *arguments: Any, program: Differentiable, batch: Batch, inside: bool
) -> list[Any]:
    """The cotangents of the arguments that JAX asks for, in which the program is linear."""
    linear = [k for k, a in enumerate(arguments) if ad.is_undefined_primal(a)]
    # A tangent has the shape of its argument: its transpose is a derivative of the program it came from.
    count = 0 if program.origin is None else len(arguments) - len(program.origin[1])
    if program.origin is not None and min(linear) >= count:
        origin, active = program.origin
        back = origin.cotangent(tuple(active[k - count] for k in linear))
        primals = list(arguments[:count])
    else:
        back = program.transposed(tuple(linear))
        primals = [jnp.zeros(a.aval.shape, a.aval.dtype) if ad.is_undefined_primal(a) else a for a in arguments]
    transposed_batch = dataclasses.replace(batch, shared=frozenset(k for k in batch.shared if k < len(primals)))
    weights = [ad.instantiate_zeros(cotangents[k]) for k in program.real]
    result: list[Any] = [None] * len(arguments)
    for k, value in zip(linear, call_program(back, *primals, *weights, batch=transposed_batch), strict=True):
        every = range(batch.depth if k in batch.shared else 0)
        result[k] = jnp.sum(value, every) if every else value
    return result


class _KeepsAlive:
    """Keeps a program alive as long as compiled code; pickled it is empty."""

    def __init__(self, program: Computed | None = None) -> None:
        self.program = program

    def __reduce__(self) -> tuple[type[_KeepsAlive], tuple[()]]:
        return _KeepsAlive, ()


def define(primitive: Primitive, run: Callable[..., list[jax.Array]], platforms: Sequence[str] = PLATFORMS) -> None:
    """Register with JAX the execution of an equation, alone or in a batch.

    Args:
        run: runs it on these platforms, and takes the platform as a keyword. On others the program's function runs.
    """

    @functools.lru_cache(32)  # what is jitted keeps its program
    def compiled(**params: Any) -> Any:
        return jax.jit(functools.partial(primitive.bind, **params))

    def evaluate(*arguments: jax.Array, **params: Any) -> list[jax.Array]:
        debugging: Any = jax.config
        if debugging.jax_debug_nans and debugging.jax_disable_jit:  # JAX looks for the operation that made a NaN
            return _elsewhere(*arguments, **params)
        # Compiled also where jit is disabled, as every operation of JAX is.
        with jax.disable_jit(False):
            results: list[jax.Array] = compiled(**params)(*arguments)
        return results

    def lower(function: Callable[..., list[jax.Array]]) -> Callable[..., Any]:
        def lowered(context: Any, *arguments: Any, **params: Any) -> Any:
            # A kernel lives as long as its program: keep that alive with the compiled code, but not in exported code.
            module, program = context.module_context, params["program"]
            exported = module.lowering_parameters.for_export
            if not exported:
                module.add_keepalive(_KeepsAlive(program))
            chosen = function if program.exports_kernels or not exported else _elsewhere

            # JAX caches the trace as long as the function lives: a new function each time.
            def once(*a: Any) -> list[jax.Array]:
                return chosen(*a, **params)

            depth, shared = params["batch"].depth, params["batch"].shared
            run = on_axes(once, depth, shared, context) if depth else None
            if run is None:
                run = shared_out(once, depth, shared) if depth and is_shared_out(context) else once
                context = by_one_device(context)
            return mlir.lower_fun(lambda *a: run(*a), multiple_results=True)(context, *arguments)

        return lowered

    def batching_rule(
        arguments: Sequence[Any], axes: Sequence[Any], batch: Batch, **params: Any
    ) -> tuple[list[Any], Any]:
        batch, moved = batch.batched(arguments, axes)
        results = primitive.bind(*moved, **{**params, "inside": False, "batch": batch})
        return results, [0] * len(results)

    needs_devices(primitive)
    primitive.multiple_results = True
    primitive.def_impl(evaluate)
    primitive.def_abstract_eval(_abstract)
    batching.primitive_batchers[primitive] = batching_rule
    mlir.register_lowering(primitive, lower(_elsewhere))
    for platform in platforms:
        mlir.register_lowering(primitive, lower(functools.partial(run, platform=platform)), platform=platform)


def _jet(primals: Sequence[Any], series: Sequence[Any], *, program: Any, batch: Batch, inside: bool) -> Any:
    """Taylor series, from those of the operations."""
    function = without_barriers(program.program) if isinstance(program, Derived) else program.function
    return jet.jet(
        lambda *arguments: batch.each(function, arguments), tuple(primals), tuple(series), factorial_scaled=False
    )


_taylor_rules: dict[Any, Any] = jet.jet_rules


def differentiable(
    primitive: Primitive, run: Callable[..., list[jax.Array]] = by_kernel, platforms: Sequence[str] = PLATFORMS
) -> None:
    """Register a `Differentiable` with JAX."""
    define(primitive, run, platforms)
    ad.primitive_jvps[primitive] = _jvp
    ad.primitive_transposes[primitive] = _transpose
    _taylor_rules[primitive] = _jet


differentiable(_program_p, _by_xla, ("cpu",))
differentiable(_native_p)
