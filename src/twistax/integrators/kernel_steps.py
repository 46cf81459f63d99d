"""Fixed steps in one kernel, where the system's backend makes kernels and a step has a form for them."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from ..lowering.backends import Backend
from ..lowering.scalar.repeated import Repeated, repeat
from .charts.whole import Blocks
from .method import Attempt, Carry
from .stepper import Stepper

__all__ = ["KernelSteps", "kernel_steps", "too_wide"]


@dataclasses.dataclass(frozen=True)
class KernelSteps:
    """Steps of a method on a system, with inputs of some types, all in one call.

    Attributes:
        repeated: the step on flat arrays.
        evaluations: of the right-hand side in a step.
    """

    repeated: Repeated
    evaluations: int

    def run(
        self, stepper: Stepper, t0: jax.Array, h: jax.Array, first: jax.Array, stop: jax.Array, y: Blocks, carry: Carry
    ) -> tuple[Blocks, Carry, jax.Array]:
        """Steps `first` to `stop` - 1, or until a state is not finite: the last that is, and the number of its step.

        Traceable, batched by vmap, not differentiable.
        """
        state, structure = jax.tree.flatten((y, carry))
        found, turn = repeat(self.repeated, first, stop, jax.tree.leaves((t0, h, stepper)), state)
        y, carry = jax.tree.unflatten(structure, found)
        return y, carry, turn


def kernel_steps(
    stepper: Stepper, t0: jax.Array, h: jax.Array, number: jax.Array, y: Blocks, carry: Carry
) -> KernelSteps | None:
    """Steps in one kernel; None where there is none: the backend makes no kernels, or the step has no form for it.

    Args:
        number: of a step, for its type.
    """
    inputs = (number, (t0, h, stepper), (y, carry))
    leaves, structure = jax.tree.flatten(inputs)
    types = tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
    state, backend = inputs[-1], stepper.dynamics.backend
    if too_wide(state):
        return None
    key = (kernel_steps, structure, types)
    steps = stepper.dynamics._functions.steps
    return steps.get(key, lambda: _made(backend, structure, types, len(jax.tree.leaves(state))))


#: States of more numbers are left to XLA, whose vectors run along them.
_WIDEST = 400


def too_wide(state: Any) -> bool:
    """Whether a state has so many numbers that steps are better not written out as scalars."""
    return sum(jnp.size(leaf) for leaf in jax.tree.leaves(state)) > _WIDEST


def _made(backend: Backend, structure: Any, types: Any, state: int) -> KernelSteps | None:
    made: list[Attempt] = []

    def step(*leaves: jax.Array) -> list[jax.Array]:
        k, (t0, h, stepper), (y, carry) = jax.tree.unflatten(structure, leaves)
        made.append(stepper.in_arrays.follow(t0 + k.astype(t0.dtype) * h, y, carry, h))
        return jax.tree.leaves((made[-1].y, made[-1].carry))

    repeated = backend.repeated(step, [jax.ShapeDtypeStruct(*each) for each in types], state)
    # A step that solves equations may fail, which a kernel does not see.
    if repeated is None or made[-1].solved is not None or not isinstance(made[-1].evaluations, int):
        return None
    return KernelSteps(repeated, made[-1].evaluations)
