"""Functions that XLA compiles as one small function, in which loops run fast under default settings.

XLA on the CPU runs a loop as a chain of small kernels, some 50 ns each, unless the loop is compiled as one function.
The XLA attribute that requests it is not documented, so it is set only on the CPU, for functions made of operations
known to compile that way, on arrays of at most thousands of entries, and with every argument in use. On other
platforms, and under vmap, the function is executed unchanged, with the same result. If the XLA attribute loses its
effect, `tests/internals/test_small_call.py` fails.
"""

from __future__ import annotations

import contextlib
import contextvars
import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..jax_inside import accelerators_exist, all_equations, is_key, opened, small_calls_exist, xla_metadata
from .primitives.table import entry_of

Result = TypeVar("Result")
Tree = TypeVar("Tree")

#: Whether a small function, or a kernel, which needs no small functions, is being traced.
_INSIDE = contextvars.ContextVar("inside a small call", default=False)
_IN_KERNEL = contextvars.ContextVar("inside a kernel", default=False)


class _Outside(Exception):
    """Raised for a trace that cannot become part of a small function."""


def need_outside() -> None:
    """End the trace of a small function, for an operation that cannot be part of one."""
    if _INSIDE.get():
        raise _Outside


def inside_small_call() -> bool:
    """Whether the present trace becomes part of a small function."""
    return _INSIDE.get()


def joins_program() -> bool:
    """Whether the present trace becomes part of a small function or of a kernel."""
    return _INSIDE.get() or _IN_KERNEL.get()


@contextlib.contextmanager
def _setting(variable: contextvars.ContextVar[bool], value: bool) -> Iterator[None]:
    before = variable.set(value)
    try:
        yield
    finally:
        variable.reset(before)


def tracing_kernel() -> contextlib.AbstractContextManager[None]:
    """A context in which functions are traced to become kernels, which need no small calls."""
    return _setting(_IN_KERNEL, True)


def no_small_call() -> contextlib.AbstractContextManager[None]:
    """A context in which traced functions are not part of a small function."""
    return _setting(_INSIDE, False)


def stored_once(tree: Tree) -> Tree:
    """The same numbers, computed once: inside a small function XLA would recompute scalars at each use.

    They are packed into one array behind a barrier. Integers are small enough to be floating-point numbers in it.
    """
    if not inside_small_call():
        return tree
    kinds = [jnp.result_type(leaf) for leaf in jax.tree.leaves(tree)]
    dtype = next((kind for kind in kinds if jnp.issubdtype(kind, jnp.floating)), jnp.float32)

    def is_number(value: Any) -> bool:
        return jnp.issubdtype(jnp.result_type(value), jnp.floating)

    packed, read = ravel_pytree(jax.tree.map(lambda a: a if is_number(a) else a.astype(dtype), tree))
    numbers = read(jax.lax.optimization_barrier(packed))
    kept: Tree = jax.tree.map(lambda a, b: b if is_number(a) else b.astype(a.dtype), tree, numbers)
    return kept


def fits(function: Callable[..., Any], *arguments: Any) -> bool:
    """Whether function(*arguments) is made of operations known to compile as one small function."""
    return known_inside(jax.make_jaxpr(function)(*arguments).jaxpr)


def small_call(function: Callable[..., Result], *arguments: Any, trusted: bool = False) -> Result:
    """The call function(*arguments), compiled as one small function if this is supported.

    Where it is not, small calls that the function makes itself may still be; inside of one that works they are part of
    it. Pure and traceable. Arguments and result are pytrees of arrays.

    Args:
        trusted: do not check that it works. XLA ends the process where it does not.
    """
    if _INSIDE.get() or _IN_KERNEL.get() or not small_calls_exist():
        return function(*arguments)
    debugging: Any = jax.config
    if debugging.jax_disable_jit:  # operations one by one would have the attribute
        return function(*arguments)
    leaves, structure = jax.tree.flatten(jax.tree.map(jnp.asarray, arguments))
    structures: list[Any] = []

    def flat(*leaves: jax.Array) -> list[Any]:  # JAX's caches must not hold what pytrees name, such as systems
        results, shape = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
        structures.append(shape)
        return results

    try:
        with _setting(_INSIDE, True):
            jaxpr = jax.make_jaxpr(flat)(*leaves)
    except _Outside:
        return function(*arguments)
    if not (trusted or known_inside(jaxpr.jaxpr)):
        return function(*arguments)
    run, traced = opened(jaxpr)
    # Constants must not be moved inside: an argument that is one then counts as never read.
    results = _outlined(run)(*jax.lax.optimization_barrier([*traced, *leaves]))
    result: Result = jax.tree.unflatten(structures[0], results)
    return result


def not_inlined(function: Callable[..., Result]) -> Callable[..., Result]:
    """The same function, which XLA on the CPU does not inline into loops."""

    def call(*arguments: Any) -> Result:
        with xla_metadata(xla_cpu_small_call="false", inlineable="false"):
            return jax.jit(function, inline=False)(*arguments)

    return call


def _reading(run: Callable[..., list[jax.Array]]) -> Callable[..., list[jax.Array]]:
    """The same with a further result that reads every argument: XLA ends the process where one is not read."""

    def small_function(*values: jax.Array) -> list[jax.Array]:
        read = [jnp.real(value).reshape(-1)[0].astype(jnp.float32) for value in values if value.size]
        return [*run(*values), functools.reduce(jnp.add, read, jnp.zeros((), jnp.float32))]

    return small_function


def _outlined(run: Callable[..., list[jax.Array]]) -> Callable[..., list[jax.Array]]:
    """A function of arrays as one small function; under vmap an ordinary one, as XLA has none for large arrays."""

    @jax.custom_batching.custom_vmap
    def outlined(*leaves: jax.Array) -> list[jax.Array]:
        with xla_metadata(xla_cpu_small_call="true", inlineable="false"):
            return jax.jit(_reading(run), inline=False)(*leaves)[:-1]

    @outlined.def_vmap
    def batched(size: int, mapped: list[bool], *leaves: jax.Array) -> tuple[list[jax.Array], list[bool]]:
        axes = [0 if is_mapped else None for is_mapped in mapped]
        results = jax.vmap(run, in_axes=axes, axis_size=size)(*leaves)
        return results, [True] * len(results)

    def by_platform(*leaves: jax.Array) -> list[jax.Array]:
        """Where it runs is known once it is lowered."""
        results: list[jax.Array] = jax.lax.platform_dependent(*leaves, cpu=outlined, default=run)
        return results

    # Part of a larger program always. Where JAX evaluates a jaxpr that holds the inner function, it lowers it while
    # the attribute is set, every operation gets it, and XLA ends the process at loops inside.
    return jax.jit(by_platform if accelerators_exist() else outlined)


def known_inside(jaxpr: Any) -> bool:
    """Whether every operation, also inside of loops and branches, is known to compile inside a small function.

    Anything that calls a library (solvers, FFI, callbacks) is not. Random keys are no numbers.
    """
    if any(map(is_key, [*jaxpr.constvars, *jaxpr.invars])):
        return False
    return all((entry := entry_of(eqn)) is not None and entry.inside(eqn) for eqn in all_equations(jaxpr))
