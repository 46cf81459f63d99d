"""Gradients with respect to group elements, as tangent vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from twistax.errors import InputError
from twistax.groups.group import Group
from twistax.groups.special import SE3

__all__ = ["tangent_grad"]


def tangent_grad(fn: Callable[..., Any], group: Group = SE3, argnums: int = 0) -> Callable[..., jax.Array]:
    """The gradient of a scalar function of a group element: d/dd fn(g Exp(d)) at d = 0, in reverse mode.

    The ambient gradient of a pose is a 4x4 array with directions that leave the group; this one has the group's
    dimension: (6,) for SE3, in the order of the group, (3,) for SO3. With a Product, g is a dict and the gradient one
    flat vector in the order of declaration (`group.split` takes it apart).

    Args:
        fn: scalar function; argument number `argnums` is the element, the others pass through.
        group: where the element lives; for the state of a compiled system `dynamics.group`.
    Returns:
        A function of fn's arguments. It may be jitted, mapped and differentiated again.
    Raises:
        InputError: at call time, fewer arguments than argnums needs.
        TypeError: from JAX, if fn is not scalar.
    """

    def gradient(*args: Any, **kwargs: Any) -> jax.Array:
        if not -len(args) <= argnums < len(args):
            raise InputError(f"tangent_grad looks at argument {argnums}, but {len(args)} positional ones came")
        position = argnums % len(args)
        element = args[position]

        def moved(d: jax.Array) -> Any:
            return fn(*args[:position], group.retract(element, d), *args[position + 1 :], **kwargs)

        floating = [leaf.dtype for leaf in jax.tree.leaves(jax.tree.map(jnp.asarray, element))]
        return jax.grad(moved)(jnp.zeros(group.dimension, jnp.result_type(*floating)))

    return gradient
