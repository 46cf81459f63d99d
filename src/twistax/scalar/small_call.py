"""A function compiled as one small function, so that loops inside it run fast under default settings.

XLA on the CPU runs a loop as a chain of small kernels, some 50 ns each, unless the loop is compiled as one function.
The attribute that asks for it is not documented, so it is set only on the CPU, for functions made of operations known
to compile that way, on arrays of at most thousands of entries, and with every argument in use. On other platforms, and
under vmap, the function runs as it is, with the same result.
`tests/internals/test_small_call.py` notices if the attribute loses its effect.
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

#: Whether a function is being traced to become a small one, or a kernel, which needs none inside.
_INSIDE = contextvars.ContextVar("inside a small call", default=False)
_IN_KERNEL = contextvars.ContextVar("inside a kernel", default=False)


class _Outside(Exception):
    """Raised for a trace that cannot become part of a small function."""


def need_outside() -> None:
    """End a trace as part of a small function, for something that cannot be part of one."""
    if _INSIDE.get():
        raise _Outside


def inside_small_call() -> bool:
    """Whether the present trace becomes part of a small function."""
    return _INSIDE.get()


def joins_program() -> bool:
    """Whether the present trace becomes part of a small function or of a kernel."""
    return _INSIDE.get() or _IN_KERNEL.get()


@contextlib.contextmanager
def whole_kernel() -> Iterator[None]:
    """Functions that are traced within this context are compiled as kernels, which include small calls."""
    before = _IN_KERNEL.set(True)
    try:
        yield
    finally:
        _IN_KERNEL.reset(before)


@contextlib.contextmanager
def no_small_call() -> Iterator[None]:
    """Functions that are traced within this context are not compiled as small functions."""
    inside = _INSIDE.set(False)
    try:
        yield
    finally:
        _INSIDE.reset(inside)


def held(tree: Tree) -> Tree:
    """The same numbers, stored in one array: inside a small function XLA would compute scalars again at every reader.

    Whole numbers are small, so that they are floating-point numbers too.
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


def on_leaves(
    function: Callable[..., Any], arguments: Any
) -> tuple[Callable[..., list[Any]], list[jax.Array], Callable[[Any], Any]]:
    """A function of pytrees as one of arrays, with lists of results; its arguments; what makes results pytrees again.

    The last once the function was traced.
    """
    leaves, structure = jax.tree.flatten(arguments)
    shapes: list[Any] = []

    def flat(*leaves: jax.Array) -> list[Any]:
        results, shape = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
        shapes.append(shape)
        return results

    return flat, [jnp.asarray(leaf) for leaf in leaves], lambda results: jax.tree.unflatten(shapes[0], results)


def small_call(function: Callable[..., Result], *arguments: Any, trusted: bool = False) -> Result:
    """function(*arguments), compiled as one small function where that is known to work.

    Where it is not, small calls that the function makes itself may still be; inside of one that works they are part of
    it. Pure and traceable. Arguments and result are pytrees of arrays.

    Args:
        trusted: take the caller's word that it works. XLA ends the process where it does not.
    """
    if _INSIDE.get() or _IN_KERNEL.get() or not small_calls_exist():
        return function(*arguments)
    debugging: Any = jax.config
    if debugging.jax_disable_jit:  # operations one by one would have the attribute
        return function(*arguments)
    flat, leaves, unflatten = on_leaves(function, arguments)
    outside = _INSIDE.set(True)
    try:
        jaxpr = jax.make_jaxpr(flat)(*leaves)
    except _Outside:
        jaxpr = None
    finally:
        _INSIDE.reset(outside)
    if jaxpr is None:
        return function(*arguments)
    if not trusted and not known_inside(jaxpr.jaxpr):
        return function(*arguments)
    run, traced = opened(jaxpr)
    # Constants must not be moved inside: an argument that is one then counts as never read.
    result: Result = unflatten(_outlined(run)(*jax.lax.optimization_barrier([*traced, *leaves])))
    return result


def apart(function: Callable[..., Result]) -> Callable[..., Result]:
    """The same, for the CPU, where XLA keeps it a function: inside of loops it would be inlined."""

    def call(*arguments: Any) -> Result:
        with xla_metadata(xla_cpu_small_call="false", inlineable="false"):
            return jax.jit(function, inline=False)(*arguments)

    return call


def _reading(run: Callable[..., list[jax.Array]]) -> Callable[..., list[jax.Array]]:
    """The same with one more result, which reads every argument: XLA ends the process where one is never read."""

    def small_function(*values: jax.Array) -> list[jax.Array]:
        read = [jnp.real(value).reshape(-1)[0].astype(jnp.float32) for value in values if value.size]
        return [*run(*values), functools.reduce(jnp.add, read, jnp.zeros((), jnp.float32))]

    return small_function


def _outlined(run: Callable[..., list[jax.Array]]) -> Callable[..., list[jax.Array]]:
    """A function of arrays as one small function; under vmap as it is: XLA has no such functions for large arrays."""

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
    """Whether every operation, also inside of loops and branches, is one that compiles inside a function.

    Anything that calls a library (solvers, FFI, callbacks) is not. Random keys are no numbers.
    """
    if any(map(is_key, [*jaxpr.constvars, *jaxpr.invars])):
        return False
    return all((entry := entry_of(eqn)) is not None and entry.inside(eqn) for eqn in all_equations(jaxpr))
