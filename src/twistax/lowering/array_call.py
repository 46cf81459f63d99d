"""A function of small arrays as one kernel on the CPU.

XLA runs such a function as hundreds of small pieces, each of which costs more than its work. Here LLVM compiles all of
it as one: loops, branches, products of matrices, and calls of the kernels of scalar programs.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax

from ..jax_inside import ClosedJaxpr, Primitive, ad, all_equations, inner_jaxprs, jaxpr_as_fun, opened, weakly_kept
from .native.backend import installed
from .scalar.primitive import Bodies, Computed, Rows, by_kernel, define
from .small_call import inside_kernel, on_leaves, whole_kernel

Result = TypeVar("Result")


def array_call(function: Callable[..., Result], *arguments: Any) -> Result:
    """function(*arguments), in one kernel on the CPU where all that it does has a native form; else as it is.

    Pure and traceable. Arguments and result are pytrees of arrays. The function is traced and compiled at once, and
    traced once more where it has no kernel. Under vmap each body runs its own loops, and bodies are shared between
    threads; derivatives are those of the function.
    """
    if inside_kernel() or not installed() or jax.default_backend() != "cpu":
        return function(*arguments)
    flat, leaves, whole = on_leaves(function, arguments)
    with whole_kernel():
        closed = jax.make_jaxpr(flat)(*leaves)
        run, held = opened(closed)
        program = SmallArrays(jax.make_jaxpr(run)(*held, *leaves) if held else closed)
    if program.kernel(1) is None:
        return function(*arguments)
    results = _small_arrays_p.bind(*held, *leaves, program=program, bodies=Bodies(), inside=False)
    found: Result = whole(results)
    return found


def is_one_kernel(traced: Any) -> bool:
    """Whether all that a traced function does is one call of a kernel that `array_call` made."""
    plain = [eqn.primitive for eqn in all_equations(traced.jaxpr.jaxpr) if not list(inner_jaxprs(eqn))]
    return plain == [_small_arrays_p]


@weakly_kept
class SmallArrays(Computed):
    """A jaxpr of small arrays."""

    def __init__(self, closed: ClosedJaxpr) -> None:
        self.closed = closed
        self.results = [(tuple(v.aval.shape), v.aval.dtype) for v in closed.jaxpr.outvars]
        self.function = jaxpr_as_fun(closed)

    def kernel(self, rows: int) -> Rows | None:
        return self._kernel

    @functools.cached_property
    def _kernel(self) -> Rows | None:
        from .native.arrays.kernels import array_kernel

        return array_kernel(self.closed)


def _jvp(primals: Any, tangents: Any, *, program: SmallArrays, bodies: Bodies, inside: bool) -> Any:
    """That of the function as it is."""
    moved = tuple(ad.instantiate_zeros(t) for t in tangents)
    found: Any = jax.jvp(lambda *a: bodies.each(program.function, a), tuple(primals), moved)
    return found


_small_arrays_p = Primitive("small_arrays")
define(_small_arrays_p, by_kernel)
ad.primitive_jvps[_small_arrays_p] = _jvp
