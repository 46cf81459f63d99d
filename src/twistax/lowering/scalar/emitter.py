"""A scalar program as JAX operations on scalars."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import jaxpr_as_fun

from .passes import emitted_form
from .program import ScalarProgram

__all__ = ["as_function"]


def as_function(program: ScalarProgram) -> Callable[..., list[jax.Array]]:
    """The program as a function of arrays, one body at a time; pure and traceable."""
    form = emitted_form(program)
    g = form.graph

    def function(*arguments: jax.Array) -> list[jax.Array]:
        # Barriers: XLA would work out all that an array needs again for each of its entries.
        entries = lax.optimization_barrier([jnp.reshape(a, -1) for a in arguments])
        values: dict[int, jax.Array] = {}

        def array(nodes: Any, dtype: Any) -> jax.Array:
            if not nodes.size:
                return jnp.zeros(nodes.shape, dtype)
            return jnp.stack([values[i] for i in nodes.reshape(-1).tolist()]).reshape(nodes.shape)

        done: set[int] = set()
        for i in form.live:
            place, call, operation = g.input_of(i), g.call_of(i), g.operation(i)
            if place is not None:
                values[i] = lax.index_in_dim(entries[place[0]], place[1], keepdims=False)
            elif call is not None:
                if id(call) not in done:
                    done.add(id(call))
                    types = [v.aval.dtype for v in call.jaxpr.jaxpr.invars]
                    results = jaxpr_as_fun(call.jaxpr)(*map(array, call.arguments, types))
                    for nodes, result in zip(call.results, results, strict=True):
                        flat = jnp.reshape(result, -1)
                        values.update({j: flat[k] for k, j in enumerate(nodes.reshape(-1).tolist())})
            elif operation is None:
                values[i] = jnp.asarray(g.numbers[i], g.dtypes[i])
            else:
                values[i] = operation.array(*(values[a] for a in g.arguments(i)))
        needed = sorted(set(form.flat))
        values.update(zip(needed, lax.optimization_barrier([values[i] for i in needed]), strict=True))
        return lax.optimization_barrier(list(map(array, form.outputs, form.types)))

    return function
