"""Equations of JAX that twistax compiles: scalar programs, whole functions with loops, repeated steps and loops."""

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

from ...jax_inside import Primitive, ad, batching, jet, mlir, shaped_array, weakly_kept
from ..small_call import apart, inside_small_call, small_call
from .derivatives import cotangent_program, is_real, tangent_program
from .emitter import as_function
from .program import ScalarProgram, emitted_form

#: Of each result of a program.
Shapes: TypeAlias = "list[tuple[tuple[int, ...], np.dtype[Any]]]"
#: From the number of rows, and arguments (rows, *shape), to results.
Rows: TypeAlias = Callable[..., list[jax.Array]]


class Runner(Protocol):
    """What runs programs on the CPU in another way than by XLA, where a call has at least so many operations."""

    @property
    def least(self) -> int: ...

    def prepare(self, program: ScalarProgram, single: bool) -> Rows | None:
        """What runs the program; None: XLA does.

        Args:
            single: for one row; else for many. Asked once for each program.
        """


class Differentiable(ABC):
    """What an equation computes, with its derivatives, each made when it first runs. Compared and hashed by identity.

    Attributes:
        results: the shapes and types of the results.
        function: from arguments to results of one body; pure and traceable.
        origin: of one made by `tangent`: which one it is a derivative of, and along which arguments.
    """

    def __init__(self) -> None:
        self._tangents: dict[tuple[int, ...], Differentiable] = {}
        self._cotangents: dict[tuple[int, ...], Differentiable] = {}
        self.origin: tuple[Differentiable, tuple[int, ...]] | None = None

    @property
    @abstractmethod
    def results(self) -> Shapes: ...

    @property
    @abstractmethod
    def function(self) -> Callable[..., list[jax.Array]]: ...

    @abstractmethod
    def primitive(self, inside: bool) -> Primitive:
        """What JAX calls it; `inside` of a small call or not."""

    @abstractmethod
    def on_cpu(self, arguments: Sequence[Any], depth: int, inside: bool) -> list[jax.Array]:
        """What XLA runs on the CPU where there is no kernel."""

    @abstractmethod
    def kernel(self, rows: int) -> Rows | None:
        """What runs so many bodies at once on the CPU instead."""

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

    def tangent(self, active: tuple[int, ...]) -> Differentiable:
        if active not in self._tangents:
            found = self._tangents[active] = self._tangent(active)
            found.origin = (self, active)
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
        runner: what runs it and its derivatives on the CPU; XLA if None.
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
        self._prepared: dict[bool, Rows | None] = {}

    @functools.cached_property
    def program(self) -> ScalarProgram:
        return self._program if isinstance(self._program, ScalarProgram) else self._program()

    @functools.cached_property
    def results(self) -> Shapes:
        """The shapes and types of the results."""
        if self._results is not None:
            return self._results
        return [(nodes.shape, dtype) for nodes, dtype in zip(self.program.outputs, self.program.types, strict=True)]

    @functools.cached_property
    def function(self) -> Callable[..., list[jax.Array]]:
        """From arguments to results of one body; pure and traceable."""
        return as_function(self.program)

    @functools.cached_property
    def _apart(self) -> Any:
        return as_function(self.program, apart)

    def kernel(self, rows: int) -> Rows | None:
        """What the runner runs for so many bodies at once on the CPU; None: XLA does."""
        if self.runner is None or self.program.operations * rows < self.runner.least:
            return None
        single = rows == 1
        if single not in self._prepared:
            self._prepared[single] = self.runner.prepare(self.program, single)
        return self._prepared[single]

    def on_cpu(self, arguments: Sequence[Any], depth: int, inside: bool) -> list[jax.Array]:
        """What XLA runs on the CPU: body after body, each loop compiled as one function, or `inside` of one."""
        empty = not any(jnp.size(a) for a in arguments)
        if depth == 0:
            return self._apart(*arguments) if inside or empty else small_call(self._apart, *arguments)
        if empty:
            return _at_once(self, arguments, depth)

        def each(*flat: jax.Array) -> list[jax.Array]:
            return jax.lax.map(lambda row: self._apart(*row), flat)

        return _over_rows(lambda rows, *flat: small_call(each, *flat), arguments, depth)

    def primitive(self, inside: bool) -> Primitive:
        return _program_p if inside or self.runner is None else _native_p

    def _tangent(self, active: tuple[int, ...]) -> Derived:
        # Made when it runs: what is only transposed need not have a forward derivative at all.
        results = [self.results[k] for k in self.real]
        return Derived(lambda: tangent_program(self.program, active), results, self.runner)

    def _cotangent(self, active: tuple[int, ...]) -> Derived:
        return Derived(cotangent_program(self.program, active), None, self.runner)


@weakly_kept
class Repeated:
    """A step and the kernels that take it again and again. Compared and hashed by identity.

    Args:
        step: takes (k, *fixed, *state), gives (*state); or (*state, more), more whether another iteration follows.
        state: how many arguments are the state.
        kernel: makes the kernel, for one body (True) or for many; None where there is none.
    """

    def __init__(self, step: ScalarProgram, state: int, kernel: Callable[[bool], Rows | None]) -> None:
        self._step = step
        self._state = state
        self._kernel = functools.lru_cache(kernel)

    def kernel(self, rows: int) -> Rows | None:
        return self._kernel(rows == 1)

    def on_cpu(self, arguments: Sequence[Any], depth: int, inside: bool) -> list[jax.Array]:
        return _at_once(self, arguments, depth)

    @functools.cached_property
    def results(self) -> Shapes:
        number, *rest = [(a.shape, self._step.graph.dtype_of(a)) for a in self._step.inputs]
        return [*rest[len(rest) - self._state :], number]

    @functools.cached_property
    def function(self) -> Callable[..., list[jax.Array]]:
        """A loop."""
        step, count = as_function(self._step), self._state

        def loop(first: jax.Array, stop: jax.Array, *rest: jax.Array) -> list[jax.Array]:
            fixed, state = rest[: len(rest) - count], rest[len(rest) - count :]

            def going(carried: tuple[jax.Array, jax.Array, Any]) -> jax.Array:
                return carried[1] & (carried[0] < stop)

            def iteration(carried: tuple[jax.Array, jax.Array, Any]) -> tuple[jax.Array, jax.Array, Any]:
                k, _, state = carried
                found = step(k, *fixed, *state)
                if len(found) > count:
                    return k + 1, found[count], found[:count]
                good = jnp.stack([jnp.isfinite(a).all() for a in found]).all()
                kept = [jnp.where(good, new, old) for new, old in zip(found, state, strict=True)]
                return k + good.astype(k.dtype), good, kept

            k, _, found = jax.lax.while_loop(going, iteration, (first, jnp.asarray(True), list(state)))
            return [*found, k]

        return loop


@dataclasses.dataclass(frozen=True)
class Ring:
    """How the arguments and results of one iteration go round.

    A scan takes (*fixed, *state, *rows) and gives (*state, *rows): the rows of an iteration are parts of longer arrays.
    A `while_loop` takes (*fixed, *state) and gives (going, *state): it ends, with the state that came in, where it is
    not going.

    Attributes:
        fixed, state: how many arguments stay the same, and how many are carried.
        length: the iterations of a scan; None: it is a `while_loop`.
        reverse: whether a scan begins with the last rows.
    """

    fixed: int
    state: int
    length: int | None = None
    reverse: bool = False

    @property
    def rows(self) -> int:
        """How many entries the arrays have whose rows come one by one."""
        return self.length or 0

    def place(self, k: int) -> int:
        """The row of an iteration."""
        return self.rows - 1 - k if self.reverse else k


class Looped:
    """A loop of JAX, and the kernels that take all of its iterations. Compared and hashed by identity.

    Args:
        function: the loop as JAX has it, of (count, *arguments).
        results: the shapes and types of its results.
        kernel: makes the kernel, for one body (True) or for many; None where there is none.
    """

    def __init__(
        self, function: Callable[..., list[jax.Array]], results: Shapes, kernel: Callable[[bool], Rows | None]
    ) -> None:
        self.function = function
        self.results = results
        self._kernel = functools.lru_cache(kernel)

    def kernel(self, rows: int) -> Rows | None:
        return self._kernel(rows == 1)

    def on_cpu(self, arguments: Sequence[Any], depth: int, inside: bool) -> list[jax.Array]:
        return _at_once(self, arguments, depth)


#: What an equation computes.
Computed: TypeAlias = Differentiable | Repeated | Looped

#: A program that XLA runs; it may be part of a small call.
_program_p = Primitive("scalar_program")
#: One that a runner runs where that is faster. Under a name of its own: it must not become part of a small call.
_native_p = Primitive("native_program")
#: A repeated step, or a loop.
_repeat_p = Primitive("repeated_step")


def call_program(program: Differentiable, *arguments: Any, depth: int = 0) -> list[Any]:
    """The results of a program; differentiable and batched as any JAX function.

    Args:
        depth: how many axes are of bodies.
    """
    # A loop that is compiled as one small function needs no other one inside.
    inside = inside_small_call()
    return program.primitive(inside).bind(*arguments, program=program, depth=depth, inside=inside)


def repeat(
    step: Repeated, first: jax.Array, stop: jax.Array, fixed: Sequence[jax.Array], state: Sequence[jax.Array]
) -> tuple[list[jax.Array], jax.Array]:
    """state = step(k, fixed, state) for k = first, ..., stop - 1.

    A step that says whether another iteration follows may end that early. One that does not ends it where the new state
    would not be finite, and the state before is kept. Traceable, batched by vmap, not differentiable.

    Returns:
        The state, and the number of the next iteration.
    """
    *found, k = _repeat_p.bind(first, stop, *fixed, *state, program=step, depth=0, inside=False)
    return found, k


def loop(looped: Looped, count: int, arguments: Sequence[Any]) -> list[jax.Array]:
    """The results of a loop. Traceable, batched by vmap, not differentiable."""
    return _repeat_p.bind(jnp.int32(count), *arguments, program=looped, depth=0, inside=False)


# ---- what JAX asks of them -------------------------------------------------------------------------------------------


def _over_rows(function: Rows, arguments: Sequence[Any], depth: int) -> list[jax.Array]:
    """function(rows, *arguments) of arguments whose first `depth` axes are bodies, made one axis for it."""
    shape = _bodies(arguments, depth)
    rows = math.prod(shape)
    found = function(rows, *(jnp.reshape(a, (rows, *jnp.shape(a)[depth:])) for a in arguments))
    return [jnp.reshape(r, (*shape, *r.shape[1:])) for r in found]


def _at_once(program: Computed, arguments: Sequence[Any], depth: int) -> list[jax.Array]:
    """All bodies at once, as accelerators do."""
    function = program.function
    for _ in range(depth):
        function = jax.vmap(function)
    return function(*arguments)


def _bodies(arguments: Sequence[Any], depth: int) -> tuple[int, ...]:
    return np.shape(arguments[0])[:depth] if arguments else ()


def _by_xla(*arguments: Any, program: Computed, depth: int, inside: bool) -> list[jax.Array]:
    return program.on_cpu(arguments, depth, inside)


def _by_kernel(*arguments: Any, program: Computed, depth: int, inside: bool) -> list[jax.Array]:
    rows = math.prod(_bodies(arguments, depth))
    kernel = program.kernel(rows) if rows else None
    return program.on_cpu(arguments, depth, inside) if kernel is None else _over_rows(kernel, arguments, depth)


def _elsewhere(*arguments: Any, program: Computed, depth: int, inside: bool) -> list[jax.Array]:
    return _at_once(program, arguments, depth)


def _abstract(*arguments: Any, program: Computed, depth: int, inside: bool) -> list[Any]:
    return [shaped_array((*_bodies(arguments, depth), *shape), dtype) for shape, dtype in program.results]


def _jvp(
    primals: Sequence[Any], tangents: Sequence[Any], *, program: Differentiable, depth: int, inside: bool
) -> tuple[list[Any], list[Any]]:
    results = call_program(program, *primals, depth=depth)
    active = tuple(k for k, t in enumerate(tangents) if type(t) is not ad.Zero)
    moved = iter(call_program(program.tangent(active), *primals, *(tangents[k] for k in active), depth=depth))
    real = set(program.real)
    return results, [
        next(moved) if k in real else ad.Zero(jax.typeof(r).to_tangent_aval()) for k, r in enumerate(results)
    ]


def _transpose(
    cotangents: Sequence[Any], *arguments: Any, program: Differentiable, depth: int, inside: bool
) -> list[Any]:
    if program.origin is None:
        raise NotImplementedError("only the derivative of a scalar program is linear")
    origin, active = program.origin
    count = len(arguments) - len(active)
    given = [ad.instantiate_zeros(c) for c in cotangents]
    linear = [k for k, a in enumerate(arguments[count:]) if ad.is_undefined_primal(a)]
    back = origin.cotangent(tuple(active[k] for k in linear))
    result: list[Any] = [None] * len(arguments)
    for k, value in zip(linear, call_program(back, *arguments[:count], *given, depth=depth), strict=True):
        result[count + k] = value
    return result


def _define(primitive: Primitive, on_cpu: Callable[..., list[jax.Array]]) -> None:
    """Tell JAX how an equation runs, for one body or for batches of them."""

    @functools.lru_cache(32)  # what is jitted keeps its program
    def compiled(**own: Any) -> Any:
        return jax.jit(functools.partial(primitive.bind, **own))

    def evaluate(*arguments: jax.Array, **own: Any) -> list[jax.Array]:
        debugging: Any = jax.config
        if debugging.jax_debug_nans and debugging.jax_disable_jit:  # JAX looks for the operation that made a NaN
            return _at_once(own["program"], arguments, own["depth"])
        # As every operation of JAX: compiled also where functions are not.
        with jax.disable_jit(False):
            found: list[jax.Array] = compiled(**own)(*arguments)
        return found

    def lower(function: Callable[..., list[jax.Array]]) -> Callable[..., Any]:
        def lowered(context: Any, *arguments: Any, **own: Any) -> Any:
            # A kernel goes with its program, and what is compiled here calls it. Exported code knows it by name alone.
            module = context.module_context
            if not module.lowering_parameters.for_export:
                module.add_keepalive(own["program"])
            # JAX keeps what it traced as long as the function: a new one each time.
            here = mlir.lower_fun(lambda *a: function(*a, **own), multiple_results=True)
            return here(context, *arguments)

        return lowered

    def batch(arguments: Sequence[Any], axes: Sequence[Any], **own: Any) -> tuple[list[Any], list[int]]:
        size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
        moved = [batching.bdim_at_front(a, d, size) for a, d in zip(arguments, axes, strict=True)]
        results = primitive.bind(*moved, **{**own, "inside": False, "depth": own["depth"] + 1})
        return results, [0] * len(results)

    primitive.multiple_results = True
    primitive.def_impl(evaluate)
    primitive.def_abstract_eval(_abstract)
    batching.primitive_batchers[primitive] = batch
    mlir.register_lowering(primitive, lower(_elsewhere))
    mlir.register_lowering(primitive, lower(on_cpu), platform="cpu")


def _jet(primals: Sequence[Any], series: Sequence[Any], *, program: Derived, depth: int, inside: bool) -> Any:
    """Taylor series: those of the operations on scalars, `as_function` has barriers, which have none."""
    form = emitted_form(program.program)
    if form.calls:
        names = ", ".join(sorted({e.primitive.name for call in form.calls for e in call.jaxpr.jaxpr.eqns}))
        raise NotImplementedError(f"jet: no Taylor series of {names} in a compiled system; use backend=tx.JAX()")

    def function(*arguments: jax.Array) -> list[jax.Array]:
        values = form.computed(
            lambda argument, place: jnp.reshape(arguments[argument], -1)[place],
            lambda value, dtype: jnp.asarray(value, dtype),
            lambda operation, _, *own: operation.array(*own),
        )
        flat = [[values[i] for i in nodes.reshape(-1).tolist()] for nodes in form.outputs]
        return [jnp.stack(own).reshape(nodes.shape) for own, nodes in zip(flat, form.outputs, strict=True)]

    for _ in range(depth):
        function = jax.vmap(function)
    return jet.jet(function, tuple(primals), tuple(series), factorial_scaled=False)


_taylor_rules: dict[Any, Any] = jet.jet_rules


def differentiable(primitive: Primitive, on_cpu: Callable[..., list[jax.Array]] | None = None) -> None:
    """The same for an equation of a `Differentiable`; on the CPU by its kernel if there is one."""
    _define(primitive, on_cpu or _by_kernel)
    ad.primitive_jvps[primitive] = _jvp
    ad.primitive_transposes[primitive] = _transpose


differentiable(_program_p, _by_xla)
differentiable(_native_p)
for _primitive in (_program_p, _native_p):
    _taylor_rules[_primitive] = _jet
_define(_repeat_p, _by_kernel)
