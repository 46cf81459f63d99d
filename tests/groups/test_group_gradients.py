"""First and second derivatives of the maps, at zero, at the switch points, at a half turn and at a full one.

The oracle is Frechet's: the exponential of a block triangular matrix holds the derivatives of the exponential.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from group_oracles import ad, hat, right_jacobian
from scipy.linalg import expm

from twistax.groups import SE3, SO3, se3, so3

AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
V = np.array([0.3, -1.1, 0.7])
ANGLES = [0.0, 1e-300, 1e-9, 1e-5, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 2.0, 3.0, np.pi - 1e-9, np.pi, np.pi + 1e-9]
FAR = [2.0 * np.pi - 1e-9, 2.0 * np.pi, 7.0, 15.0]
XIS = np.array([np.concatenate([V, angle * AXIS]) for angle in ANGLES + FAR])
BASIS = [hat(SE3, unit) for unit in np.eye(6)]


def close(actual, expected, tolerance):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance)


def first_derivative(X, E):
    O = np.zeros_like(X)
    return expm(np.block([[X, E], [O, X]]))[:4, 4:]


def second_derivative(X, E, F):
    O = np.zeros_like(X)
    return expm(np.block([[X, E, F, O], [O, X, O, F], [O, O, X, E], [O, O, O, X]]))[:4, 12:]


def test_first_derivatives_of_exp():
    forward, reverse = (np.asarray(jax.jit(jax.vmap(mode(se3.exp)))(XIS)) for mode in (jax.jacfwd, jax.jacrev))
    close(forward, reverse, 1e-14)
    for xi, got in zip(XIS, forward, strict=True):
        for i, E in enumerate(BASIS):
            close(got[..., i], first_derivative(hat(SE3, xi), E), 1e-14 * (2.0 + np.linalg.norm(xi)))


def test_second_derivatives_of_exp():
    hessians = np.asarray(jax.jit(jax.vmap(jax.hessian(se3.exp)))(XIS))
    close(hessians, np.swapaxes(hessians, -1, -2), 1e-12)
    for xi, got in zip(XIS, hessians, strict=True):
        for i, E in enumerate(BASIS):
            for j, F in enumerate(BASIS[: i + 1]):
                close(got[..., i, j], second_derivative(hat(SE3, xi), E, F), 1e-12)


def test_third_derivatives_of_exp_at_zero():
    """d^3 Exp(0)[a, a, a] = A^3."""
    direction = np.array([0.4, -0.2, 0.9, 0.5, -0.7, 0.3])

    def along(s):
        return se3.exp(s * direction)

    third = jax.jit(jax.jacfwd(jax.jacfwd(jax.jacfwd(along))))(0.0)
    close(third, np.linalg.matrix_power(hat(SE3, direction), 3), 1e-14)


BELOW = [0.0, 1e-300, 1e-9, 1e-5, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 2.0, 3.0, np.pi - 1e-5]


def log_beside(d, g):
    return se3.log(se3.compose(g, se3.exp(d)))


def test_first_derivatives_of_log():
    """d -> Log(g Exp(d)) has the derivative J_r^-1(Log g) at zero."""
    xis = np.array([np.concatenate([V, angle * AXIS]) for angle in BELOW])
    poses = np.array([expm(hat(SE3, xi)) for xi in xis])
    forward, reverse = (
        np.asarray(jax.jit(jax.vmap(mode(log_beside), in_axes=(None, 0)))(np.zeros(6), poses))
        for mode in (jax.jacfwd, jax.jacrev)
    )
    close(forward, reverse, 1e-13)
    for xi, got in zip(xis, forward, strict=True):
        close(got, np.linalg.inv(right_jacobian(SE3, xi)), 1e-10 if xi[3:] @ xi[3:] > 9.5 else 5e-14)


def mixed_derivative(xi):
    """Of Log(Exp(a) Exp(d)) at a = xi, d = 0; the first axis is the value's, then that of d, then that of a."""
    inner = jax.jacrev(lambda a, d: log_beside(d, se3.exp(a)), argnums=1)
    return jax.jacfwd(inner)(xi, jnp.zeros(6))


def test_second_derivatives_of_log():
    """The mixed derivative is that of J_r^-1, by a central difference; at zero that of a + d + [a, d] / 2."""
    step = 1e-5
    xis = np.array([np.concatenate([V, angle * AXIS]) for angle in (0.0, 1e-9, 1e-5, 1.0, 2.5)] + [np.zeros(6)])
    mixed = np.asarray(jax.jit(jax.vmap(mixed_derivative))(xis))
    for xi, got in zip(xis, mixed, strict=True):
        for i, unit in enumerate(np.eye(6)):
            ahead, behind = (np.linalg.inv(right_jacobian(SE3, xi + s * step * unit)) for s in (1.0, -1.0))
            close(got[..., i], (ahead - behind) / (2.0 * step), 1e-8)
    for i, unit in enumerate(np.eye(6)):
        close(mixed[-1, :, :, i], 0.5 * ad(SE3, unit), 1e-15)


def test_second_derivative_of_log_after_exp_at_zero():
    """Log(Exp(d)) = d has none, also by reverse over reverse mode."""
    hessian = jax.jit(jax.jacrev(jax.jacrev(lambda d: so3.log(so3.exp(d)))))
    close(hessian(jnp.zeros(3)), np.zeros((3, 3, 3)), 1e-15)


def test_derivatives_of_log_at_a_half_turn():
    """Finite at exactly a half turn, and the limit of those just below it on the side the logarithm picks."""
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 2, 2], [0, 3, -4]], float)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    half, below = np.tile(np.eye(4), (2, len(axes), 1, 1))
    half[:, :3, :3], half[:, :3, 3] = 2.0 * axes[:, :, None] * axes[:, None, :] - np.eye(3), V
    for n, at, near in zip(axes, half, below, strict=True):
        near[:] = expm(hat(SE3, np.concatenate([se3.log(at)[:3], (np.pi - 1e-6) * n])))

    def first_and_second(g):
        return jax.jacrev(log_beside)(jnp.zeros(6), g), jax.hessian(log_beside)(jnp.zeros(6), g)

    first, second = map(np.asarray, jax.jit(jax.vmap(first_and_second))(np.concatenate([half, below])))
    assert np.all(np.isfinite(second))
    close(first[:5], first[5:], 1e-5)
    close(second[:5], second[5:], 1e-4)


def test_ambient_derivatives_of_log_belong_to_the_nearest_rotation():
    """A change of the matrix that leaves the group is seen only through the rotation nearest to it."""
    rng = np.random.default_rng(4)
    step = 1e-6
    for angle in (0.0, 0.4, 2.0, 3.0):
        R = expm(hat(SO3, angle * np.array([0.8, -0.36, 0.48])))
        D = rng.normal(size=(3, 3))
        _, got = jax.jvp(so3.log, (jnp.asarray(R),), (jnp.asarray(D),))
        close(got, (so3.log(R + step * D) - so3.log(R - step * D)) / (2.0 * step), 1e-7)


@pytest.mark.parametrize("name", ["left_jacobian", "right_jacobian", "left_jacobian_inv", "right_jacobian_inv"])
def test_derivatives_of_the_jacobians(name):
    """Against central differences of the series, and forward against reverse; at zero and close to it too."""
    step = 1e-5
    xis = XIS[[0, 2, 3, 5, 7, 10]]
    forward, reverse = (
        np.asarray(jax.jit(jax.vmap(mode(getattr(se3, name))))(xis)) for mode in (jax.jacfwd, jax.jacrev)
    )
    close(forward, reverse, 1e-13)

    def series(xi):
        value = right_jacobian(SE3, -xi if name.startswith("left") else xi)
        return np.linalg.inv(value) if name.endswith("inv") else value

    for xi, got in zip(xis, forward, strict=True):
        for i, unit in enumerate(np.eye(6)):
            close(got[..., i], (series(xi + step * unit) - series(xi - step * unit)) / (2.0 * step), 1e-8)


def test_second_derivatives_of_the_jacobians_at_zero():
    """J_r = I - ad/2 + ad^2/6, J_r^-1 = I + ad/2 + ad^2/12 up to the third order."""
    for name, weight in (("right_jacobian", 1.0 / 6.0), ("right_jacobian_inv", 1.0 / 12.0)):
        hessian = jax.jit(jax.hessian(getattr(se3, name)))(jnp.zeros(6))
        ads = [ad(SE3, unit) for unit in np.eye(6)]
        for i, A in enumerate(ads):
            for j, B in enumerate(ads):
                close(hessian[..., i, j], weight * (A @ B + B @ A), 1e-15)


def test_single_precision_gradients_stay_single():
    def all_maps(xi):
        T = se3.exp(xi)
        return se3.log(T), se3.left_jacobian(xi), se3.left_jacobian_inv(xi), T

    derivative = jax.jit(jax.jacrev(all_maps))
    for single, double in zip(derivative(np.float32(XIS[5])), derivative(XIS[5]), strict=True):
        assert single.dtype == jnp.float32
        close(single, double, 2e-6)
