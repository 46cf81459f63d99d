"""Gradients with respect to group elements against hand-made ones and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

G = np.asarray(tx.SE3.exp(np.array([1.0, -2.0, 0.5, 0.3, 0.8, -0.4])))


def height(g: jax.Array) -> jax.Array:
    return g[2, 3]


def test_height_grows_along_the_body_axes_by_hand() -> None:
    found = jax.jit(tx.tangent_grad(height))(G)
    np.testing.assert_allclose(found, [*G[2, :3], 0.0, 0.0, 0.0], atol=1e-15)
    angular_first = tx.SE3.with_order(tx.ANGULAR_FIRST)
    np.testing.assert_allclose(tx.tangent_grad(height, angular_first)(G), [0.0, 0.0, 0.0, *G[2, :3]], atol=1e-15)


def test_a_turn_of_a_vector_by_hand() -> None:
    """f(R) = a.(R b): df = a.(R (d x b)), so the gradient is b x (R' a)."""
    R, a, b = G[:3, :3], np.array([0.2, 1.0, -0.5]), np.array([0.7, -0.3, 0.4])
    found = tx.tangent_grad(lambda scale, g: scale * jnp.vdot(a, g @ b), tx.SO3, argnums=1)(2.0, R)
    np.testing.assert_allclose(found, 2.0 * np.cross(b, R.T @ a), atol=1e-15)


def test_products_and_differences() -> None:
    group = tx.Product({"z": tx.Euclidean((2,)), "g": tx.SE3, "R": tx.SO3})
    x = {"g": G, "R": G[:3, :3].T, "z": np.array([0.4, -0.1])}

    def function(x: dict) -> jax.Array:
        return jnp.sin(x["g"][0, 3] * x["R"][1, 2]) + x["g"][1, 2] * x["z"][0] ** 2 + jnp.trace(x["R"])

    along = jax.jit(jax.vmap(lambda d: function(group.retract(x, d))))
    steps = 1e-5 * np.eye(group.dimension)
    expected = (along(steps) - along(-steps)) / 2e-5
    np.testing.assert_allclose(jax.jit(tx.tangent_grad(function, group))(x), expected, atol=1e-9)


def test_precision_follows_the_element_and_too_few_arguments_are_said() -> None:
    assert tx.tangent_grad(height)(G.astype(np.float32)).dtype == np.float32
    with pytest.raises(tx.InputError, match="argument 2"):
        tx.tangent_grad(height, argnums=2)(G)
