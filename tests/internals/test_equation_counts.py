"""Equations of lowered functions, counted."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx
from twistax.system.explain import count_equations

x, m = tx.State("x", (3,)), tx.State("m", (2, 3))


X, M = np.array([0.3, -1.0, 2.0]), np.arange(6.0).reshape(2, 3)


def test_a_shared_chain_of_24_nodes_is_computed_once() -> None:
    """Each node uses the one before twice: written out they would be 2^24."""
    node: tx.Expr = x[0]
    for _ in range(24):
        node = node + node
    assert count_equations(jax.make_jaxpr(tx.lower(node))(0.0, {"x": X}).jaxpr) <= 30
    compiled = tx.compile(tx.System(rates={x: node * np.ones(3)}))
    field = jax.make_jaxpr(lambda z: compiled.functions.vector_field(jnp.zeros(()), {"x": z}, {}, {}))(X)
    assert count_equations(field.jaxpr) <= 30
    assert compiled.explain().nodes[0] > 2**24
