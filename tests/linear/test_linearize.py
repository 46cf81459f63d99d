"""The continuous error dynamics against the mixed derivative of two flows and their logarithm."""

import jax
import jax.numpy as jnp
import numpy as np
from trajectory_systems import everything, quick_jit, sample, spinning_ball

import twistax as tx
from twistax.trajectory import Linearization, linearize

T = 0.4


def by_two_flows(dynamics: tx.Dynamics, x: dict, u: dict) -> tuple[jax.Array, jax.Array]:
    """d/dtau d/dd of Log(x(tau)^-1 y(tau)) where y starts at x (+) d under u + du; first order in tau is enough."""
    names = list(u)
    flat = jnp.concatenate([jnp.ravel(u[name]) for name in names])

    def split(values: jax.Array) -> dict:
        return {"F": values[:3], "q": values[3]}

    def rollout(tau: jax.Array, start: dict, control: jax.Array) -> dict:
        rates = dynamics(T, start, split(control))
        velocity = jnp.concatenate([rates[name].reshape(-1) for name in dynamics.group.factors])
        return dynamics.retract(start, tau * velocity)

    def apart(tau: jax.Array, z: jax.Array) -> jax.Array:
        neighbour = rollout(tau, dynamics.retract(x, z[: dynamics.dimension]), flat + z[dynamics.dimension :])
        return dynamics.difference(rollout(tau, x, flat), neighbour)

    zero = jnp.zeros(dynamics.dimension + flat.shape[0])
    mixed = quick_jit(jax.jacfwd(jax.jacfwd(apart, argnums=1), argnums=0))(jnp.asarray(0.0), zero)
    return mixed[:, : dynamics.dimension], mixed[:, dynamics.dimension :]


def test_error_dynamics_equal_the_mixed_derivative_of_two_flows() -> None:
    dynamics = tx.compile(everything(tx.ANGULAR_FIRST))
    x, u = sample(1)
    found = quick_jit(lambda x, u: linearize(dynamics, T, x, u))(x, u)
    A, B = by_two_flows(dynamics, x, u)
    np.testing.assert_allclose(found.A, A, atol=1e-12)
    np.testing.assert_allclose(found.B, B, atol=1e-12)
    rates = dynamics(T, x, u)
    np.testing.assert_allclose(
        found.rate, np.concatenate([np.ravel(rates[n]) for n in dynamics.group.factors]), atol=1e-14
    )
    # The case can see a missing or reversed ad term.
    assert np.abs(dynamics.group.ad(found.rate)).max() > 0.1


def test_it_maps_over_points_and_keeps_precision() -> None:
    dynamics = tx.compile(spinning_ball())
    rng = np.random.default_rng(0)
    xs = {"R": np.asarray(jax.vmap(tx.SO3.exp)(rng.normal(size=(3, 3)))), "w": rng.normal(size=(3, 3))}
    xs, us = jax.tree.map(lambda a: a.astype(np.float32), (xs, {"u": rng.normal(size=(3, 3))}))
    many = quick_jit(jax.vmap(lambda x, u: linearize(dynamics, T, x, u)))(xs, us)
    assert isinstance(many, Linearization)
    assert many.A.shape == (3, 6, 6)
    assert many.A.dtype == np.float32
    # d' = -w x d + dw, dw' = du: by hand.
    x, y, z = xs["w"][1]
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    np.testing.assert_allclose(many.A[1], np.block([[-W, np.eye(3)], [np.zeros((3, 6))]]), atol=1e-6)
    np.testing.assert_allclose(many.B[1], np.vstack([np.zeros((3, 3)), np.eye(3)]), atol=1e-6)


def test_a_system_without_controls_has_an_empty_b() -> None:
    x = tx.State("x", shape=(2,))
    dynamics = tx.compile(tx.System(rates={x: -2.0 * x}))
    found = linearize(dynamics, 0.0, {"x": np.ones(2)})
    np.testing.assert_array_equal(found.A, -2.0 * np.eye(2))
    assert found.B.shape == (2, 0)
