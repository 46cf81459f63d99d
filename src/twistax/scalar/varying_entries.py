"""Functions whose results have many constant entries: a kernel computes only the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_inside import jaxpr_as_fun
from .backends import ANY_SIZE, XLA
from .graph import TooLarge
from .jax_primitive import Derived, call_program
from .targets.llvm.backend import KernelRunner, installed
from .targets.llvm.code import NotNative
from .targets.llvm.kernel_body import NATIVE_LIMITS, native_form

#: A function from arrays to arrays.
Arrays = Callable[..., Sequence[Any]]


def varying_entries(function: Arrays, *shapes: Any) -> Arrays:
    """The function as one kernel for results that are mostly zeros, such as Jacobians of trees of bodies.

    `tx.fast` leaves functions with arrays of more than 128 entries in arrays. Here all arrays become scalars, entries
    of results that are numbers leave the kernel, and the results are put together from both.

    Args:
        function: of arrays, pure, to a list of arrays.
        shapes: of the arguments, with types.
    Returns: the function itself where it has no native form.
    """
    closed = jax.make_jaxpr(function)(*shapes)
    if not installed():
        return jaxpr_as_fun(closed)
    try:
        program = XLA().scalars(closed, ANY_SIZE, NATIVE_LIMITS)
        native_form(program)
    except (TooLarge, NotNative):
        return jaxpr_as_fun(closed)
    known = program.graph.numbers
    varying = list(dict.fromkeys(i for i in program.flat if known[i] is None))
    places = {node: k for k, node in enumerate(varying)}
    fixed = list(dict.fromkeys(i for i in program.flat if known[i] is not None))
    places |= {node: len(varying) + k for k, node in enumerate(fixed)}
    numbers = np.array([known[i] for i in fixed], float)
    indices = [np.array([places[i] for i in nodes.ravel()], np.int32).reshape(nodes.shape) for nodes in program.outputs]
    derived = Derived(program.restricted([np.array(varying)]), None, KernelRunner(least=0))

    def assembled(*arrays: Any) -> list[jax.Array]:
        (values,) = call_program(derived, *arrays)
        every = jnp.concatenate([values, jnp.asarray(numbers, values.dtype)])
        return [every[index] for index in indices]

    return assembled
