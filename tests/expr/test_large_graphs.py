"""Time and depth: shared graphs cost what their nodes cost, deep ones do not hit the recursion limit."""

import copy
import pickle
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import function_of

from twistax import expr as tx
from twistax.errors import ModelError, ShapeError
from twistax.expr import graph
from twistax.jax_inside import all_equations

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
    assert names.count("norm") == 1


def test_a_deep_chain_does_not_recurse() -> None:
    expr = deep_chain(2500)
    assert expr.check_shape() == (3,)
    assert expr.key() == deep_chain(2500).key()
    assert expr.canonicalize().shape == (3,)
    assert len(repr(expr)) < 10000
    assert len(expr.latex()) < 20000
    assert 60 < len(expr.tree().splitlines()) < 200
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
    for _ in range(1500):
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


def test_deep_and_wide_graphs_are_copied_and_printed_flatly() -> None:
    deep, wide = x, tx.Add(*(tx.Sin(x * float(i)) for i in range(1200)))
    for i in range(1200):
        deep = tx.Where(deep <= float(i), tx.Sin(deep), x)
    for expr in (deep, wide):
        data = pickle.dumps(expr)
        assert len(data) < 1200 * 500
        assert pickle.loads(data).key() == expr.key()
        assert copy.deepcopy(expr) is expr
        assert max(len(repr(expr)), len(expr.latex())) < 20_000
        assert len(expr.tree()) < 200_000
    assert wide.tree().endswith("... (3,602 nodes in all)")


def test_a_key_is_made_anew_where_a_node_is_unpickled() -> None:
    """It may count objects of the process, which are others elsewhere."""
    expr = tx.Sin(x)
    expr.key()
    assert "_key" not in pickle.loads(pickle.dumps(expr)).__dict__


# ---- branches --------------------------------------------------------------------------------------------------------

a, b = tx.State("a"), tx.State("b")


def _both(e: tx.Expr, k: int) -> tx.Expr:
    return tx.Cond(b <= float(k), tx.Sin(e) * 2.0, tx.Cos(e) + 1.0)


def _one(e: tx.Expr, k: int) -> tx.Expr:
    return tx.Cond(b <= float(k), tx.Sin(e) * 2.0, tx.Cos(b) + float(k))


def _inner(e: tx.Expr, k: int) -> tx.Expr:
    return tx.Cond(b <= float(k), tx.Cond(b <= 0.5 * k, tx.Sin(e), 2.0 * e), tx.Cos(e) + float(k))


def _predicate(e: tx.Expr, k: int) -> tx.Expr:
    return tx.Cond(tx.Cond(b <= float(k), e, e + 1.0) <= 0.3, tx.Sin(e), tx.Cos(e))


def _beside(e: tx.Expr, k: int) -> tx.Expr:
    return tx.Cond(b <= float(k), tx.Sin(e), b) + e


@pytest.mark.parametrize("link", [_both, _one, _inner, _predicate, _beside])
def test_nested_branches_are_traced_once(link: Callable[[tx.Expr, int], tx.Expr]) -> None:
    """What both branches need is computed before them: 30 in a row would else take a thousand million."""

    def chain(n: int) -> tx.Expr:
        e: tx.Expr = a
        for k in range(n):
            e = link(e, k)
        return e

    def conds(n: int) -> int:
        closed = jax.make_jaxpr(lambda values: function_of(chain(n))(values))(
            {"a": jnp.asarray(0.1), "b": jnp.asarray(0.2)}
        )
        return sum(eqn.primitive.name == "cond" for eqn in all_equations(closed.jaxpr))

    assert conds(30) == 3 * conds(10) <= 60
    values = {"a": jnp.asarray(0.1), "b": jnp.asarray(3.2)}
    expected = function_of(_wheres(chain(7)))(values)[0]
    np.testing.assert_allclose(function_of(chain(7))(values)[0], expected, rtol=1e-12)


def test_branches_that_share_again_and_again_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each reads the last in one branch of either condition: forty would else take a million million."""
    monkeypatch.setattr(graph, "_ANEW", 1_000)
    e: tx.Expr = a
    for k in range(40):
        e = tx.Cond(b <= float(k), tx.Sin(e), b) + tx.Cond(a <= float(k), tx.Cos(e), b)
    values = {"a": jnp.asarray(0.1), "b": jnp.asarray(0.2)}
    with pytest.raises(ModelError, match=r"(?s)branches of tx\.Cond share.*more than.*fix: use tx\.Where"):
        jax.eval_shape(function_of(e), values)
    assert jax.eval_shape(function_of(_wheres(e)), values)[0].shape == ()


def _wheres(root: tx.Expr) -> tx.Expr:
    """The same by entrywise choices."""
    done: dict[int, tx.Expr] = {}
    for node in tx.postorder(root):
        same = node.with_children([done[id(child)] for child in node.children()])
        done[id(node)] = tx.Where(*same.children()) if isinstance(node, tx.Cond) else same
    return done[id(root)]


def test_what_one_branch_needs_is_not_computed_for_the_other() -> None:
    """The root and its derivative do not exist where the branch is not taken, though two branches read them."""
    root = tx.Sqrt(a)
    expr = tx.Cond(a >= 0.0, root, b) + tx.Cond(a >= -1.0, tx.Cond(a >= 0.0, 2.0 * root, root**2 + 1.0), b)
    safe = tx.Cond(a >= 0.0, tx.Sin(root) + root, b)

    def slope(e: tx.Expr, at: float) -> float:
        return float(jax.grad(lambda v: function_of(e)({"a": v, "b": jnp.asarray(1.0)})[0])(at))

    assert slope(safe, -0.5) == 0.0
    assert slope(tx.Cond(b <= 0.0, expr, safe), -2.0) == 0.0
