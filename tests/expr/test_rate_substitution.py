"""What becomes of a Rate where leaves are replaced: against derivatives by hand."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.expr import leaves_of, substitute

X, Y, V, W, P = tx.State("x"), tx.State("y"), tx.State("v"), tx.State("w"), tx.Parameter("p")
POINT = {"x": 3.0, "y": -0.5, "v": 1.5, "w": 0.7}


def value(expr: tx.Expr) -> float:
    states = {leaf.name for leaf in leaves_of(expr) if isinstance(leaf, tx.State)}
    return float(tx.lower(expr)(2.0, {name: POINT[name] for name in states}))


@pytest.mark.parametrize(
    ("rate", "exchange", "right"),
    [
        (tx.Rate(P * X, {X: V}), {P: X}, 2.0 * 3.0 * 1.5),
        (tx.Rate(P * X, {X: V}), {P: tx.Sin(X)}, (np.cos(3.0) * 3.0 + np.sin(3.0)) * 1.5),
        (tx.Rate(P * X, {X: V}), {P: 2.0}, 2.0 * 1.5),
        (tx.Rate(P * X * tx.Time(), {X: V}), {P: tx.Time()}, 4.0 * 1.5 + 2.0 * 2.0 * 3.0),
        (tx.Rate(X * X, {X: V}), {X: 2.0 * Y, V: 2.0 * W}, 2.0 * 4.0 * -0.5 * 0.7),
        (tx.Rate(X * Y, {X: 0.0, Y: W}), {X: 2.0 * V}, 2.0 * 1.5 * 0.7),
        (tx.Rate(P * X * Y, {X: V, Y: 0.0}), {P: X * Y}, 2.0 * 3.0 * 1.5 * 0.25),
        # A Rate in place of p: its x' = x is another motion, 2 x^2, and d/dt (2 x^3) = 6 x^2 v.
        (tx.Rate(P * X, {X: V, V: W}), {P: tx.Rate(X * X, {X: X})}, 6.0 * 3.0**2 * 1.5),
        (tx.Rate(tx.Rate(P * X, {X: V}), {X: V, V: W}), {P: X}, 2.0 * (1.5**2 + 3.0 * 0.7)),
    ],
)
def test_a_rate_after_a_substitution(rate: tx.Expr, exchange: dict[Any, Any], right: float) -> None:
    leaves = {leaf.key(): tx.Constant(e) if isinstance(e, float) else e for leaf, e in exchange.items()}
    assert value(substitute(rate, leaves)) == pytest.approx(right, rel=1e-14)


@pytest.mark.parametrize(
    ("rate", "exchange", "match"),
    [
        (
            tx.Rate(P * X, {X: V}),
            {P: Y},
            "replaces 'p', which has no rate, by an expression of the state 'y', whose rate is not known",
        ),
        (tx.Rate(P * X, {X: V}), {P: X, X: Y}, "state 'x', whose rate is not known"),
        (tx.Rate(P, {}), {P: X}, "state 'x', whose rate is not known"),
        (tx.Rate(P * X, {X: V}), {P: tx.Time()}, "time .*whose rate is not known"),
        (tx.Rate(X * Y, {X: V, Y: W}), {X: Y}, "replaces leaves with different rates by 'y'"),
        (tx.Rate(X * Y, {X: 0.0, Y: W}), {X: Y}, "replaces leaves with different rates by 'y'"),
    ],
)
def test_a_substitution_without_the_rate_is_refused(rate: tx.Expr, exchange: dict[Any, Any], match: str) -> None:
    with pytest.raises(tx.ModelError, match=match):
        substitute(rate, {leaf.key(): e for leaf, e in exchange.items()})


Q, QD = tx.State("q", shape=(3,)), tx.State("qd", shape=(3,))


@pytest.mark.parametrize("leaf", [Q, QD])
@pytest.mark.parametrize("shape", [(4,), (), (1, 3)])
def test_leaves_and_rates_of_another_shape_are_refused(leaf: tx.State, shape: tuple[int, ...]) -> None:
    other = substitute(tx.Rate(X * Q, {Q: QD, X: V}), {leaf.key(): tx.Constant(np.ones(shape))})
    with pytest.raises(tx.ShapeError, match=r"Rate expects (leaves|rates)\[\d\] with shape \(3,\), got"):
        tx.lower(other)


@pytest.mark.parametrize(
    "attempt",
    [
        lambda: tx.Rate(X > 0.1, {X: V}),
        lambda: tx.Rate(tx.All(Q <= 0.1), {Q: QD}),
        lambda: tx.Rate(Q == 0.1, {Q: QD}),
        lambda: tx.Rate(X * X, {X: V > 0.0}),
        lambda: substitute(tx.Rate(X * X, {X: V}), {X.key(): Y > 0.0}),
        lambda: substitute(tx.Rate(X * X, {X: V}), {V.key(): Y > 0.0}),
    ],
)
def test_conditions_are_refused(attempt: Callable[[], Any]) -> None:
    with pytest.raises(tx.ModelError, match=r"Rate expects numbers, got the condition (.|\n)*fix: choose the numbers"):
        attempt()


def test_a_rate_on_a_group_after_a_substitution() -> None:
    """The columns of R turn with R w, R' = R hat(w)."""
    R, w, e = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), np.array([1.0, 2.0, -0.5])
    q = tx.Parameter("q", shape=(3,))
    rate = substitute(tx.Rate(R @ q, {R: w}), {q.key(): R @ e})
    turn, spin = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.3, -0.2, 0.5])
    right = turn @ (np.cross(spin, turn @ e) + turn @ np.cross(spin, e))
    np.testing.assert_allclose(tx.lower(rate)(0.0, {"R": turn, "w": spin}), right, rtol=1e-14)
