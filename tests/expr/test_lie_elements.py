"""Which matrices are known to be rotations or poses from how they are made, and what it costs to know."""

import numpy as np
import pytest

import twistax as tx
from twistax import lie
from twistax.expr import Expr

g, r = tx.State("g", group=tx.SE3), tx.State("r", group=tx.SO3)
A, B = tx.State("A", (4, 4)), tx.Parameter("B", (3, 3))
a, w, q = tx.State("a", (6,)), tx.State("w", (3,)), tx.State("q", (4,))
TURN = np.asarray(tx.pose(position=[1.0, 2.0, 3.0], euler=[0.3, -0.4, 0.5]))

KNOWN: dict[str, Expr] = {
    "a pose state": g,
    "an exponential": lie.SE3Exp(a),
    "a rotation exponential": lie.SO3Exp(w),
    "an inverse": lie.Inverse(g),
    "a product": lie.Compose(g, lie.SE3Exp(a)),
    "a matrix product": TURN @ g,
    "a pose put together": lie.Pose(r, w),
    "the rotation of a pose": g[:3, :3],
    "the same, counted": g[0:-1, :3:1],
    "a transposed rotation": r.T,
    "the rotation of a quaternion": tx.spatial.QDCM(q),
    "a constant": tx.Constant(TURN),
}
NOT_KNOWN: dict[str, Expr] = {
    "a matrix state": A,
    "a parameter": B,
    "a product with a plain matrix": lie.Compose(g, A),
    "a plain matrix put together": lie.Pose(B, w),
    "a transposed pose": g.T,
    "the mean of two poses": 0.5 * (g + TURN),
    "minus a rotation": -r,
    "columns in another order": g[:3, [1, 0, 2]],
    "another block": g[1:, 1:],
    "rows of a rotation": r[:2],
    "the logarithm": lie.SE3Log(g),
    "an adjoint": lie.SE3Adjoint(g),
    "a twist as a matrix": lie.Hat(a),
    "a reflection": tx.Constant(TURN @ np.diag([1.0, 1.0, -1.0, 1.0])),
    "a scaled rotation": tx.Constant(1.001 * TURN[:3, :3]),
    "a projective matrix": tx.Constant(TURN + np.eye(4)[3][:, None] * 0.1),
    "no numbers": tx.Constant(np.full((4, 4), np.nan)),
    "another size": tx.Constant(np.eye(2)),
    "truth values": tx.Constant(np.eye(3, dtype=bool)),
}


@pytest.mark.parametrize("what", KNOWN)
def test_known(what: str) -> None:
    assert KNOWN[what].is_group_element


@pytest.mark.parametrize("what", NOT_KNOWN)
def test_not_known(what: str) -> None:
    assert not NOT_KNOWN[what].is_group_element


def test_a_chain_that_doubles_is_known_at_once() -> None:
    """Sixty squarings of a pose: sixty nodes, 2^60 factors."""
    chain: Expr = g
    for _ in range(60):
        chain = lie.Compose(chain, chain)
    assert lie.SE3Exp(lie.SE3Log(chain)).canonicalize().key() == chain.canonicalize().key()


def test_a_long_chain_needs_no_deep_recursion() -> None:
    chain: Expr = g
    turned = TURN @ g
    for _ in range(3000):
        chain = lie.Compose(chain, turned)
    assert chain.is_group_element
    assert lie.Inverse(lie.Inverse(chain)).canonicalize().key() == chain.canonicalize().key()
