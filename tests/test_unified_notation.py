"""Operators, kinematics and groups of docs/unified_notation.md against matrices written out in NumPy."""

import jax
import numpy as np
import pytest

import twistax as tx
from oracles import skew

rng = np.random.default_rng(5)
O = np.zeros((3, 3))


def hat(v: np.ndarray, w: np.ndarray) -> np.ndarray:
    return np.block([[skew(w), v[:, None]], [np.zeros((1, 4))]])


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues."""
    K = skew(axis / np.linalg.norm(axis))
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


R = turn(rng.normal(size=3), 1.1)
T = np.block([[R, rng.normal(size=(3, 1))], [np.array([0.0, 0.0, 0.0, 1.0])]])
xi, eta, F = rng.normal(size=(3, 6))
V, E, W = (tx.State(name, shape=(6,)) for name in "VEW")


def value(expr: tx.Expr, **leaves: np.ndarray) -> jax.Array:
    return tx.lower(expr)(0.0, leaves)


def close(found: object, wanted: np.ndarray) -> None:
    np.testing.assert_allclose(np.asarray(found), wanted, atol=1e-14, rtol=1e-14)


def velocity_of(system: tx.System, x: dict[str, np.ndarray], name: str) -> np.ndarray:
    """d/dt of a matrix-valued state: the derivative of x (+) t rate at t = 0."""
    dynamics = tx.compile(system)
    rate = dynamics(0.0, x)[name]
    group = dynamics.group.factors[name]
    return np.asarray(jax.jvp(lambda t: group.retract(x[name], t * rate), (0.0,), (1.0,))[1])


def test_hat_and_vee() -> None:
    w = tx.State("w", shape=(3,))
    close(value(tx.lie.Hat(w), w=xi[:3]), skew(xi[:3]))
    close(value(tx.lie.Hat(V), V=xi), hat(xi[:3], xi[3:]))
    close(value(tx.lie.Hat(V, order=tx.ANGULAR_FIRST), V=xi), hat(xi[3:], xi[:3]))
    X = tx.State("X", shape=(4, 4))
    close(value(tx.lie.Vee(X), X=hat(xi[:3], xi[3:])), xi)
    close(value(tx.lie.Vee(X, order=tx.ANGULAR_FIRST), X=hat(xi[3:], xi[:3])), xi)
    Y = tx.State("Y", shape=(3, 3))
    close(value(tx.lie.Vee(Y), Y=skew(xi[:3])), xi[:3])


def test_left_and_right_trivialised_kinematics() -> None:
    g, A = tx.State("g", group=tx.SE3), tx.State("A", group=tx.SO3)
    v, w = xi[:3], xi[3:]
    close(velocity_of(tx.System(rates={g: xi}), {"g": T}, "g"), T @ hat(v, w))
    close(velocity_of(tx.System(rates={A: w}), {"A": R}, "A"), R @ skew(w))
    spatial = tx.System(rates={g: tx.lie.SE3Adjoint(tx.lie.Inverse(g)) @ xi})
    close(velocity_of(spatial, {"g": T}, "g"), hat(v, w) @ T)
    spatial = tx.System(rates={A: tx.lie.SO3Adjoint(tx.lie.Inverse(A)) @ w})
    close(velocity_of(spatial, {"A": R}, "A"), skew(w) @ R)


def test_a_pose_state_in_the_other_order() -> None:
    g = tx.State("g", group=tx.SE3, order=tx.ANGULAR_FIRST)
    close(velocity_of(tx.System(rates={g: xi}), {"g": T}, "g"), T @ hat(xi[3:], xi[:3]))


def test_the_motion_and_force_cross_products() -> None:
    """As 6x6 matrices: Featherstone's for [w; v], and the same operators for [v; w]."""
    a, b = skew(xi[:3]), skew(xi[3:])  # of the first and the second half
    nodes = {
        tx.ANGULAR_FIRST: (np.block([[a, O], [b, a]]), np.block([[a, b], [O, a]])),
        tx.LINEAR_FIRST: (np.block([[b, a], [O, b]]), np.block([[b, O], [a, b]])),
    }
    for order, (motion, force) in nodes.items():
        close(value(tx.lie.Adjoint(V, E, order=order), V=xi, E=eta), motion @ eta)
        close(value(tx.lie.AdjointDual(V, W, order=order), V=xi, W=F), force @ F)


def test_rm_is_a_group() -> None:
    group = tx.Euclidean(3)
    assert group == tx.Euclidean((3,))
    a, b = rng.normal(size=(2, 3))
    close(group.compose(group.exp(a), group.exp(b)), a + b)
    close(group.retract(a, b), a + b)
    close(group.difference(a, b), b - a)
    close(group.right_jacobian(a), np.eye(3))
    close(group.ad(a), O)
    assert tx.State("y", group=group).shape == (3,)


def test_a_product_acts_part_by_part() -> None:
    group = tx.Product({"g": tx.SE3, "a": tx.SO3, "y": tx.Euclidean(2)})
    assert group.dimension == 11
    x = {"g": T, "a": R, "y": rng.normal(size=2)}
    d = rng.normal(size=11)
    there = group.retract(x, d)
    close(there["g"], T @ np.asarray(tx.lie.se3.exp(d[:6])))
    close(there["a"], R @ turn(d[6:9], float(np.linalg.norm(d[6:9]))))
    close(there["y"], x["y"] + d[9:])
    np.testing.assert_allclose(group.difference(x, there), d, atol=1e-13)
    blocks = np.asarray(group.Ad(x))
    assert not blocks[:6, 6:].any()
    assert not blocks[6:, :6].any()


@pytest.mark.parametrize("shape", [-1, 2.0, "3", (3, -1), [3]])
def test_a_size_that_is_none(shape: object) -> None:
    with pytest.raises(tx.ModelError, match=r"(?s)Euclidean expects a size .*fix: write Euclidean\(3\)"):
        tx.Euclidean(shape)  # type: ignore[arg-type]
