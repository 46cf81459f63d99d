"""A scalar program as JAX operations on scalars, or on vectors where it is mapped over a batch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import jaxpr_as_fun

from .graph import Call
from .passes import emitted_form
from .program import ScalarProgram

__all__ = ["as_function"]


def as_function(program: ScalarProgram) -> Callable[..., list[jax.Array]]:
    """The program as a function of arrays with the same leading batch axes, or none; pure and traceable."""
    form = emitted_form(program)
    g = form.graph

    def function(*arguments: jax.Array) -> list[jax.Array]:
        batch = arguments[0].shape[: arguments[0].ndim - form.inputs[0].ndim] if arguments else ()
        entries = [a.reshape(*batch, -1) for a in arguments]
        values: dict[int, jax.Array] = {}

        def number(i: int) -> jax.Array:
            return jnp.full(batch, g.numbers[i], g.dtypes[i])

        def array(nodes: Any, at: dict[int, jax.Array]) -> jax.Array:
            flat = [at[i] for i in nodes.reshape(-1).tolist()]
            if not flat:
                return jnp.zeros((*batch, *nodes.shape), g.dtype)
            return jnp.stack(flat, axis=-1).reshape(*batch, *nodes.shape)

        done: set[int] = set()
        for i in form.live:
            place, call, operation = g.input_of(i), g.call_of(i), g.operation(i)
            if place is not None:
                argument, entry = place
                values[i] = lax.index_in_dim(entries[argument], entry, axis=len(batch), keepdims=False)
            elif call is not None:
                if id(call) not in done:
                    done.add(id(call))
                    _called(call, array, values, len(batch))
            elif operation is None:
                values[i] = number(i)
            else:
                values[i] = operation.array(*(values[a] for a in g.arguments(i)))
        return [array(nodes, values) for nodes in form.outputs]

    return function


def _called(call: Call, array: Any, values: dict[int, jax.Array], depth: int) -> None:
    function: Callable[..., list[jax.Array]] = jaxpr_as_fun(call.jaxpr)
    for _ in range(depth):
        function = jax.vmap(function)
    for nodes, result in zip(call.results, function(*(array(a, values) for a in call.arguments)), strict=True):
        flat = result.reshape(*result.shape[:depth], -1)
        for k, i in enumerate(nodes.reshape(-1).tolist()):
            values[i] = lax.index_in_dim(flat, k, axis=depth, keepdims=False)
