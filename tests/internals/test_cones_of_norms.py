"""Norms that are restated as second-order cones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import quick_jit

import twistax as tx
from twistax.expr import Constraint, Expr, Inputs, evaluate_all
from twistax.expr import Norm as NormNode
from twistax.trajectory.problem.terms import without_norms

Norm = tx.linalg.Norm


X, U, S = tx.State("x", shape=(3,)), tx.Control("u", shape=(3,)), tx.Control("s")


def values(rows: list[Expr], x: np.ndarray, u: np.ndarray, s: np.ndarray) -> np.ndarray:
    """(points, rows)."""

    def one(x: jax.Array, u: jax.Array, s: jax.Array) -> jax.Array:
        inputs = Inputs(jnp.zeros(()), {"x": x}, {"u": u, "s": s}, {}, s.dtype)
        return jnp.stack(evaluate_all(rows, lambda leaf: leaf.read(inputs)))

    return np.asarray(quick_jit(jax.vmap(one))(x, u, s))


def has_norm(expr: Expr) -> bool:
    return isinstance(expr, NormNode) or any(map(has_norm, expr.children()))


SMOOTH = {
    "disc": (Norm(U) <= 1.0, 1),
    "cone": (Norm(U) <= S, 2),
    "scaled": (2.0 * Norm(U) + S <= 3.0, 2),
    "turned round": (Norm(U - X) / 4.0 <= 3.0 - S / 2.0, 2),
    "outside": (Norm(U) >= 1.0, 1),
    "halved": (Norm(X) / 2.0 - S <= 0.0, 2),
}


KEPT = {
    "two norms": Norm(U) + Norm(X) <= 1.0,
    "outside of a cone": Norm(U) >= S,
    "no norm": U @ U <= S,
    "a vector": Norm(X) >= U,
    "a norm in a product": Norm(U) * S <= 1.0,
}


@pytest.mark.parametrize(("constraint", "count"), SMOOTH.values(), ids=SMOOTH)
def test_rows_hold_where_the_constraint_does(constraint: Constraint, count: int) -> None:
    residual, rng = constraint.residual().canonicalize(), np.random.default_rng(0)
    rows = without_norms(residual)
    assert len(rows) == count
    assert not any(map(has_norm, rows))
    x, u = rng.normal(size=(2, 200, 3)) * rng.uniform(0.2, 2.0, size=(2, 200, 1))
    points = x, u, 8.0 * rng.normal(size=200) * rng.uniform(0.01, 1.0, size=200)
    signs = values([residual], *points)[:, 0] <= 0.0
    np.testing.assert_array_equal((values(rows, *points) <= 0.0).all(axis=1), signs)
    assert 10 < sum(signs) < 190


@pytest.mark.parametrize("constraint", KEPT.values(), ids=KEPT)
def test_what_is_no_cone_stays_as_it_is(constraint: Constraint) -> None:
    residual = constraint.residual().canonicalize()
    (row,) = without_norms(residual)
    assert row is residual


def test_a_bound_that_is_negative_leaves_no_point() -> None:
    """|u| <= -1 holds nowhere, though u.u <= (-1)^2 may."""
    rows = without_norms((Norm(U) + 1.0 <= 0.0).residual().canonicalize())
    assert values(rows, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1)).max() > 0.0
