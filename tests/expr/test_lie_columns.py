"""Twists and wrenches side by side, as the columns of (6, k): values, cost and orders; transposes and inverses too."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import function_of
from lie_oracles import CASES, agree, batched, each, join, poses, split

import twistax as tx
from oracles import skew
from twistax import lie
from twistax.expr import Expr, leaves_of

L, A = tx.LINEAR_FIRST, tx.ANGULAR_FIRST
ORDERS = pytest.mark.parametrize("order", [L, A], ids=str)
RNG = np.random.default_rng(17)
T, H, B = poses(RNG), RNG.normal(size=(CASES, 6, 3)), RNG.normal(size=(CASES, 6))
g, h = tx.State("g", group=tx.SE3), tx.State("H", (6, 3))
b, q, r, p = tx.State("b", (6,)), tx.State("q", (3,)), tx.State("r", group=tx.SO3), tx.State("p", (3,))


def moved_twist(X: np.ndarray, xi: np.ndarray, order: tx.Order) -> np.ndarray:
    """A velocity and a rate seen from the other frame, part by part."""
    v, w = split(xi, order)
    R, p = X[:3, :3], X[:3, 3]
    return join(R @ v + np.cross(p, R @ w), R @ w, order)


def moved_wrench(X: np.ndarray, F: np.ndarray, order: tx.Order) -> np.ndarray:
    f, tau = split(F, order)
    R, p = X[:3, :3], X[:3, 3]
    return join(R @ f, R @ tau + np.cross(p, R @ f), order)


KINDS = [(lie.SE3Adjoint, moved_twist), (lie.SE3AdjointDual, moved_wrench)]


@ORDERS
@pytest.mark.parametrize(("matrix", "moved"), KINDS)
def test_columns_move_one_by_one(matrix: Any, moved: Callable[..., np.ndarray], order: tx.Order) -> None:
    def by_hand(X: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return np.stack([moved(X, column, order) for column in columns.T], axis=1)

    back = np.linalg.inv(T)
    for expr, poses_used in ((matrix(g, order=order) @ h, T), (matrix(lie.Inverse(g), order=order) @ h, back)):
        agree(batched(expr.canonicalize(), g=T, H=H), each(by_hand, poses_used, H))


@ORDERS
@pytest.mark.parametrize(("matrix", "moved"), KINDS[::-1])
def test_the_transpose_is_the_dual_of_the_inverse(
    matrix: Any, moved: Callable[..., np.ndarray], order: tx.Order
) -> None:
    """Ad_T' F = Ad*_(T^-1) F, and the other way round: `moved` belongs to the other matrix."""
    other = KINDS[0][1] if moved is moved_wrench else KINDS[1][1]
    wanted = each(lambda X, x: other(X, x, order), np.linalg.inv(T), B)
    agree(batched((matrix(g, order=order).T @ b).canonicalize(), g=T, b=B), wanted)


@ORDERS
def test_known_parts_of_columns(order: tx.Order) -> None:
    """Parts taken and joined again, and a translation and a rotation of columns."""
    linear, angular = lie.linear(h, order), lie.angular(h, order)
    swapped = batched(lie.twist(linear=angular, angular=linear, order=order), H=H)
    agree(swapped, np.roll(H, 3, axis=1))
    R, P = T[:, :3, :3], T[:, :3, 3]
    zero = np.zeros((3, 3))
    blocks = {
        "p": np.stack([np.block([[np.eye(3), skew(x)], [zero, np.eye(3)]]) for x in P]),
        "r": np.stack([np.block([[x, zero], [zero, x]]) for x in R]),
    }
    for name, pose, values in (("p", lie.translation(p), P), ("r", lie.rotation(r), R)):
        matrix = blocks[name] if order is L else np.roll(blocks[name], 3, axis=(1, 2))
        found = batched((lie.SE3Adjoint(pose, order=order) @ h).canonicalize(), H=H, **{name: values})
        agree(found, each(lambda M, X: M @ X, matrix, H))


def test_vector_products_with_columns() -> None:
    """Column by column; NumPy's function, which reads rows, is not given columns."""
    square = tx.State("X", (3, 3))
    P, X = RNG.normal(size=(CASES, 3)), RNG.normal(size=(CASES, 3, 3))
    agree(batched(tx.linalg.Cross(p, -square), p=P, X=X), each(lambda a, B: -np.cross(a, B.T).T, P, X))
    agree(batched(np.cross(p, square[0]), p=P, X=X), each(lambda a, B: np.cross(a, B[0]), P, X))
    for columns in (square, np.eye(3)):
        with pytest.raises(TypeError, match=r"np\.cross of expressions accepts vectors"):
            np.cross(p, columns)


def equations(expr: Expr) -> list[Any]:
    values = {leaf.name: jnp.ones(leaf.shape) for leaf in leaves_of(expr.canonicalize()) if hasattr(leaf, "guess")}
    return list(jax.make_jaxpr(function_of(expr.canonicalize()))(values).jaxpr.eqns)


#: expression -> multiplications
COSTS = {
    "columns": (lie.SE3Adjoint(g) @ h, 3 * 24),
    "columns back": (lie.SE3AdjointDual(lie.Inverse(g), order=A) @ h, 3 * 24),
    "translated columns": (lie.SE3Adjoint(lie.translation(p)) @ h, 3 * 6),
    "translated columns back": (lie.SE3AdjointDual(lie.Inverse(lie.translation(p)), order=A) @ h, 3 * 6),
    "rotated columns": (lie.SE3AdjointDual(lie.rotation(r)) @ h, 3 * 18),
    "columns that slide": (lie.SE3Adjoint(g) @ np.vstack([np.full((3, 2), 0.5), np.zeros((3, 2))]), 2 * 9),
    "columns that slide along the axes": (lie.SE3Adjoint(g) @ np.eye(6)[:, :3], 0),
    "columns times rates": (lie.SE3Adjoint(g) @ h @ q, 18 + 24),
    "a transpose": (lie.SE3Adjoint(g).T @ b, 24),
    "an inverse": (tx.linalg.Inv(lie.SE3AdjointDual(g, order=A)) @ b, 24),
    "a solve": (tx.linalg.Solve(lie.SE3Adjoint(g), b), 24),
    "two frames": (lie.SE3Adjoint(g) @ lie.SE3Adjoint(g) @ b, 2 * 24),
    "a bracket with an axis": (lie.Adjoint(b, np.eye(6)[5]), 12),
    "a moving force": (lie.AdjointDual(b, lie.wrench(force=p, torque=np.zeros(3))), 12),
}


@pytest.mark.parametrize("what", COSTS)
def test_cost(what: str) -> None:
    expr, count = COSTS[what]
    found = equations(expr)
    # An entry of R x is a sum of products: the product array has one axis more than the result.
    assert sum(int(np.prod(e.outvars[0].aval.shape)) for e in found if str(e.primitive) == "mul") == count
    assert not {"dot_general", "div"} & {str(e.primitive) for e in found}
    assert not {(6, 6), (4, 4)} & {tuple(out.aval.shape) for e in found for out in e.outvars}


def test_shapes_are_checked() -> None:
    for node in (lie.AdjointAction, lie.CoadjointAction):
        with pytest.raises(tx.ShapeError, match=rf"{node.__name__} expects \w+ with shape \(6,\), got \(3, 6\)"):
            node(g, h.T).check_shape()
    with pytest.raises(tx.ShapeError, match=r"JoinedParts expects angular with shape \(3, 3\), got \(3,\)"):
        lie.twist(linear=lie.linear(h), angular=p).check_shape()
    with pytest.raises(tx.ShapeError, match=r"Pose expects position with shape \(3,\), got \(6,\)"):
        lie.translation(b).check_shape()
    with pytest.raises(TypeError, match="AdjointAction expects inverse=True or inverse=False, got 1"):
        lie.AdjointAction(g, b, inverse=1)


# ---- orders ------------------------------------------------------------------------------------------------------

M, K, n = tx.State("M", (6, 6)), tx.State("K", (6, 6)), tx.State("n", (6,))


def system(**outputs: Expr) -> Callable[[], tx.System]:
    states = {leaf.name: leaf for expr in outputs.values() for leaf in leaves_of(expr) if isinstance(leaf, tx.State)}
    rates = {x: np.zeros(6) if x.group == tx.SE3 else 0.0 * x for x in states.values()}
    return lambda: tx.System(rates=rates, outputs=outputs)


MIXED = {
    "columns of one order moved in another": system(y=lie.AdjointAction(g, h, order=A), z=lie.linear(h)),
    "the result": system(y=lie.angular(lie.CoadjointAction(g, h, order=A))),
    "six columns": system(y=lie.AdjointAction(g, M, order=A), z=lie.linear(M @ n)),
    "parts of six columns": system(y=lie.linear(M, order=A), z=lie.linear(M @ n)),
}


@pytest.mark.parametrize("what", MIXED)
def test_two_orders_meet(what: str) -> None:
    with pytest.raises(tx.OrderError):
        MIXED[what]()


SOUND = {
    "rows of one order": system(y=lie.AdjointAction(g, h, order=A), z=lie.linear(h, order=A)),
    "six joints drive hands of two orders": system(
        y=lie.AdjointAction(g, M, order=A) @ n, z=lie.CoadjointAction(g, K) @ n, w=lie.angular(M @ n, order=A)
    ),
    "parts of both hands": system(y=lie.linear(M, order=A) @ n, z=lie.linear(K) @ n),
}


@pytest.mark.parametrize("what", SOUND)
def test_one_order_is_enough(what: str) -> None:
    SOUND[what]()
