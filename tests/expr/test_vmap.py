"""Vmap: one expression over the elements of a batch."""

import copy
import pickle
from typing import Any

import jax
import numpy as np
import pytest
from expr_cases import function_of, value_of

from twistax import expr as tx
from twistax.errors import ModelError, ShapeError

POINTS = np.arange(12.0).reshape(4, 3) ** 1.3
x, points, radii = tx.State("x", shape=(3,)), tx.Parameter("points", shape=(4, 3)), tx.Parameter("radii", shape=(4,))
VALUES = {"x": np.array([0.5, -1.0, 2.0]), "points": POINTS, "radii": np.array([1.0, 2.0, 3.0, 40.0])}


def distances() -> np.ndarray:
    return np.linalg.norm(POINTS - VALUES["x"], axis=1)


def test_over_constants_and_parameters() -> None:
    for batch in (POINTS, points, tx.Constant(POINTS), 1.0 * points):
        expr = tx.Vmap(lambda p: tx.Norm(x - p), batch=batch)
        assert expr.shape == (4,)
        np.testing.assert_allclose(value_of(expr, **VALUES), distances(), rtol=1e-14)
        np.testing.assert_allclose(value_of(expr.canonicalize(), **VALUES), distances(), rtol=1e-14)


def test_over_several_batches_and_another_axis() -> None:
    expr = tx.Vmap(lambda p, r: r * tx.Norm(x - p), batch=[points, radii])
    np.testing.assert_allclose(value_of(expr, **VALUES), VALUES["radii"] * distances(), rtol=1e-14)
    columns = tx.Vmap(lambda c: tx.Stack(tx.Sum(c), c[0]), batch=points, axis=1)
    assert columns.shape == (3, 2)
    np.testing.assert_allclose(value_of(columns, **VALUES), np.stack([POINTS.sum(0), POINTS[0]], axis=1), rtol=1e-14)


def test_a_constraint_on_every_element() -> None:
    expr = tx.Vmap(lambda p, r: tx.Norm(x - p) <= r, batch=[points, radii])
    assert isinstance(expr, tx.Inequality)
    assert expr.shape == (4,)
    np.testing.assert_array_equal(value_of(expr, **VALUES), distances() <= VALUES["radii"])
    np.testing.assert_allclose(value_of(expr.residual(), **VALUES), distances() - VALUES["radii"], rtol=1e-13)
    assert isinstance(tx.Vmap(lambda p: p[0] == 1.0, batch=points), tx.Equality)
    assert value_of(tx.Any(expr), **VALUES) == (distances() <= VALUES["radii"]).any()


def test_predicates_inside() -> None:
    expr = tx.Vmap(lambda p: tx.Cond(tx.All(p >= 1.0), p[0], -1.0), batch=points)
    np.testing.assert_allclose(value_of(expr, **VALUES), np.where((POINTS >= 1.0).all(axis=1), POINTS[:, 0], -1.0))
    assert tx.Vmap(lambda p: tx.All(p >= 1.0), batch=points).boolean


def test_nested_maps_do_not_mix_their_elements() -> None:
    expected = POINTS @ POINTS.T
    inside = tx.Vmap(lambda p: tx.Vmap(lambda q: p @ q, batch=points), batch=points)
    np.testing.assert_allclose(value_of(inside, **VALUES), expected, rtol=1e-14)
    # The inner map is built outside of the outer one: both placeholders stand at the same depth.
    total = tx.Vmap(lambda q: q @ x, batch=points)
    mixed = tx.Vmap(lambda p: p[0] * total, batch=points)
    np.testing.assert_allclose(value_of(mixed, **VALUES), np.outer(POINTS[:, 0], POINTS @ VALUES["x"]), rtol=1e-14)
    np.testing.assert_allclose(value_of(mixed.canonicalize(), **VALUES), value_of(mixed, **VALUES), rtol=1e-14)


def test_keys_are_structural() -> None:
    def build(weight: float = 2.0) -> tx.Expr:
        return tx.Vmap(lambda p: weight * tx.Norm(x - p), batch=points)

    assert build().key() == build().key()
    assert build().key() != build(3.0).key()
    assert build().key() != tx.Vmap(lambda p: 2.0 * tx.Norm(x - p), batch=1.0 * points).key()
    square = tx.Parameter("square", shape=(3, 3))
    assert tx.Vmap(lambda p: p @ x, square).key() != tx.Vmap(lambda p: p @ x, square, axis=1).key()
    assert build().replace is not None
    for same in (copy.deepcopy(build()), pickle.loads(pickle.dumps(build()))):
        assert same.key() == build().key()
        np.testing.assert_allclose(value_of(same, **VALUES), 2.0 * distances(), rtol=1e-14)


def test_leaves_of_the_body_are_children() -> None:
    expr = tx.Vmap(lambda p: tx.Norm(x - p), batch=points)
    assert {child.name for child in expr.children()} == {"points", "x"}
    names: list[str] = []
    tx.traverse(expr, lambda node: names.append(getattr(node, "name", "")))
    assert {"points", "x"} <= set(names)
    assert "Norm" in expr.tree()


def test_the_body_is_simplified_and_baked() -> None:
    gain = tx.Parameter("gain")
    expr = tx.Vmap(lambda p: gain * p @ x + 0.0 * tx.Sum(p), batch=points)
    body = expr.canonicalize().body
    assert "Sum" not in repr(body)
    baked = tx.substitute(expr, {gain.key(): tx.Constant(2.0)})
    assert {child.name for child in baked.children()} == {"points", "x", "constant"}
    np.testing.assert_allclose(value_of(baked, **VALUES), 2.0 * POINTS @ VALUES["x"], rtol=1e-14)


def test_it_lowers_to_one_map() -> None:
    """The number of operations does not grow with the batch."""
    counts = []
    for n in (2, 50):
        expr = tx.Vmap(lambda p: tx.Sin(p) @ x, batch=np.ones((n, 3)))
        counts.append(len(jax.make_jaxpr(lambda z, e=expr: function_of(e)({"x": z}))(np.ones(3)).eqns))
    assert counts[0] == counts[1]


def test_errors() -> None:
    with pytest.raises(ShapeError, match=r"batch 0 to have the axis 2, got shape \(4, 3\)"):
        tx.Vmap(lambda p: p, batch=points, axis=2)
    with pytest.raises(ShapeError, match="equal length along axis 0, got 4 and 3"):
        tx.Vmap(lambda p, q: p, batch=[points, x])
    with pytest.raises(ModelError, match="at least one batch"):
        tx.Vmap(lambda: x, batch=[])
    with pytest.raises(ShapeError, match="Dot expects two vectors"):
        tx.Vmap(lambda p: tx.Dot(p, radii), batch=points).check_shape()
    escaped: list[tx.Expr] = []
    tx.Vmap(lambda p: escaped.append(p) or p, batch=points)
    with pytest.raises((ModelError, KeyError)):
        value_of(escaped[0], **VALUES)


def test_elements_of_another_shape_after_a_substitution_are_refused() -> None:
    """Another length is not."""
    mapped = tx.Vmap(lambda p: 2.0 * p, batch=points)
    longer = tx.substitute(mapped, {points.key(): tx.Constant(np.ones((7, 3)))})
    np.testing.assert_array_equal(value_of(longer), np.full((7, 3), 2.0))
    for other in (tx.Parameter("b", shape=(5, 2)), tx.Constant(np.ones(3)), tx.Constant(np.ones((4, 3, 1)))):
        with pytest.raises(ShapeError, match=r"expects elements of batch 0 with shape \(3,\)"):
            tx.substitute(mapped, {points.key(): other}).check_shape()
    with pytest.raises(ShapeError, match="elements of batch 1"):
        tx.substitute(
            tx.Vmap(lambda r, p: r * p, [radii, points]), {points.key(): tx.Constant(np.ones((4, 2)))}
        ).check_shape()


@pytest.mark.parametrize("axis", [True, 1.0, -1, None])
def test_an_axis_that_is_no_whole_number_is_refused(axis: Any, unchecked: None) -> None:
    with pytest.raises(ShapeError, match="Vmap: axis must be a whole number of 0 or more"):
        tx.Vmap(lambda p: p, batch=points, axis=axis)
    assert tx.Vmap(lambda p: p, batch=points, axis=np.int64(1)).check_shape() == (3, 4)


def test_a_batch_of_conditions_is_refused() -> None:
    with pytest.raises(ModelError, match=r"Vmap expects numbers, got the condition (.|\n)*fix: choose the numbers"):
        tx.Vmap(lambda p: -p, batch=x > 0.5)
    with pytest.raises(ModelError, match="Vmap expects numbers, got the condition"):
        tx.substitute(tx.Vmap(lambda p: -p, batch=x), {x.key(): x > 0.5})
    mapped = tx.Vmap(lambda p: -p, batch=np.array([True, False]))
    np.testing.assert_array_equal(value_of(mapped), [-1.0, 0.0])
