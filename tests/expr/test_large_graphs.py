"""Time and depth: shared graphs cost what their nodes cost, deep ones do not hit the recursion limit."""

from __future__ import annotations

import time

import jax
import numpy as np
import pytest
from expr_cases import function_of

from twistax import expr as tx
from twistax.errors import ShapeError

x = tx.State("x", shape=(3,))


def shared_chain(n: int) -> tx.Expr:
    """n nodes, each using the one before twice: as a tree 2^n nodes."""
    node: tx.Expr = x
    for _ in range(n):
        node = tx.Sin(node) * node
    return node


def deep_chain(n: int) -> tx.Expr:
    node: tx.Expr = x
    for i in range(n):
        node = tx.Sin(node) if i % 2 else node / 2.0
    return node


def test_a_shared_chain_is_linear() -> None:
    start = time.perf_counter()
    expr = shared_chain(24)
    assert expr.check_shape() == (3,)
    assert len(expr.key()) == len(shared_chain(24).key())
    canonical = expr.canonicalize()
    assert canonical.key() == canonical.canonicalize().key()
    assert len(tx.postorder(canonical)) == 1 + 2 * 24
    assert len(repr(expr)) < 5000
    assert len(expr.latex()) < 10000
    assert len(expr.tree().splitlines()) <= 4 * 24
    assert time.perf_counter() - start < 2.0


def test_a_shared_chain_of_24_nodes_lowers_to_24_equations() -> None:
    node: tx.Expr = tx.State("s")
    for _ in range(24):
        node = node * node
    jaxpr = jax.make_jaxpr(lambda s: function_of(node)({"s": s}))(1.0)
    assert len(jaxpr.eqns) == 24


def test_equal_parts_built_twice_are_computed_once() -> None:
    expr = tx.Sin(tx.Norm(x) + 1.0) * tx.Cos(tx.Norm(x) + 1.0)
    jaxpr = jax.make_jaxpr(lambda x: function_of(expr)({"x": x}))(np.ones(3))
    names = [equation.primitive.name for equation in jaxpr.eqns]
    assert names.count("reduce_sum") == 1


def test_a_deep_chain_does_not_recurse() -> None:
    expr = deep_chain(5000)
    assert expr.check_shape() == (3,)
    assert expr.key() == deep_chain(5000).key()
    assert expr.canonicalize().shape == (3,)
    assert len(repr(expr)) < 10000
    assert len(expr.latex()) < 20000
    assert len(expr.tree().splitlines()) > 5000
    assert jax.eval_shape(function_of(expr), {"x": np.ones(3)})[0].shape == (3,)


def test_a_deep_tree_of_sums_flattens() -> None:
    expr: tx.Expr = x
    for _ in range(3000):
        expr = expr + x
    start = time.perf_counter()
    canonical = expr.canonicalize()
    assert time.perf_counter() - start < 20.0
    assert len(canonical.children()) == 3001
    deep = x
    for _ in range(3000):
        deep = -(deep - 1.0)
    assert deep.canonicalize().shape == (3,)


def test_the_place_of_an_error_is_found_in_a_deep_tree() -> None:
    deep: tx.Expr = tx.Cross(x, tx.Concat(x, 1.0))
    for _ in range(3000):
        deep = tx.Sin(deep)
    with pytest.raises(ShapeError, match="Cross expects right with shape") as caught:
        deep.check_shape()
    assert "Cross" in str(caught.value.at)
    assert len(str(caught.value)) < 5000
