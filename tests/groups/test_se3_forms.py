"""The special forms of SO(3) and SE(3): duals, brackets, both orders, points. Conventions where sources disagree."""

import jax
import numpy as np
import pytest
from scipy.linalg import expm

from oracles import skew
from twistax.groups import ANGULAR_FIRST, LINEAR_FIRST, SE3, se3, so3
from twistax.jax_inside import all_equations

rng = np.random.default_rng(5)
XI, ETA, MU = rng.normal(size=(3, 6))
T = expm(np.block([[skew(XI[3:]), XI[:3, None]], [np.zeros((1, 4))]]))
R, p = T[:3, :3], T[:3, 3]
O = np.zeros((3, 3))


def close(actual, expected, tolerance=2e-14):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance)


def test_the_operators_linear_first():
    v, w = skew(XI[:3]), skew(XI[3:])
    close(se3.ad(XI), np.block([[w, v], [O, w]]), 0.0)
    close(se3.ad_dual(XI), np.block([[w, O], [v, w]]), 0.0)
    close(se3.Ad(T), np.block([[R, skew(p) @ R], [O, R]]))
    close(se3.Ad_dual(T), np.block([[R, O], [skew(p) @ R, R]]))


def test_the_operators_angular_first():
    v, w = skew(XI[3:]), skew(XI[:3])
    group = SE3.with_order(ANGULAR_FIRST)
    close(group.ad(XI), np.block([[w, O], [v, w]]), 0.0)
    close(group.Ad(T), np.block([[R, O], [skew(p) @ R, R]]))
    close(ANGULAR_FIRST.from_linear_first(se3.Ad_dual(T)), np.block([[R, skew(p) @ R], [O, R]]))
    assert group.with_order(LINEAR_FIRST) == SE3


def test_vector_forms_are_the_matrices_applied():
    close(se3.bracket(XI, ETA), se3.ad(XI) @ ETA)
    close(se3.coad(XI, MU), se3.ad_dual(XI) @ MU)
    close(so3.bracket(XI[:3], ETA[:3]), so3.ad(XI[:3]) @ ETA[:3])
    close(so3.coad(XI[:3], MU[:3]), so3.ad_dual(XI[:3]) @ MU[:3])
    for module, n in ((se3, 6), (so3, 3)):
        close(module.right_jacobian_inv_apply(XI[:n], ETA[:n]), module.right_jacobian_inv(XI[:n]) @ ETA[:n])


def test_ad_dual_is_minus_the_transpose():
    close(se3.coad(XI, MU) @ ETA + MU @ se3.bracket(XI, ETA), 0.0)
    close(so3.coad(XI[:3], MU[:3]) @ ETA[:3] + MU[:3] @ so3.bracket(XI[:3], ETA[:3]), 0.0)


def test_power_does_not_depend_on_the_frame():
    """Twist and wrench each moved by their own rule: velocity of a point and moment of a force, no Ad in sight."""
    v, w, f, tau = XI[:3], XI[3:], MU[:3], MU[3:]
    w_a, f_a = R @ w, R @ f
    twist_a = np.concatenate([R @ v - np.cross(w_a, p), w_a])
    wrench_a = np.concatenate([f_a, R @ tau + np.cross(p, f_a)])
    close(se3.Ad(T) @ XI, twist_a)
    close(se3.Ad_dual(T) @ MU, wrench_a)
    close(wrench_a @ twist_a, MU @ XI)


def test_the_inverse_right_jacobian_is_the_rate_of_the_chart():
    """g' = g Omega^ with g = Exp(eta) gives eta' = J_r^-1(eta) Omega; the other sign is off by [eta, Omega]."""
    step = 1e-5
    moved = [expm(np.asarray(se3.hat(XI))) @ expm(sign * step * np.asarray(se3.hat(ETA))) for sign in (1.0, -1.0)]
    rate = (se3.log(moved[0]) - se3.log(moved[1])) / (2.0 * step)
    close(se3.right_jacobian_inv_apply(XI, ETA), rate, 1e-9)


def test_hat_and_vee():
    close(se3.hat(XI), np.block([[skew(XI[3:]), XI[:3, None]], [np.zeros((1, 4))]]), 0.0)
    close(se3.vee(se3.hat(XI)), XI, 0.0)
    close(so3.hat(XI[:3]) @ ETA[:3], np.cross(XI[:3], ETA[:3]))
    close(so3.vee(so3.hat(XI[:3])), XI[:3], 0.0)


def test_act_on_points():
    points = rng.normal(size=(4, 3))
    homogeneous = np.concatenate([points, np.ones((4, 1))], axis=1)
    close(se3.act(T, points), (homogeneous @ T.T)[:, :3])
    close(se3.act(T, points[0]), (T @ homogeneous[0])[:3])
    close(so3.act(R, points), points @ R.T)
    close(so3.act(R, points[0]), R @ points[0])


def test_inverse_and_between():
    close(se3.inverse(T), np.linalg.inv(T))
    S = np.asarray(se3.exp(ETA))
    close(se3.between(T, S), np.linalg.inv(T) @ S)
    close(so3.inverse(R), R.T, 0.0)


def test_between_keeps_the_digits_of_distant_neighbours():
    near, far = np.array(T), np.array(T)
    near[:3, 3], far[:3, 3] = 1e7, 1e7 + np.array([1e-3, 2e-3, -1e-3])
    gap = far[:3, 3] - near[:3, 3]
    close(se3.between(near, far)[:3, 3], R.T @ gap, 1e-17)
    close(SE3.difference(near, far)[:3], R.T @ gap, 1e-17)


@pytest.mark.parametrize(
    "axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [3, -4, 0], [-3, 4, 0], [0, -2, 1], [1, 2, 2], [-2, 1, 3]]
)
def test_the_axis_at_a_half_turn(axis):
    """The rotation 2 n n' - I is exactly symmetric; its logarithm has a positive first non-zero component."""
    n = np.array(axis) / np.linalg.norm(axis)
    w = so3.log(2.0 * np.outer(n, n) - np.eye(3))
    first = n[np.nonzero(n)[0][0]]
    close(w, np.pi * n * np.sign(first), 2e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_log_close_to_a_half_turn_keeps_its_side(sign):
    for gap in (1e-3, 1e-7, 1e-12):
        w = sign * (np.pi - gap) * np.array([2.0, -1.0, 2.0]) / 3.0
        close(so3.log(expm(skew(w))), w, 2e-14)


def test_a_turn_beyond_pi_comes_back_shorter():
    n = np.array([2.0, -1.0, 2.0]) / 3.0
    close(so3.log(so3.exp(4.0 * n)), (4.0 - 2.0 * np.pi) * n, 1e-14)
    close(so3.exp(2.0 * np.pi * n), np.eye(3), 1e-14)


def size(function, *arguments):
    """How many equations there are, calls of inner functions not counted."""
    found = all_equations(jax.make_jaxpr(function)(*arguments).jaxpr)
    return sum(not any(hasattr(value, "jaxpr") for value in each.params.values()) for each in found)


def test_the_maps_stay_small():
    """They run inside scans: a program that grows unnoticed costs compile time everywhere."""
    assert size(se3.exp, XI) < 120
    assert size(se3.right_jacobian_inv_apply, XI, ETA) < 175
    assert size(so3.right_jacobian_inv_apply, XI[:3], ETA[:3]) < 80
