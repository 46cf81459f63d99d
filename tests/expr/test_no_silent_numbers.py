"""What was wrong in silence once: each is right now, or refused with a sentence that says how to mend it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.expr.fields import Operand, freeze

s, v = tx.State("s"), tx.State("v", shape=(3,))
A, B = tx.State("A", shape=(2, 2)), tx.State("B", shape=(2, 2))
X = {"A": np.array([[1.0, 2.0], [3.0, 4.0]]), "B": np.array([[5.0, 6.0], [7.0, 8.0]])}


def compiled(e: tx.Expr, **x: Any) -> np.ndarray:
    """The value through `tx.compile`, rewrites included."""
    leaves = [node for node in tx.expr.postorder(e) if isinstance(node, tx.State)]
    dynamics = tx.compile(tx.System(rates={leaf: 0.0 * leaf for leaf in leaves}, outputs={"e": e}))
    return np.asarray(dynamics.outputs(0.0, x)["e"])


@pytest.mark.parametrize(
    "index",
    [(1, slice(None), [0, 1]), (1, [0, 1]), ([0, 1], 1), (0, slice(None), [True, False]), (1, 0, [1, 1])],
    ids=str,
)
def test_an_index_of_mixed_kinds_through_a_join(index: Any) -> None:
    e = tx.Stack(A, B)[index]
    expected = np.stack([X["A"], X["B"]])[index]
    np.testing.assert_array_equal(compiled(e, **X), expected)
    np.testing.assert_array_equal(tx.lower(e)(0.0, X), expected)


@pytest.mark.parametrize("limit", [np.inf, -np.inf])
def test_comparisons_of_infinities(limit: float) -> None:
    for condition, holds in ((s >= limit, True), (s <= limit, True), (s == limit, True)):
        assert compiled(tx.Where(condition, 1.0, 2.0) + 0.0 * tx.Time(), s=limit) == (1.0 if holds else 2.0)


class Weighted(tx.Expr):
    """w . x with weights that are static."""

    x: Operand
    w: Any
    takes = ((2000,),)

    def evaluate(self, *values: Any) -> Any:
        return jnp.sum(jnp.asarray(self.w) * values[0])


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray, tuple, lambda w: {"w": w}, lambda w: [w, None]])
def test_long_static_fields_are_told_apart(kind: Callable[[Any], Any]) -> None:
    one, five = np.zeros(2000), np.zeros(2000)
    one[999], five[999] = 1.0, 5.0
    x = tx.State("x", shape=(2000,))
    assert Weighted(x, w=kind(one)).key() != Weighted(x, w=kind(five)).key()
    assert Weighted(x, w=kind(one)).key() == Weighted(x, w=kind(one.copy())).key()


def test_static_fields_of_any_type() -> None:
    def function(scale: float) -> Callable[[float], float]:
        return lambda x: scale * x

    values = [
        None, True, 1, 1.0, np.float32(1.0), np.int32(1), "1", b"1", 1j, (1,), [2], {"a": 1}, {"a": 2}, {1}, slice(1),
        ..., np.array([1.0]), np.array([1]), np.array([1.0], np.float32), jnp.array([2.0]), np.array([None]),
        function(1.0), function(2.0), np.array(["1"]), object(), tx.SE3, tx.SO3, tx.LINEAR_FIRST, tx.ANGULAR_FIRST,
        float, int,
    ]  # fmt: skip
    keys = [repr(freeze(value)) for value in values]
    assert len(set(keys)) == len(keys)
    assert keys == [repr(freeze(value)) for value in values]


def test_an_address_used_again_is_another_object() -> None:
    keys = {repr(freeze(lambda x, k=k: k * x)) for k in range(100)}  # each one is gone before the next is made
    assert len(keys) == 100


@pytest.mark.parametrize(
    "build",
    [
        lambda c: c + c, lambda c: 2.0 * c, lambda c: tx.Sin(c), lambda c: -c, lambda c: tx.Max(c, 0.5),
        lambda c: c <= 1.0, lambda c: tx.linalg.Sum(c), lambda c: np.eye(3) @ c, lambda c: c**2,
        lambda c: tx.linalg.Norm(c),
    ],
)  # fmt: skip
def test_conditions_are_no_numbers(build: Callable[[tx.Expr], tx.Expr]) -> None:
    with pytest.raises(tx.ModelError, match=r"expects numbers, got the condition .*(?s:.)*fix: .*tx.Where"):
        build(v <= 0.0)


@pytest.mark.parametrize("x", [1e-300, 1e-8, 0.3, 1e8, 1e160, 1e300])
def test_a_rounded_corner_does_not_overflow(x: float) -> None:
    e = tx.SmoothReLU(s, c=1e-8)
    expected = x * (x / (np.hypot(x, 1e-8) + 1e-8))
    np.testing.assert_allclose(tx.lower(e)(0.0, {"s": x}), expected, rtol=1e-14)
    np.testing.assert_allclose(tx.lower(tx.SmoothReLU(s))(0.0, {"s": np.float32(2e19)}), np.float32(2e19), rtol=1e-6)


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: np.fmax(v, 1.0), "tx.Max"),
        (lambda: np.fmin(v, 1.0), "tx.Min"),
        (lambda: np.hypot(v, 1.0), "tx.Sqrt"),
        (lambda: np.dot(tx.State("T", shape=(2, 2, 3)), tx.State("C", shape=(2, 3, 3))), "a @ b"),
        (lambda: np.block([tx.State("T", shape=(2, 2, 3))]), "tx.Block"),
    ],
)
def test_functions_of_numpy_that_no_node_means_are_refused(build: Callable[[], Any], said: str) -> None:
    with pytest.raises(TypeError, match=said):
        build()


def test_blocks_are_those_of_numpy() -> None:
    a, m = np.array([1.0, 2.0, 3.0]), X["A"]
    for build in (
        lambda a, s, m: np.block([a, s, a]),
        lambda a, s, m: np.block([[s, a], [s, a]]),
        lambda a, s, m: np.block([m, m]),
        lambda a, s, m: np.block([[m, m], [m, m]]),
    ):
        e = build(v, s, A)
        expected = build(a, np.array(0.5), m)
        assert e.shape == expected.shape
        np.testing.assert_array_equal(
            tx.lower(e)(0.0, {leaf: {"v": a, "s": 0.5, "A": m}[leaf] for leaf in names(e)}), expected
        )


def names(e: tx.Expr) -> list[str]:
    return [node.name for node in tx.expr.postorder(e) if isinstance(node, tx.State)]
