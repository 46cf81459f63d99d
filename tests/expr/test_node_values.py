"""Every family against NumPy and SciPy, whose formulas are not ours."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.special
from expr_cases import value_of
from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator, RegularGridInterpolator
from scipy.spatial.transform import Rotation

from twistax import expr as tx

RNG = np.random.default_rng(7)
V, W, S = RNG.normal(size=3), RNG.normal(size=3), 0.37
M, N, P = RNG.normal(size=(3, 3)), RNG.normal(size=(3, 3)), RNG.normal(size=(2, 3))
Q, R = RNG.normal(size=4), RNG.normal(size=4)
T = RNG.normal(size=(2, 3, 3))
KNOTS, TABLE, LINES = np.array([0.0, 0.5, 2.0, 3.0]), RNG.normal(size=(4, 3)), np.array([-1.0, 0.0, 4.0])
VALUES = {"v": V, "w": W, "s": S, "m": M, "n": N, "p": P, "q": Q, "r": R, "t": T}
v, w, s, m, n, p, q, r, t = (tx.State(name, shape=np.shape(value)) for name, value in VALUES.items())
INSIDE = np.array([-0.5, 0.1, 0.5, 1.7, 3.0, 3.5])


def xyzw(quaternion: np.ndarray) -> np.ndarray:
    return np.roll(quaternion, -1)


ONE_OPERAND: list[tuple[Any, Callable[..., Any]]] = [
    (tx.Sin, np.sin),
    (tx.Cos, np.cos),
    (tx.Tan, np.tan),
    (tx.Atan, np.arctan),
    (tx.Sinh, np.sinh),
    (tx.Cosh, np.cosh),
    (tx.Tanh, np.tanh),
    (tx.Exp, np.exp),
    (tx.Abs, np.abs),
    (tx.Sign, np.sign),
    (tx.Square, np.square),
    (tx.Neg, np.negative),
    (tx.PositivePart, lambda x: np.maximum(x, 0)),
    (lambda x: tx.Huber(x, delta=0.3), lambda x: scipy.special.huber(0.3, x)),
    (tx.Diag, np.diag),
    (tx.SSM, lambda x: np.cross(x, np.eye(3), axisb=0).T @ np.eye(3)),
    (lambda x: tx.SmoothReLU(x, c=0.2), lambda x: np.sqrt(np.maximum(x, 0) ** 2 + 0.04) - 0.2),
]


@pytest.mark.parametrize(("node", "reference"), ONE_OPERAND)
def test_functions_of_a_vector(node: Callable[..., tx.Expr], reference: Callable[..., Any]) -> None:
    np.testing.assert_allclose(value_of(node(v), v=V), reference(V), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(("node", "reference"), [(tx.Sqrt, np.sqrt), (tx.Log, np.log)])
def test_functions_of_positive_numbers(node: Any, reference: Callable[..., Any]) -> None:
    np.testing.assert_allclose(value_of(node(v), v=np.abs(V)), reference(np.abs(V)), rtol=1e-14)


@pytest.mark.parametrize(("node", "reference"), [(tx.Asin, np.arcsin), (tx.Acos, np.arccos)])
def test_inverse_circular_functions(node: Any, reference: Callable[..., Any]) -> None:
    x = tx.State("x", shape=(7,))
    points = np.array([-1.0, -0.999999, -0.3, 0.0, 1e-9, 0.7, 1.0])
    np.testing.assert_allclose(value_of(node(x), x=points), reference(points), rtol=1e-14, atol=1e-15)
    assert np.isnan(value_of(node(x), x=1.5 * np.ones(7))).all()


CASES: list[tuple[tx.Expr, Any]] = [
    (tx.Atan2(v, w), np.arctan2(V, W)),
    (tx.Max(v, w, 0.1), np.maximum(np.maximum(V, W), 0.1)),
    (tx.Min(v, s), np.minimum(V, S)),
    (tx.LogSumExp(v, w, s), np.log(np.exp(V) + np.exp(W) + np.exp(S))),
    (tx.Where(v <= 0.0, w, s), np.where(V <= 0, W, S)),
    (tx.Cond(s <= 0.5, v, s), V),
    (tx.Cond(s <= 0.1, v, s), np.full(3, S)),
    (tx.Cond([s <= 0.5, s >= 0.4], v, w), W),
    (tx.All(v <= 10.0, s <= 1.0), True),
    (tx.All([v <= 10.0, s >= 1.0]), False),
    (tx.Any(v >= 10.0, s <= 1.0), True),
    (tx.Any(v >= 10.0), False),
    (v <= w, V <= W),
    (v >= w, V >= W),
    (v == v + 0.0, [True] * 3),
    (v + m, V + M),
    (m - s, M - S),
    (p * v, P * V),
    (v / m, V / M),
    (tx.Square(v) ** s, (V**2) ** S),
    (m @ n, M @ N),
    (p @ v, P @ V),
    (v @ m, V @ M),
    (t @ v, T @ V),
    (t @ n, T @ N),
    (m.T, M.T),
    (t.T, np.swapaxes(T, 1, 2)),
    (v.T, V),
    (tx.Sum(p), P.sum()),
    (tx.Trace(m), np.trace(M)),
    (tx.Dot(v, w), V @ W),
    (tx.Cross(v, w), np.cross(V, W)),
    (tx.Outer(v, q), np.outer(V, Q)),
    (tx.Inv(m), np.linalg.inv(M)),
    (tx.Inv(t), np.linalg.inv(T)),
    (tx.Inv(m[:2, :2]), np.linalg.inv(M[:2, :2])),
    (tx.Inv(m[:1, :1]), 1.0 / M[:1, :1]),
    (tx.Solve(m, v), np.linalg.solve(M, V)),
    (tx.Solve(m[1:, 1:], v[1:]), np.linalg.solve(M[1:, 1:], V[1:])),
    (tx.Solve(m, n), np.linalg.solve(M, N)),
    (tx.Solve(tx.Outer(q, r) + np.eye(4), q), np.linalg.solve(np.outer(Q, R) + np.eye(4), Q)),
    (tx.Concat(v, s, q), np.concatenate([V, [S], Q])),
    (tx.Concat(p, m), np.concatenate([P, M])),
    (tx.Stack([v, w]), np.stack([V, W])),
    (tx.Stack(s, 2.0), np.array([S, 2.0])),
    (tx.Hstack([p, p[:, :1]]), np.hstack([P, P[:, :1]])),
    (tx.Hstack([v, s]), np.hstack([V, S])),
    (tx.Vstack([p, v]), np.vstack([P, V])),
    (tx.Vstack([v, w]), np.vstack([V, W])),
    (tx.Block([[m, v[:, None]], [w, s]]), np.block([[M, V[:, None]], [W, S]])),
    (tx.Block([[s, 1.0], [0.0, s]]), np.array([[S, 1.0], [0.0, S]])),
    (tx.Block([v, w]), np.concatenate([V, W])[None]),
    (tx.Block([[t], [t]]), np.concatenate([T, T])),
    (m[1, -1], M[1, -1]),
    (m[1:, ::-1], M[1:, ::-1]),
    (m[..., 0, None], M[..., 0, None]),
    (m[[2, 0], [0, 1]], M[[2, 0], [0, 1]]),
    (v[np.array([True, False, True])], V[[0, 2]]),
    (tx.QDCM(q), Rotation.from_quat(xyzw(Q)).as_matrix()),
    (tx.QuaternionProduct(q, r), np.roll((Rotation.from_quat(xyzw(Q)) * Rotation.from_quat(xyzw(R))).as_quat(), 1)),
    (tx.Linterp(s, KNOTS, TABLE[:, 0]), np.interp(S, KNOTS, TABLE[:, 0])),
    (tx.Linterp(tx.Constant(INSIDE) + s * 0.0, KNOTS, TABLE[:, 0]), np.interp(INSIDE, KNOTS, TABLE[:, 0])),
    (tx.Linterp(s, KNOTS[:2], TABLE[:2]), TABLE[0] + S / 0.5 * (TABLE[1] - TABLE[0])),
    (tx.Cinterp(INSIDE + s, KNOTS, TABLE[:, 0]), CubicSpline(KNOTS, TABLE[:, 0])(INSIDE + S)),
    (tx.Cinterp(INSIDE + s, KNOTS, TABLE), CubicSpline(KNOTS, TABLE)(INSIDE + S)),
    (tx.Cinterp(INSIDE + s, KNOTS, TABLE, method="pchip"), PchipInterpolator(KNOTS, TABLE)(INSIDE + S)),
    (
        tx.Cinterp(INSIDE + s, KNOTS, TABLE, method="akima"),
        Akima1DInterpolator(KNOTS, TABLE, extrapolate=True)(INSIDE + S),
    ),
    (
        tx.Bilerp(INSIDE + s, v[0], KNOTS, LINES, TABLE),
        RegularGridInterpolator((KNOTS, LINES), TABLE)(
            np.stack([np.clip(INSIDE + S, 0, 3), np.full(6, np.clip(V[0], -1, 4))], axis=1)
        ),
    ),
    *(
        (tx.Norm(v, ord), np.linalg.norm(V, o))
        for ord, o in ((1, 1), (2, 2), (3.5, 3.5), ("inf", np.inf), ("-inf", -np.inf))
    ),
    *((tx.Norm(p, ord), np.linalg.norm(P, o)) for ord, o in (("fro", None), (1, 1), (2, 2), ("inf", np.inf))),
    (tx.Norm(t), np.sqrt((T**2).sum())),
    (tx.Norm(s - 1.0), 1.0 - S),
    (tx.Norm(v, np.inf), np.abs(V).max()),
]


@pytest.mark.parametrize(("expr", "reference"), CASES, ids=[str(expr)[:60] for expr, _ in CASES])
def test_against_numpy_and_scipy(expr: tx.Expr, reference: Any) -> None:
    for form in (expr, expr.canonicalize()):
        found = value_of(form, **VALUES)
        assert found.shape == np.shape(reference) == form.shape
        if isinstance(expr, tx.QuaternionProduct):
            # SciPy normalises, and the sign of a unit quaternion is free there.
            length = np.linalg.norm(Q) * np.linalg.norm(R)
            found = found / length * np.sign(found @ reference)
        np.testing.assert_allclose(found, reference, rtol=1e-12, atol=1e-13)


def test_quaternion_kinematics_moves_the_rotation_matrix() -> None:
    """With q' = SSMP(w) q / 2 the matrix R(q) moves by R' = R [w]x: a body rate, q scalar first."""
    unit = Q / np.linalg.norm(Q)
    rate = 0.5 * value_of(tx.SSMP(w) @ q, w=W, q=unit)
    step = 1e-6
    ahead, behind = (value_of(tx.QDCM(q), q=unit + sign * step * rate) for sign in (1.0, -1.0))
    cross = np.cross(W, np.eye(3)).T
    np.testing.assert_allclose((ahead - behind) / (2 * step), value_of(tx.QDCM(q), q=unit) @ cross, atol=1e-9)
    np.testing.assert_allclose(value_of(tx.SSM(w), w=W), cross, atol=1e-15)


def test_log_sum_exp_does_not_overflow() -> None:
    np.testing.assert_allclose(value_of(tx.LogSumExp(s, 0.0), s=5000.0), 5000.0)
    np.testing.assert_allclose(value_of(tx.LogSumExp(s, s), s=-5000.0), -5000.0 + np.log(2.0))


def test_smooth_relu_keeps_its_digits() -> None:
    """The textbook form loses all of them here: sqrt(x^2 + c^2) - c with x = 1e-6 c."""
    np.testing.assert_allclose(value_of(tx.SmoothReLU(s, c=1.0), s=1e-6), 5e-13, rtol=1e-10)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_small_systems_neither_overflow_nor_underflow(scale: float) -> None:
    """In float32 the product of three entries of these matrices leaves the range of numbers."""
    import jax.numpy as jnp
    from expr_cases import function_of

    values = {"m": jnp.asarray(scale * M, jnp.float32), "v": jnp.asarray(V, jnp.float32)}
    inverse, solution = function_of(tx.Inv(m), tx.Solve(m, v))(values)
    np.testing.assert_allclose(inverse, np.linalg.inv(M) / scale, rtol=1e-5)
    np.testing.assert_allclose(solution, np.linalg.solve(M, V) / scale, rtol=1e-5)


def test_singular_matrices_give_no_finite_answer() -> None:
    assert not np.isfinite(value_of(tx.Inv(m), m=np.zeros((3, 3)))).any()
    assert not np.isfinite(value_of(tx.Solve(m, v), m=np.diag([1.0, 1.0, 0.0]), v=V)).all()
