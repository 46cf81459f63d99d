"""Functions of the package that are one kernel each, such as the steps of filters."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp

from ..jax_inside import ClosedJaxpr, all_equations, jaxpr_as_fun, of_one_device, weakly_kept
from .array_primitive import ArrayProgram, KernelOfArrays, Kernels
from .backends import Backend
from .jax_primitive import Differentiable, call_program
from .parts.inlining import unrolled
from .parts.part import Reason
from .parts.segments import Segmented, emit_segments

R = TypeVar("R")


@weakly_kept
class _Unrolled(Segmented):
    """A function that runs in parts, of which only long loops are some."""

    @functools.cached_property
    def parts(self) -> tuple[Callable[..., list[jax.Array]], list[Reason]]:
        return emit_segments(unrolled(self.program), self.backend)

    def made(self, program: ClosedJaxpr) -> _Unrolled:
        return _Unrolled(program, self.backend)


class KernelFunction(Generic[R]):
    """A pure function of pytrees of arrays as one kernel, alone and in batches, for arrays of any size.

    It is traced once for each structure and type of its arguments, and then not again, whatever it is part of. Where
    it has no scalar form JAX runs it, and where they have none its derivatives.

    Args:
        function: pure and traceable. It closes over no traced value.
        backend: what makes the kernels.
        of_matrices: whether matrices are loops over their entries in its kernel, and not scalars. Such kernels and
            their derivatives are short. `while` loops in it must end for all arguments.
        constant: of matrices, whether results count as constants: their derivatives are zero, and kernels of which the
            function is a part call it.
    """

    def __init__(
        self, function: Callable[..., R], backend: Backend, *, of_matrices: bool = False, constant: bool = False
    ) -> None:
        self._function, self._backend = function, backend
        self._of_matrices, self._constant = of_matrices, constant
        self._programs: dict[Any, tuple[Differentiable, Any]] = {}

    def __call__(self, *arguments: Any) -> R:
        if self._constant:
            arguments = jax.lax.stop_gradient(arguments)
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

    def _traced(self, structure: Any, leaves: list[jax.Array]) -> tuple[Differentiable, Any]:
        forms: list[Any] = []

        def flat(*leaves: jax.Array) -> list[jax.Array]:
            results, form = jax.tree.flatten(self._function(*jax.tree.unflatten(structure, leaves)))
            forms.append(form)
            return results

        shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
        with of_one_device():
            closed = jax.make_jaxpr(flat)(*shapes)
        if self._of_matrices:
            steps = self._backend.steps()
            program = (
                steps.constant(jaxpr_as_fun(closed), shapes)
                if self._constant
                else steps.of_matrices(jaxpr_as_fun(closed), shapes, True)
            )
            return program or ArrayProgram(closed), forms[-1]
        # Loops without a known end are kernels of their own, between those of the rest.
        if any(eqn.primitive.name == "while" for eqn in all_equations(closed.jaxpr)):
            return _Unrolled(closed, self._backend.of_any_size()), forms[-1]
        return KernelOfArrays(closed, self._kernels, alone=True), forms[-1]

    def _kernels(self, closed: ClosedJaxpr) -> Kernels | None:
        shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in closed.jaxpr.invars]
        derived = self._backend.steps().shared(jaxpr_as_fun(closed), shapes)
        return None if derived is None else derived.kernel
