"""Derivatives where the textbook has none: finite, and the documented ones."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import function_of

from twistax import expr as tx

x, y, v = tx.State("x"), tx.State("y"), tx.State("v", shape=(3,))


def derivatives(expr: tx.Expr, name: str, value: Any, **others: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradient forward and reverse, and the second derivative."""
    fixed = {k: jnp.asarray(o, float) for k, o in others.items()}

    def function(z: jax.Array) -> jax.Array:
        return function_of(expr)({name: z} | fixed)[0]

    z = jnp.asarray(value, float)
    forward, reverse, second = jax.jit(
        lambda z: (jax.jacfwd(function)(z), jax.jacrev(function)(z), jax.jacfwd(jax.jacrev(function))(z))
    )(z)
    return np.asarray(forward), np.asarray(reverse), np.asarray(second)


@pytest.mark.parametrize(
    ("expr", "at", "slope"),
    [
        (tx.Abs(x), 0.0, 0.0),
        (tx.Sign(x), 0.0, 0.0),
        (tx.Sqrt(x), 0.0, 0.0),
        (tx.Sqrt(tx.Square(x)), 0.0, 0.0),
        (tx.Asin(x), 1.0, 0.0),
        (tx.Asin(x), -1.0, 0.0),
        (tx.Acos(x), 1.0, 0.0),
        (tx.Acos(x), -1.0, 0.0),
        (tx.Max(x, 1.0), 1.0, 0.5),
        (tx.Min(x, 1.0), 1.0, 0.5),
        (tx.Max(2.0 * x, x + 1.0), 1.0, 1.5),
        (tx.PositivePart(x), 0.0, 0.5),
        (tx.SmoothReLU(x), 0.0, 0.0),
        (tx.Huber(x, delta=0.5), 0.5, 0.5),
        (tx.Linterp(x, [0.0, 1.0, 2.0], [0.0, 1.0, 5.0]), 1.0, 4.0),
        (tx.Linterp(x, [0.0, 1.0, 2.0], [0.0, 1.0, 5.0]), 0.0, 0.5),
        (tx.Linterp(x, [0.0, 1.0, 2.0], [0.0, 1.0, 5.0]), -0.1, 0.0),
        (tx.Norm(x), 0.0, 0.0),
        (x**2, 0.0, 0.0),
    ],
    ids=str,
)
def test_slope_of_a_scalar_function(expr: tx.Expr, at: float, slope: float) -> None:
    forward, reverse, second = derivatives(expr, "x", at)
    assert forward == reverse == slope
    assert np.isfinite(second)


@pytest.mark.parametrize("order", ["fro", 1, 2, 3.5, "inf", "-inf"])
def test_norm_at_zero_has_gradient_zero(order: Any) -> None:
    forward, reverse, second = derivatives(tx.Norm(v, order), "v", np.zeros(3))
    np.testing.assert_array_equal(forward, 0.0)
    np.testing.assert_array_equal(reverse, 0.0)
    assert np.isfinite(second).all()


def test_norm_close_to_zero_is_right() -> None:
    """The guard must not reach beyond zero itself."""
    forward, _, second = derivatives(tx.Norm(v), "v", np.array([3e-9, 0.0, 4e-9]))
    np.testing.assert_allclose(forward, [0.6, 0.0, 0.8], rtol=1e-12)
    np.testing.assert_allclose(second[1, 1], 1.0 / 5e-9, rtol=1e-12)


def test_atan2_at_the_origin() -> None:
    expr = tx.Atan2(x, y)
    forward, reverse, second = derivatives(expr, "x", 0.0, y=0.0)
    assert forward == reverse == 0.0
    assert np.isfinite(second)
    assert derivatives(expr, "x", 0.0, y=-2.0)[0] == -0.5


def test_one_branch_of_cond_is_evaluated() -> None:
    """A branch that is nan where it is not chosen spoils Where, and leaves Cond alone."""
    unsafe = tx.Sqrt(x)
    lazy = tx.Cond(x >= 0.1, unsafe, x)
    assert derivatives(lazy, "x", -1.0)[0] == 1.0
    assert derivatives(lazy, "x", -1.0)[1] == 1.0
    assert derivatives(lazy, "x", 4.0)[1] == 0.25
    assert np.isnan(derivatives(tx.Where(x >= 0.1, unsafe, x), "x", -1.0)[1])


def test_cond_computes_its_branches_inside() -> None:
    """The work of the branches stands inside the conditional; what both and others share stands outside once."""
    shared = tx.Sin(x)
    expr = tx.Cond(x >= 0.0, tx.Exp(tx.Cos(x)), tx.Tanh(shared)) + shared
    jaxpr = jax.make_jaxpr(lambda z: function_of(shared, expr)({"x": z}))(1.0)
    outside = [equation.primitive.name for equation in jaxpr.eqns]
    assert outside.count("sin") == 1
    assert "cond" in outside
    assert not {"exp", "cos", "tanh"} & set(outside)


def test_cond_under_vmap_and_nested() -> None:
    inner = tx.Cond(x <= 2.0, 10.0 * x, x)
    expr = tx.Cond(x <= 0.0, -x, inner)
    points = jnp.array([-1.0, 1.0, 3.0])
    found = jax.vmap(lambda z: function_of(expr)({"x": z})[0])(points)
    np.testing.assert_array_equal(found, [1.0, 10.0, 3.0])
    np.testing.assert_array_equal([function_of(expr)({"x": z})[0] for z in points], found)
