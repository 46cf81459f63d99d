"""Functions of JAX evaluated once by NumPy, without compilation, for messages after a failure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np

from ...jax_inside import Unread
from ..backends import pure
from ..graph import TooLarge
from ..reader import scalarize
from ..small_call import tracing_kernel
from .llvm.code import NotNative
from .llvm.kernel_body import NATIVE_LIMITS, by_numpy, native_form

Result = TypeVar("Result")

#: The most scalars of a function to evaluate: reading takes about a second.
_LARGEST = 40_000


def on_host(function: Callable[..., Result], *arguments: Any) -> Result | None:
    """function(*arguments), evaluated as scalars by NumPy.

    It is traced as JAX traces it, but XLA and LLVM see nothing of it.

    Args:
        function: pure and traceable.
        arguments: pytrees of known numbers.
    Returns:
        The result, with arrays of NumPy; None where the function has no scalar form alone: it calls other
        functions, has loops of unknown length, or is too large.
    """
    leaves, structure = jax.tree.flatten(arguments)
    values = [np.asarray(leaf) for leaf in leaves]
    shapes: list[Any] = []

    def flat(*leaves: jax.Array) -> list[Any]:
        results, shape = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
        shapes.append(shape)
        return results

    types = [jax.ShapeDtypeStruct(a.shape, jax.dtypes.canonicalize_dtype(a.dtype)) for a in values]
    try:
        with tracing_kernel():
            closed = pure(flat, types)
        if closed is None:
            return None
        program = native_form(scalarize(closed, checked=False, largest=_LARGEST, limits=NATIVE_LIMITS))
    except (NotNative, TooLarge, Unread):
        return None
    rows = [a.astype(aval.dtype).reshape(1, -1) for a, aval in zip(values, types, strict=True)]
    results = by_numpy(program, rows)
    arrays = [a.reshape(v.aval.shape) for a, v in zip(results, closed.jaxpr.outvars, strict=True)]
    return jax.tree.unflatten(shapes[0], arrays)
