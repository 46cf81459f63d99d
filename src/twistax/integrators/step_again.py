"""A step that is taken again for its derivatives: as one program, where the system's backend writes one."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from ..lowering.backends import Backend
from ..lowering.scalar.primitive import Derived, call_program
from .charts.whole import Blocks
from .kernel_steps import too_wide
from .stepper import Stepper

__all__ = ["advance_again"]


def advance_again(stepper: Stepper, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
    """`stepper.advance`, for loops that are differentiated: a program is compiled faster, and runs as one function."""
    leaves, structure = jax.tree.flatten((stepper, t, y, h))
    types = tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
    key = (advance_again, structure, types)
    steps = stepper.dynamics._functions.steps
    program = None if too_wide(y) else steps.get(key, lambda: _program(stepper.dynamics.backend, structure, types))
    if program is None:
        return stepper.advance(t, y, h)
    return jax.tree.unflatten(jax.tree.structure(y), call_program(program, *leaves))


def _program(backend: Backend, structure: Any, types: Any) -> Derived | None:
    def step(*leaves: jax.Array) -> list[jax.Array]:
        stepper, t, y, h = jax.tree.unflatten(structure, leaves)
        return jax.tree.leaves(stepper.in_arrays.advance(t, y, h))

    return backend.step(step, [jax.ShapeDtypeStruct(*each) for each in types])
