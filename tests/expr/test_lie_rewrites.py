"""What `canonicalize` does to Lie nodes, and what it leaves alone; each case is also computed both ways."""

from typing import Any

import jax
import numpy as np
import pytest
from expr_cases import function_of
from lie_oracles import sides

import twistax as tx
from twistax import lie
from twistax.expr import Expr

L, A = tx.LINEAR_FIRST, tx.ANGULAR_FIRST
g, h = tx.State("g", group=tx.SE3), tx.State("h", group=tx.SE3)
r, r2 = tx.State("r", group=tx.SO3), tx.State("r2", group=tx.SO3)
#: Matrices that are no poses and no rotations, and nobody said they were.
P, Q = tx.State("P", (4, 4)), tx.State("Q", (3, 3))
a, b, w, v = tx.State("a", (6,)), tx.State("b", (6,)), tx.State("w", (3,)), tx.State("v", (3,))
H = tx.State("H", (6, 2))
EYE3, EYE4, ZERO = np.eye(3), np.eye(4), np.zeros(6)
TURN = tx.pose(position=[1.0, 2.0, 3.0], euler=[0.3, -0.4, 0.5])

RNG = np.random.default_rng(3)
VALUES = {
    "g": TURN,
    "h": tx.pose(position=[-1.0, 0.5, 2.0], euler=[1.3, 0.4, -2.5]),
    "r": TURN[:3, :3],
    "r2": TURN[:3, :3].T @ TURN[:3, :3].T,
    "P": RNG.normal(size=(4, 4)),
    "Q": RNG.normal(size=(3, 3)),
    "a": RNG.normal(size=6) * 3.0,
    "b": RNG.normal(size=6),
    "w": RNG.normal(size=3) * 3.0,
    "v": RNG.normal(size=3),
    "H": RNG.normal(size=(6, 2)),
}

inverse, compose, act, cross = lie.Inverse, lie.Compose, lie.Act, tx.linalg.Cross


def joined(linear: Any, angular: Any, order: tx.Order = L) -> Expr:
    return lie.twist(linear=linear, angular=angular, order=order)


REWRITES: dict[str, tuple[Expr, Expr]] = {
    "bracket with itself": (lie.Adjoint(a, a), tx.Constant(ZERO)),
    "bracket with its own structure, in the other order": (lie.Adjoint(a + b, a + b, order=A), tx.Constant(ZERO)),
    "bracket with zero": (lie.Adjoint(a, ZERO), tx.Constant(ZERO)),
    "body without momentum": (lie.AdjointDual(a, 0.0 * b), tx.Constant(ZERO)),
    "body at rest": (lie.AdjointDual(ZERO, b, order=A), tx.Constant(ZERO)),
    "Ad @ twist": (lie.SE3Adjoint(g) @ a, lie.AdjointAction(g, a)),
    "Ad @ twist, [w; v]": (lie.SE3Adjoint(g, order=A) @ a, lie.AdjointAction(g, a, order=A)),
    "Ad* @ wrench": (lie.SE3AdjointDual(g) @ b, lie.CoadjointAction(g, b)),
    "Ad* @ wrench, [w; v]": (lie.SE3AdjointDual(g, order=A) @ b, lie.CoadjointAction(g, b, order=A)),
    "Ad of any matrix": (lie.SE3Adjoint(P) @ a, lie.AdjointAction(P, a)),
    "two frames": (lie.SE3Adjoint(g) @ lie.SE3Adjoint(h) @ a, lie.AdjointAction(g, lie.AdjointAction(h, a))),
    "Ad of the identity": (lie.SE3Adjoint(EYE4), tx.Constant(np.eye(6))),
    "Ad* of the identity": (lie.SE3AdjointDual(compose(g, inverse(g))), tx.Constant(np.eye(6))),
    "Ad of the identity @ twist": (lie.SE3Adjoint(EYE4) @ a, a),
    "action of the identity": (lie.AdjointAction(EYE4, a), a),
    "coaction of the identity": (lie.CoadjointAction(EYE4, a, order=A), a),
    "action on zero": (lie.AdjointAction(g, ZERO), tx.Constant(ZERO)),
    "coaction on zero": (lie.CoadjointAction(g, ZERO), tx.Constant(ZERO)),
    "there and back": (lie.SE3Adjoint(inverse(g)) @ (lie.SE3Adjoint(g) @ a), a),
    "back and there, wrench": (lie.SE3AdjointDual(g, order=A) @ (lie.SE3AdjointDual(inverse(g), order=A) @ b), b),
    "Ad of a rotation": (lie.SO3Adjoint(r) @ w, r @ w),
    "Ad of any 3x3 matrix": (lie.SO3Adjoint(Q), Q),
    "Exp(Log(T)) of a state": (lie.SE3Exp(lie.SE3Log(g)), g),
    "Exp(Log(T)), [w; v]": (lie.SE3Exp(lie.SE3Log(g, order=A), order=A), g),
    "Exp(Log(R)) of a state": (lie.SO3Exp(lie.SO3Log(r)), r),
    "Exp(Log()) of a product": (lie.SE3Exp(lie.SE3Log(g @ h)), g @ h),
    "Exp(Log()) of composed poses": (lie.SE3Exp(lie.SE3Log(compose(g, h))), compose(g, h)),
    "Exp(Log()) of an exponential": (lie.SE3Exp(lie.SE3Log(lie.SE3Exp(a))), lie.SE3Exp(a)),
    "Exp(Log()) of a pose's rotation": (lie.SO3Exp(lie.SO3Log(g[:3, :3])), g[:3, :3]),
    "Exp(Log()) of a transpose": (lie.SO3Exp(lie.SO3Log(r.T)), r.T),
    "Exp(Log()) of a built pose": (lie.SE3Exp(lie.SE3Log(lie.Pose(r, v))), lie.Pose(r, v)),
    "Exp(0)": (lie.SE3Exp(0.0 * a), tx.Constant(EYE4)),
    "Exp(0) of a rotation": (lie.SO3Exp(0.0 * w), tx.Constant(EYE3)),
    "Jacobian at 0": (lie.RightJacobianInverse(0.0 * a) @ b, b),
    "T^-1 T": (compose(inverse(g), g), tx.Constant(EYE4)),
    "R R^-1": (compose(r, inverse(r)), tx.Constant(EYE3)),
    "T^-1 (T S)": (compose(inverse(g), compose(g, P)), P),
    "(S T) T^-1": (compose(compose(P, g), inverse(g)), P),
    "(S T^-1) T": (compose(compose(h, inverse(g)), g), h),
    "a product's inverse": (compose(inverse(compose(g, h)), compose(compose(g, h), P)), P),
    "identity on the left": (compose(EYE4, P), P),
    "identity on the right": (compose(Q, EYE3), Q),
    "inverse of an inverse": (inverse(inverse(g)), g),
    "a point there and back": (act(inverse(g), act(g, v)), v),
    "the identity acts": (act(EYE3, v), v),
    "Hat(w) @ v": (lie.Hat(w) @ v, tx.linalg.Cross(w, v)),
    "Vee(Hat(w))": (lie.Vee(lie.Hat(w)), w),
    "Vee(Hat(xi)), [w; v]": (lie.Vee(lie.Hat(a, order=A), order=A), a),
    "a part of a twist": (lie.linear(lie.twist(linear=v, angular=w)), v),
    "the other part, [w; v]": (lie.angular(lie.wrench(force=v, torque=w, order=A), order=A), w),
    "Reorder twice": (lie.Reorder(lie.Reorder(a, order=A)), a),
    "Ad' @ wrench": (lie.SE3Adjoint(g).T @ b, lie.CoadjointAction(g, b, inverse=True)),
    "Ad*' @ twist, [w; v]": (lie.SE3AdjointDual(g, order=A).T @ a, lie.AdjointAction(g, a, order=A, inverse=True)),
    "Ad'": (lie.SE3Adjoint(g, order=A).T, lie.SE3AdjointDual(inverse(g), order=A)),
    "Ad*'": (lie.SE3AdjointDual(g).T, lie.SE3Adjoint(inverse(g))),
    "Ad^-1": (tx.linalg.Inv(lie.SE3Adjoint(g)), lie.SE3Adjoint(inverse(g))),
    "Ad*^-1": (tx.linalg.Inv(lie.SE3AdjointDual(inverse(g), order=A)), lie.SE3AdjointDual(g, order=A)),
    "Solve(Ad, x)": (tx.linalg.Solve(lie.SE3Adjoint(g), a), lie.AdjointAction(g, a, inverse=True)),
    "Solve(Ad*, columns)": (tx.linalg.Solve(lie.SE3AdjointDual(g), H), lie.CoadjointAction(g, H, inverse=True)),
    "Ad of an inverse @ twist": (lie.SE3Adjoint(inverse(g)) @ a, lie.AdjointAction(g, a, inverse=True)),
    "the inverse action of an inverse": (lie.AdjointAction(inverse(g), a, inverse=True), lie.AdjointAction(g, a)),
    "Ad @ columns": (lie.SE3Adjoint(g) @ H, lie.AdjointAction(g, H)),
    "Ad* @ columns": (lie.SE3AdjointDual(P) @ H, lie.CoadjointAction(P, H)),
    "(Ad H) q": (lie.SE3Adjoint(g) @ H @ v[:2], lie.AdjointAction(g, H @ v[:2])),
    "there and back, columns": (lie.SE3Adjoint(inverse(g)) @ (lie.SE3Adjoint(g) @ H), H),
    "inverse of a translation": (inverse(lie.translation(v)), lie.translation(-v)),
    "inverse of a rotation's pose": (inverse(lie.rotation(Q)), lie.rotation(inverse(Q))),
    "translated twist": (
        lie.SE3Adjoint(lie.translation(v)) @ a,
        joined(lie.linear(a) + cross(v, lie.angular(a)), lie.angular(a)),
    ),
    "translated twist, [w; v]": (
        lie.SE3Adjoint(lie.translation(v), order=A) @ a,
        joined(lie.linear(a, A) + cross(v, lie.angular(a, A)), lie.angular(a, A), A),
    ),
    "rotated wrench": (lie.SE3AdjointDual(lie.rotation(r)) @ b, joined(act(r, lie.linear(b)), act(r, lie.angular(b)))),
    "rotated columns": (lie.SE3Adjoint(lie.rotation(r)) @ H, joined(r @ lie.linear(H), r @ lie.angular(H))),
    "a velocity": (lie.SE3Adjoint(g) @ joined(v, ZERO[:3]), joined(act(g[:3, :3], v), ZERO[:3])),
    "a torque": (lie.SE3AdjointDual(g) @ joined(ZERO[:3], v), joined(ZERO[:3], act(g[:3, :3], v))),
    "an axis": (lie.SE3Adjoint(h) @ np.eye(6)[5], joined(cross(h[:3, 3], h[:3, :3][:, 2]), h[:3, :3][:, 2])),
    "a rate, back": (
        lie.SE3Adjoint(inverse(g)) @ joined(ZERO[:3], w),
        joined(act(inverse(g[:3, :3]), -cross(g[:3, 3], w)), act(inverse(g[:3, :3]), w)),
    ),
    "columns of torques, back": (
        lie.SE3AdjointDual(inverse(g)) @ joined(np.zeros((3, 2)), lie.linear(H)),
        joined(np.zeros((3, 2)), inverse(g[:3, :3]) @ lie.linear(H)),
    ),
    "bracket with a velocity": (lie.Adjoint(a, joined(v, ZERO[:3])), joined(cross(lie.angular(a), v), ZERO[:3])),
    "coadjoint of a torque, [w; v]": (
        lie.AdjointDual(a, joined(ZERO[:3], v, A), order=A),
        joined(ZERO[:3], cross(lie.angular(a, A), v), A),
    ),
    "R 0": (act(r, 0.0 * v), tx.Constant(ZERO[:3])),
    "R times a unit vector": (act(Q, 2.0 * EYE3[1]), 2.0 * Q[:, 1]),
    "x cross 0": (cross(v, 0.0 * w), tx.Constant(ZERO[:3])),
    "(-x) cross (-y)": (cross(-v, -w), cross(v, w)),
    "a part of columns": (lie.linear(joined(lie.angular(H), lie.linear(H))), lie.angular(H)),
    "Ad' of a constant pose": (lie.SE3Adjoint(TURN).T @ b, lie.CoadjointAction(inverse(TURN), b)),
    "Ad*^-1 of one": (
        tx.linalg.Inv(lie.SE3AdjointDual(TURN, order=A)) @ H,
        lie.CoadjointAction(inverse(TURN), H, order=A),
    ),
    "Solve(Ad, x) of one": (tx.linalg.Solve(lie.SE3Adjoint(TURN), a), lie.AdjointAction(inverse(TURN), a)),
    "constants": (lie.SE3Exp(np.r_[1.0, 2.0, 3.0, 0.0, 0.0, 0.0]), tx.Constant(tx.pose(position=[1.0, 2.0, 3.0]))),
}

#: (expression, why it must stay as it is)
KEPT: dict[str, Expr] = {
    "Log(Exp(xi)): beyond a half turn it is another twist": lie.SE3Log(lie.SE3Exp(a)),
    "Log(Exp(w))": lie.SO3Log(lie.SO3Exp(w)),
    "Exp(Log(M)) of what may be no pose": lie.SE3Exp(lie.SE3Log(P)),
    "Exp(Log(M)) of what may be no rotation": lie.SO3Exp(lie.SO3Log(Q)),
    "Exp(Log(T)) in two orders": lie.SE3Exp(lie.SE3Log(g, order=A), order=L),
    "a product with what may be no pose": lie.SE3Exp(lie.SE3Log(g @ P)),
    "another corner of a pose": lie.SO3Exp(lie.SO3Log(g[1:4, 1:4])),
    "M^-1 M of what may be no pose": compose(inverse(P), P),
    "M M^-1 of what may be no rotation": compose(Q, inverse(Q)),
    "(M^-1)^-1 of what may be no pose": inverse(inverse(P)),
    "a point moved by what may be no pose": act(inverse(P), act(P, v)),
    "a twist moved by what may be no pose": lie.AdjointAction(inverse(P), lie.AdjointAction(P, a)),
    "two frames that differ": lie.AdjointAction(g, lie.AdjointAction(h, a), inverse=True),
    "there and back in two orders": lie.AdjointAction(g, lie.AdjointAction(g, a, order=A), inverse=True),
    "a twist and a wrench": lie.AdjointAction(g, lie.CoadjointAction(g, a), inverse=True),
    "there and there again": lie.CoadjointAction(g, lie.CoadjointAction(g, a)),
    "the inverse of what may be no pose": lie.CoadjointAction(inverse(P), a),
    "Ad' of what may be no pose": lie.SE3Adjoint(P).T,
    "Ad^-1 of what may be no pose": tx.linalg.Inv(lie.SE3AdjointDual(P)),
    "Solve(Ad, x) of what may be no pose": tx.linalg.Solve(lie.SE3Adjoint(P), a),
    "zeros in a half of the other order": lie.AdjointAction(g, lie.twist(linear=v, angular=ZERO[:3]), order=A),
    "a unit vector moved by a pose": act(g, EYE3[0]),
    "columns moved by any pose": lie.AdjointAction(g, H),
    "the same pose twice": compose(g, g),
    "Hat(Vee(M)) of what may be no twist": lie.Hat(lie.Vee(P)),
    "Vee(Hat(xi)) in two orders": lie.Vee(lie.Hat(a), order=A),
    "a part in the other order": lie.linear(lie.twist(linear=v, angular=w), order=A),
    "Hat of a twist times a point": lie.Hat(a) @ tx.Concat(v, 1.0),
}


@pytest.mark.parametrize("what", REWRITES)
def test_rewrite(what: str) -> None:
    expr, wanted = REWRITES[what]
    found = expr.canonicalize()
    assert found.key() == wanted.canonicalize().key(), f"{found!r} instead of {wanted!r}"
    assert found.check_shape() == expr.check_shape()


@pytest.mark.parametrize("what", KEPT)
def test_no_rewrite(what: str) -> None:
    assert KEPT[what].canonicalize().key() == KEPT[what].key()


def test_values_are_kept() -> None:
    """Every case as written and as rewritten, in one compiled call."""
    cases = [*(pair[0] for pair in REWRITES.values()), *KEPT.values()]
    flat = tx.Concat(*(_flat(expr) for expr in cases))
    # Nearly all the time of this test is XLA's: nothing here depends on how much it optimises.
    plainly = {"xla_backend_optimization_level": 0}
    written, simpler = jax.jit(function_of(flat, flat.canonicalize()), compiler_options=plainly)(VALUES)
    np.testing.assert_allclose(written, simpler, rtol=1e-11, atol=1e-11)
    assert len(written) > 600


def _flat(expr: Expr) -> Expr:
    return expr if expr.ndim == 1 else tx.Concat(*(row for row in expr))


@pytest.mark.parametrize("order", [L, A])
def test_log_of_exp_beyond_a_half_turn_is_another_twist(order: tx.Order) -> None:
    angle = 4.0
    value = np.r_[1.0, 2.0, 3.0, 0.0, 0.0, angle] if order is L else np.r_[0.0, 0.0, angle, 1.0, 2.0, 3.0]
    written, simpler = sides(lie.SE3Log(lie.SE3Exp(a, order=order), order=order), {"a": value})
    np.testing.assert_allclose(simpler, written)
    found = simpler[5] if order is L else simpler[2]
    assert found == pytest.approx(angle - 2.0 * np.pi)


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, 1.0, -1.0, 1.0]), 2.0 * EYE4, EYE4 + 1e-3, np.full((4, 4), np.nan), np.ones((4, 4))]
)
def test_a_constant_counts_as_a_pose_only_if_it_is_one(matrix: np.ndarray) -> None:
    assert not tx.Constant(matrix).is_group_element
    assert not tx.Constant(matrix[:3, :3]).is_group_element
    assert compose(inverse(matrix @ g), matrix @ g).canonicalize().key() != tx.Constant(EYE4).key()
    assert tx.Constant(TURN).is_group_element
    assert compose(inverse(TURN @ g), TURN @ g).canonicalize().key() == tx.Constant(EYE4).key()
