"""Steps chosen by tolerances in one kernel, where the system's backend makes kernels and a step has a form for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from ..lowering.scalar.repeated import Repeated, repeat
from .kernel_steps import too_wide
from .stepper import Stepper

__all__ = ["kernel_tries"]

Now = TypeVar("Now")


def kernel_tries(
    one_try: Callable[[Any, Stepper, Now], tuple[Now, jax.Array]], given: Any, stepper: Stepper, now: Now
) -> Callable[[Now, jax.Array, jax.Array], Now] | None:
    """A loop over now = one_try(given, stepper, now), in one kernel; None where there is none.

    Args:
        one_try: also says whether another one follows. What it does depends on the structure of its inputs alone.
        given: what stays the same.
    Returns:
        (now, first, stop) to the last `now`, after stop - first tries at most. Traceable, batched by vmap, not
        differentiable. Whole numbers are carried as floating-point ones.
    """
    if too_wide(now):
        return None
    fixed, structure = jax.tree.flatten((given, stepper))
    state, form = jax.tree.flatten(now)
    types = tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in (*fixed, *state))
    key = (kernel_tries, structure, form, types)
    kinds = [kind for _, kind in types[len(fixed) :]]
    dtype = next(kind for kind in kinds if jnp.issubdtype(kind, jnp.floating))

    def turn(_: jax.Array, *leaves: jax.Array) -> list[jax.Array]:
        given, stepper = jax.tree.unflatten(structure, leaves[: len(fixed)])
        now = _cast(form, leaves[len(fixed) :], kinds)
        now, more = one_try(given, stepper.in_arrays, now)
        return [*(leaf.astype(dtype) for leaf in jax.tree.leaves(now)), more]

    def make() -> Repeated | None:
        shapes = [jax.ShapeDtypeStruct((), int), *(jax.ShapeDtypeStruct(*each) for each in types[: len(fixed)])]
        shapes += [jax.ShapeDtypeStruct(shape, dtype) for shape, _ in types[len(fixed) :]]
        return stepper.dynamics.backend.repeated(turn, shapes, len(state))

    repeated = stepper.dynamics._functions.steps.get(key, make)
    if repeated is None:
        return None

    def run(now: Now, first: jax.Array, stop: jax.Array) -> Now:
        state = [jnp.asarray(leaf, dtype) for leaf in jax.tree.leaves(now)]
        found: Now = _cast(form, repeat(repeated, first, stop, fixed, state)[0], kinds)
        return found

    return run


def _cast(form: Any, leaves: Any, kinds: Any) -> Any:
    return jax.tree.unflatten(form, [leaf.astype(kind) for leaf, kind in zip(leaves, kinds, strict=True)])
