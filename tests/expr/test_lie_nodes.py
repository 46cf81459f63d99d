"""Every Lie operator against points, forces, commutators and matrix exponentials, in both orders.

No formula of the package is used as its own reference. Where a pairing is checked, each side is transformed by itself.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lie_oracles import (
    CASES,
    agree,
    batched,
    batched_all,
    each,
    hat,
    join,
    moved,
    poses,
    skew,
    split,
    total_wrench,
    vee,
)
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import twistax as tx
from twistax import lie
from twistax.jax_inside import all_equations

ORDERS = pytest.mark.parametrize("order", [tx.LINEAR_FIRST, tx.ANGULAR_FIRST], ids=str)
RNG = np.random.default_rng(11)
A, B = RNG.normal(size=(2, CASES, 6)) * 2.0
T, S = poses(RNG), poses(RNG)
R = T[:, :3, :3]
W, V = RNG.normal(size=(2, CASES, 3))
POINTS, VECTORS = RNG.normal(size=(2, CASES, 5, 3))
#: Twists up to an angle of about 6 rad, with translations of every size.
LARGE = RNG.normal(size=(CASES, 6)) * np.repeat([1.5, 1.8], 3)
#: Twists within a half turn.
SMALL = np.concatenate([RNG.normal(size=(CASES, 3)) * 10.0, RNG.uniform(-1.7, 1.7, size=(CASES, 3))], axis=1)

a, b, w, v = tx.State("a", (6,)), tx.State("b", (6,)), tx.State("w", (3,)), tx.State("v", (3,))
t, s, r, m = (tx.State(name, (n, n)) for name, n in (("t", 4), ("s", 4), ("r", 3), ("m", 6)))


def reordered(values: np.ndarray, order: tx.Order) -> np.ndarray:
    """Linear-first vectors in the given order."""
    return join(values[..., :3], values[..., 3:], order)


# ---- the small operators -----------------------------------------------------------------------------------------


@ORDERS
def test_the_bracket_is_the_commutator(order: tx.Order) -> None:
    def commutator(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        X, Y = hat(x, order), hat(y, order)
        return vee(X @ Y - Y @ X, order)

    agree(batched(lie.Adjoint(a, b, order=order), a=A, b=B), each(commutator, A, B))


@ORDERS
def test_the_coadjoint_is_the_momentum_balance_of_a_moving_frame(order: tx.Order) -> None:
    """Momentum fixed in space, seen from a frame that moves with the twist, changes by -ad*_xi(mu)."""

    def slope(xi: np.ndarray, points: np.ndarray, momenta: np.ndarray) -> np.ndarray:
        def seen(time: float) -> np.ndarray:
            back = expm(-time * hat(xi, order))
            return total_wrench(moved(back, points), momenta @ back[:3, :3].T, order)

        h = 1e-3
        near, far = (seen(k * h) - seen(-k * h) for k in (1, 2))
        return (8.0 * near - far) / (12.0 * h)

    momentum = each(lambda p, q: total_wrench(p, q, order), POINTS, VECTORS)
    found = batched(lie.AdjointDual(a, b, order=order), a=A, b=momentum)
    agree(found, -each(slope, A, POINTS, VECTORS), 1e-8)


@ORDERS
def test_bracket_and_coadjoint_are_dual(order: tx.Order) -> None:
    """<ad*_xi mu, eta> + <mu, ad_xi eta> = 0."""
    eta = RNG.normal(size=(CASES, 6))
    turned = batched(lie.AdjointDual(a, b, order=order), a=A, b=B)
    bracket = batched(lie.Adjoint(a, b, order=order), a=A, b=eta)
    agree(np.sum(turned * eta, axis=1), -np.sum(B * bracket, axis=1))


# ---- change of frame ---------------------------------------------------------------------------------------------


def twist_nodes(order: tx.Order) -> list[tx.Expr]:
    return [lie.SE3Adjoint(t, order=order) @ a, lie.AdjointAction(t, a, order=order)]


def wrench_nodes(order: tx.Order) -> list[tx.Expr]:
    return [lie.SE3AdjointDual(t, order=order) @ b, lie.CoadjointAction(t, b, order=order)]


@ORDERS
def test_a_twist_changes_frame_as_velocities_of_points_do(order: tx.Order) -> None:
    """The body's points p move with xi^ p in frame b; the same motion in frame a moves T p with T xi^ p."""
    ones = np.concatenate([POINTS, np.ones((CASES, 5, 1))], axis=2)
    for node in twist_nodes(order):
        found = batched(node, t=T, a=A)
        in_a = each(lambda xi, X, p: (X @ p.T).T @ hat(xi, order).T, found, T, ones)
        wanted = each(lambda xi, X, p: (X @ hat(xi, order) @ p.T).T, A, T, ones)
        agree(in_a, wanted)


@ORDERS
def test_a_wrench_changes_frame_as_forces_at_points_do(order: tx.Order) -> None:
    in_b = each(lambda p, f: total_wrench(p, f, order), POINTS, VECTORS)
    in_a = each(lambda X, p, f: total_wrench(moved(X, p), f @ X[:3, :3].T, order), T, POINTS, VECTORS)
    for node in wrench_nodes(order):
        agree(batched(node, t=T, b=in_b), in_a)


@ORDERS
def test_power_is_the_same_in_both_frames(order: tx.Order) -> None:
    """Twist and wrench go to the other frame each by its own operator."""
    for twist, wrench in zip(twist_nodes(order), wrench_nodes(order), strict=True):
        xi, F = batched(twist, t=T, a=A), batched(wrench, t=T, b=B)
        agree(np.sum(xi * F, axis=1), np.sum(A * B, axis=1))


@ORDERS
def test_frames_compose(order: tx.Order) -> None:
    """Ad of a product is the product, in the same order of factors; so is Ad*."""
    for node, (name, value) in ((lie.SE3Adjoint, ("a", A)), (lie.SE3AdjointDual, ("b", B))):
        vector = {"a": a, "b": b}[name]
        once = batched(node(t @ s, order=order) @ vector, t=T, s=S, **{name: value})
        twice = batched(node(t, order=order) @ (node(s, order=order) @ vector), t=T, s=S, **{name: value})
        agree(once, twice)


@ORDERS
def test_the_adjoint_of_an_exponential_is_the_exponential_of_the_bracket(order: tx.Order) -> None:
    def ad(xi: np.ndarray) -> np.ndarray:
        X, units = hat(xi, order), [hat(unit, order) for unit in np.eye(6)]
        return np.stack([vee(X @ E - E @ X, order) for E in units], axis=1)

    brackets = each(ad, A)
    agree(batched(lie.SE3Adjoint(lie.SE3Exp(a, order=order), order=order), a=A), each(expm, brackets), 1e-11)
    dual = batched(lie.SE3AdjointDual(lie.SE3Exp(a, order=order), order=order), a=A)
    agree(dual, each(lambda M: expm(-M.T), brackets), 1e-11)


def test_the_adjoint_of_a_rotation_is_the_rotation() -> None:
    agree(batched(lie.SO3Adjoint(r) @ w, r=R, w=W), each(lambda M, u: M @ u, R, W))


# ---- exponential, logarithm, Jacobians ---------------------------------------------------------------------------


@ORDERS
def test_exp_is_the_matrix_exponential(order: tx.Order) -> None:
    agree(batched(lie.SE3Exp(a, order=order), a=LARGE), each(lambda xi: expm(hat(xi, order)), LARGE))


def test_exp_of_a_rotation_vector() -> None:
    agree(batched(lie.SO3Exp(w), w=W), Rotation.from_rotvec(W).as_matrix())


@ORDERS
def test_log_finds_the_twist_within_a_half_turn(order: tx.Order) -> None:
    xi = reordered(SMALL, order)
    agree(batched(lie.SE3Log(t, order=order), t=each(lambda x: expm(hat(x, order)), xi)), xi, 1e-11)


def test_log_of_a_rotation() -> None:
    agree(batched(lie.SO3Log(r), r=R), Rotation.from_matrix(R).as_rotvec())


def pulled_back(xi: np.ndarray, to_matrix: Any, to_vector: Any) -> tuple[np.ndarray, np.ndarray]:
    """The matrices of d -> Exp(xi + d) Exp(xi)^-1 and of d -> Exp(xi)^-1 Exp(xi + d) at d = 0, by differences."""
    h, back = 1e-3, expm(-to_matrix(xi))
    left, right = [], []
    for unit in np.eye(xi.size):
        steps = [expm(to_matrix(xi + k * h * unit)) for k in (-2, -1, 1, 2)]
        slope = (steps[0] - 8.0 * steps[1] + 8.0 * steps[2] - steps[3]) / (12.0 * h)
        left.append(to_vector(slope @ back))
        right.append(to_vector(back @ slope))
    return np.stack(left, axis=1), np.stack(right, axis=1)


def axial(X: np.ndarray) -> np.ndarray:
    return np.array([X[2, 1], X[0, 2], X[1, 0]])


def check_jacobians(tangent: tx.Expr, values: np.ndarray, to_matrix: Any, to_vector: Any, **static: Any) -> None:
    nodes = (lie.LeftJacobian, lie.RightJacobian, lie.LeftJacobianInverse, lie.RightJacobianInverse)
    found = batched_all(*(node(tangent, **static) for node in nodes), **{tangent.name: values})
    pairs = [pulled_back(xi, to_matrix, to_vector) for xi in values]
    left, right = (np.stack(side) for side in zip(*pairs, strict=True))
    for jacobian, wanted in zip(found, (left, right, np.linalg.inv(left), np.linalg.inv(right)), strict=True):
        agree(jacobian, wanted, 1e-7)


@ORDERS
def test_jacobians_of_poses_predict_a_perturbed_exponential(order: tx.Order) -> None:
    to_vector = lambda X: join(X[:3, 3], axial(X), order)  # noqa: E731
    check_jacobians(a, LARGE[:6], lambda xi: hat(xi, order), to_vector, order=order)


def test_jacobians_of_rotations_predict_a_perturbed_exponential() -> None:
    check_jacobians(w, W[:6], skew, axial)


# ---- elements, algebra, parts ------------------------------------------------------------------------------------


@ORDERS
def test_hat_and_vee(order: tx.Order) -> None:
    matrices = each(lambda xi: hat(xi, order), A)
    agree(batched(lie.Hat(a, order=order), a=A), matrices)
    agree(batched(lie.Vee(t, order=order), t=matrices), A)


def test_hat_and_vee_of_rotations() -> None:
    agree(batched(lie.Hat(w) @ v, w=W, v=V), np.cross(W, V))
    agree(batched(lie.Vee(r), r=each(skew, W)), W)
    general = RNG.normal(size=(CASES, 3, 3))
    half = (general - general.transpose(0, 2, 1)) / 2.0
    agree(batched(lie.Vee(r), r=general), np.stack([half[:, 2, 1], half[:, 0, 2], half[:, 1, 0]], axis=1))


def test_elements_act_compose_and_invert_as_matrices_do() -> None:
    homogeneous = np.concatenate([V, np.ones((CASES, 1))], axis=1)
    agree(batched(lie.Act(t, v), t=T, v=V), each(lambda X, p: X @ p, T, homogeneous)[:, :3])
    agree(batched(lie.Act(r, v), r=R, v=V), each(lambda X, p: X @ p, R, V))
    agree(batched(lie.Compose(t, s), t=T, s=S), T @ S)
    agree(batched(lie.Compose(r, lie.Inverse(r)), r=R), np.broadcast_to(np.eye(3), R.shape))
    agree(batched(lie.Inverse(t), t=T), np.linalg.inv(T))
    agree(batched(lie.Pose(r, t[:3, 3]), r=R, t=T), T)


def test_many_points_at_once() -> None:
    points = tx.State("points", (5, 3))
    agree(batched(lie.Act(t, points), t=T, points=POINTS), each(moved, T, POINTS))
    agree(batched(lie.Act(r, points), r=R, points=POINTS), each(lambda X, p: p @ X.T, R, POINTS))


@ORDERS
def test_parts(order: tx.Order) -> None:
    linear, angular = split(A, order)
    agree(batched(lie.linear(a, order=order), a=A), linear)
    agree(batched(lie.angular(a, order=order), a=A), angular)
    for build in (
        lambda v, w: lie.twist(linear=v, angular=w, order=order),
        lambda v, w: lie.wrench(force=v, torque=w, order=order),
    ):
        agree(batched(build(v, w), v=V, w=W), join(V, W, order))


@ORDERS
def test_reorder_of_vectors_and_operators(order: tx.Order) -> None:
    """An operator in the other order does to reordered vectors what it did to the vectors."""
    other = tx.ANGULAR_FIRST if order is tx.LINEAR_FIRST else tx.LINEAR_FIRST
    linear, angular = split(A, other)
    agree(batched(lie.Reorder(a, order=order), a=A), join(linear, angular, order))
    M = RNG.normal(size=(CASES, 6, 6))
    in_other = batched(lie.Reorder(m, order=order) @ lie.Reorder(a, order=order), m=M, a=A)
    linear, angular = split(each(lambda X, x: X @ x, M, A), other)
    agree(in_other, join(linear, angular, order))
    adjoint = lie.Reorder(lie.SE3Adjoint(t, order=other), order=order)
    agree(batched(adjoint, t=T), batched(lie.SE3Adjoint(t, order=order), t=T))


# ---- derivatives -------------------------------------------------------------------------------------------------


def test_derivatives_through_a_chain_of_nodes() -> None:
    """Reverse and forward mode agree with a central difference."""
    order = tx.ANGULAR_FIRST
    moved_twist = lie.SE3Adjoint(lie.SE3Exp(a, order=order), order=order) @ b
    log = lie.SE3Log(lie.Compose(lie.Inverse(lie.SE3Exp(a, order=order)), lie.SE3Exp(b, order=order)), order=order)
    function = tx.lower(tx.linalg.Dot(moved_twist, lie.AdjointDual(a, moved_twist + log, order=order)))

    def f(z: jax.Array) -> jax.Array:
        return function(0.0, {"a": z[:6], "b": z[6:]})

    z, along = 0.4 * RNG.normal(size=12), RNG.normal(size=12)
    h = 1e-3
    line = z[None, :] + h * np.array([-2.0, -1.0, 1.0, 2.0])[:, None] * along[None, :]
    gradient, tangent = jax.jit(lambda z: (jax.grad(f)(z), jax.jvp(f, (z,), (jnp.asarray(along),))[1]))(z)
    values = jax.jit(jax.vmap(f))(line)
    difference = (values[0] - 8.0 * values[1] + 8.0 * values[2] - values[3]) / (12.0 * h)
    assert float(gradient @ along) == pytest.approx(float(tangent), rel=1e-12)
    assert float(tangent) == pytest.approx(float(difference), rel=1e-7)


# ---- cost --------------------------------------------------------------------------------------------------------


def shapes_computed(function: Any, *arguments: Any) -> set[tuple[int, ...]]:
    """The shapes of all intermediate values, those inside of calls too."""
    return {out.aval.shape for e in all_equations(jax.make_jaxpr(function)(*arguments).jaxpr) for out in e.outvars}


@ORDERS
def test_an_adjoint_times_a_vector_never_builds_the_matrix(order: tx.Order) -> None:
    g, V = tx.State("g", group=tx.SE3, order=order), tx.State("V", (6,))
    chain = lie.SE3Adjoint(g, order=order) @ (lie.SE3Adjoint(g @ g, order=order) @ (2.0 * V))
    system = tx.System(
        rates={g: chain, V: lie.SE3AdjointDual(g, order=order) @ lie.AdjointDual(g[0, 0] * V, V, order=order)}
    )
    dynamics = tx.compile(system)
    x = {"g": jnp.eye(4), "V": jnp.ones(6)}
    assert (6, 6) not in shapes_computed(lambda x: dynamics.functions.vector_field(jnp.zeros(()), x, {}, {}), x)
    assert (6, 6) in shapes_computed(tx.lower(chain), 0.0, x)


_TURN = np.asarray(tx.SO3.exp(np.array([0.4, -1.1, 0.6])))


@pytest.mark.parametrize("path", ["lower", tx.XLA(least=0), tx.Native(least=0)], ids=str)
def test_logarithms_of_reflections_are_nan(path: Any) -> None:
    """Values and derivatives, whatever is known of the matrix: a number would look like a rotation vector."""
    R, T = tx.State("R", group=tx.SO3), tx.State("T", shape=(4, 4))
    logs = {"R": tx.lie.SO3Log(R), "T": tx.lie.SE3Log(T)}
    if path == "lower":
        function = tx.lower(logs)
    else:
        function = tx.compile(tx.System({R: np.zeros(3), T: 0.0 * T}, outputs=logs), backend=path).outputs
    value_and_tangent = jax.jit(lambda x, moved: jax.jvp(lambda x: function(0.0, x), (x,), (moved,)))
    gradient = jax.jit(jax.grad(lambda R, x: function(0.0, {**x, "R": R})["R"].sum()))
    for rotation in (_TURN, np.diag([1.0, 1.0, -1.0]), -np.eye(3), -_TURN, np.zeros((3, 3))):
        good = rotation is _TURN
        x = {"R": rotation, "T": np.block([[rotation, np.ones((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])}
        moved = {"R": _TURN @ skew(np.ones(3)), "T": np.zeros((4, 4))}
        values, tangents = value_and_tangent(x, moved)
        assert np.isfinite(values["R"]).all() == np.isfinite(values["T"]).all() == good
        assert np.isfinite(tangents["R"]).all() == good
        if not good:
            assert np.isnan(values["R"]).all()
            assert np.isnan(values["T"]).all()
            assert np.isnan(tangents["R"]).all()
            assert np.isnan(gradient(rotation, x)).any()
