"""Functions of the package that are one kernel each, such as the steps of filters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp

from ..jax_inside import ClosedJaxpr, jaxpr_as_fun, of_one_device
from .array_primitive import KernelOfArrays, Kernels
from .backends import Backend
from .jax_primitive import call_program

R = TypeVar("R")


class KernelFunction(Generic[R]):
    """A pure function of pytrees of arrays as one kernel, alone and in batches, however wide its arrays.

    It is traced once for each structure and type of its arguments, and then not again, whatever it is part of. Where
    it has no scalar form JAX runs it, and where they have none its derivatives.

    Args:
        function: pure and traceable. It closes over no traced value.
        backend: what makes the kernels.
    """

    def __init__(self, function: Callable[..., R], backend: Backend) -> None:
        self._function, self._backend = function, backend
        self._programs: dict[Any, tuple[KernelOfArrays, Any]] = {}

    def __call__(self, *arguments: Any) -> R:
        if self._backend.runner is None:
            return self._function(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        leaves = [jnp.asarray(leaf) for leaf in leaves]
        key = structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        if key not in self._programs:
            self._programs[key] = self._traced(structure, leaves)
        program, form = self._programs[key]
        result: R = jax.tree.unflatten(form, call_program(program, *leaves))
        return result

    def _traced(self, structure: Any, leaves: list[jax.Array]) -> tuple[KernelOfArrays, Any]:
        forms: list[Any] = []

        def flat(*leaves: jax.Array) -> list[jax.Array]:
            results, form = jax.tree.flatten(self._function(*jax.tree.unflatten(structure, leaves)))
            forms.append(form)
            return results

        with of_one_device():
            closed = jax.make_jaxpr(flat)(*(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves))
        return KernelOfArrays(closed, self._kernels, alone=True), forms[-1]

    def _kernels(self, closed: ClosedJaxpr) -> Kernels | None:
        shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in closed.jaxpr.invars]
        derived = self._backend.steps().shared(jaxpr_as_fun(closed), shapes)
        return None if derived is None else derived.kernel
