"""The closed form of a step's derivatives against the derivative of the logarithm and finite differences."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import everything, quick_jit, sample, spinning_ball

import twistax as tx
from twistax.integrators import VectorField
from twistax.trajectory import Discretization, discretize

H, T = 0.3, 0.4
N, M = 19, 4


def rollout(dynamics: tx.Dynamics, method: tx.RKMK, substeps: int) -> Callable[..., dict]:
    """The end of an interval by the integrators' own step: (x, z) with z = [d, du, dh, dt]."""

    def end(x: dict, u: dict, z: jax.Array) -> dict:
        control = {"F": u["F"] + z[N : N + 3], "q": u["q"] + z[N + 3]}
        h, t = (H + z[N + M]) / substeps, T + z[N + M + 1]
        inputs = dynamics.functions.prepare(t, dynamics.retract(x, z[:N]), control)
        control, params = dict(inputs.u), dict(inputs.params)

        def step(i: jax.Array, state: dict) -> dict:
            return method.step(VectorField(dynamics, lambda _: control, params), t + i.astype(t.dtype) * h, state, h)

        return jax.lax.fori_loop(0, substeps, step, dict(inputs.x))

    return end


@functools.cache
def case(
    angular: bool, substeps: int
) -> tuple[tx.Dynamics, tx.RKMK, Callable[..., dict], Callable[..., Discretization]]:
    dynamics = tx.compile(everything(tx.ANGULAR_FIRST if angular else tx.LINEAR_FIRST))
    method = tx.RKMK(tx.tableaus.RK4)
    found = quick_jit(lambda x, u: discretize(dynamics, T, x, u, H, method=method, substeps=substeps))
    return dynamics, rollout(dynamics, method, substeps), found


def stacked(step: Discretization) -> np.ndarray:
    return np.column_stack([step.A, step.B, step.h_derivative, step.t_derivative])


def test_closed_form_equals_the_derivative_of_the_logarithm() -> None:
    dynamics, end, found = case(tx.LINEAR_FIRST, 1)
    x, u = sample(2)
    zero = jnp.zeros(N + M + 2)
    planned = quick_jit(end)(x, u, zero)
    expected = quick_jit(jax.jacfwd(lambda z: dynamics.difference(planned, end(x, u, z))))(zero)
    step = found(x, u)
    for name, value in planned.items():
        np.testing.assert_allclose(step.x1[name], value, atol=1e-13)
    np.testing.assert_allclose(stacked(step), expected, atol=1e-12)


@pytest.mark.parametrize(("order", "substeps"), [(tx.LINEAR_FIRST, 3), (tx.ANGULAR_FIRST, 1)])
def test_closed_form_equals_richardson_differences(order: tx.Order, substeps: int) -> None:
    dynamics, end, found = case(order, substeps)
    x, u = sample(3)
    planned = quick_jit(end)(x, u, jnp.zeros(N + M + 2))
    apart = quick_jit(jax.vmap(lambda z: dynamics.difference(planned, end(x, u, z))))

    def central(size: float) -> np.ndarray:
        steps = size * np.eye(N + M + 2)
        return np.asarray(apart(steps) - apart(-steps)).T / (2.0 * size)

    richardson = (4.0 * central(5e-4) - central(1e-3)) / 3.0
    step = found(x, u)
    np.testing.assert_allclose(stacked(step), richardson, atol=1e-8)
    np.testing.assert_allclose(dynamics.difference(planned, step.x1), 0.0, atol=1e-13)


def test_the_transport_in_this_case_is_far_from_the_identity() -> None:
    dynamics, _, found = case(tx.LINEAR_FIRST, 1)
    x, u = sample(2)
    step = found(x, u)
    eta = dynamics.difference(x, step.x1)
    # Without Ad(Exp(-eta)), or with its inverse, A differs by far more than the bars above.
    transport = np.asarray(dynamics.group.Ad(dynamics.group.exp(-eta)))
    assert np.abs(transport - np.eye(N)).max() > 0.1


def test_euclidean_states_reduce_to_the_matrix_exponential() -> None:
    x, u = tx.State("x", shape=(2,)), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: np.array([[0.0, 1.0], [-4.0, 0.0]]) @ x + np.array([0.0, 1.0]) * u}))
    step = discretize(dynamics, 0.0, {"x": np.zeros(2)}, {"u": 0.0}, 0.1, substeps=20)
    c, s = np.cos(0.2), np.sin(0.2)
    np.testing.assert_allclose(step.A, [[c, s / 2], [-2 * s, c]], atol=1e-9)
    np.testing.assert_allclose(step.B[:, 0], [(1 - c) / 4, s / 2], atol=1e-9)


def test_it_maps_over_intervals_and_keeps_precision() -> None:
    dynamics = tx.compile(spinning_ball())
    xs = {"R": np.tile(np.eye(3), (3, 1, 1)), "w": np.array([[0.0, 0.0, 1.0]] * 3)}
    xs, us, lengths = jax.tree.map(
        lambda a: a.astype(np.float32), (xs, {"u": np.zeros((3, 3))}, np.array([0.1, 0.2, 0.3]))
    )
    many = quick_jit(jax.vmap(lambda x, u, h: discretize(dynamics, T, x, u, h)))(xs, us, lengths)
    assert many.A.dtype == np.float32
    # A turn about z at 1 rad/s: the attitude error turns back by the angle that was turned.
    c, s = np.cos(0.3), np.sin(0.3)
    np.testing.assert_allclose(many.A[2, :3, :3], [[c, s, 0], [-s, c, 0], [0, 0, 1]], atol=1e-6)


def test_a_commutator_free_step_has_derivatives_too() -> None:
    """Its ends by the integrator itself, from starts that are moved along each tangent."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    dynamics = tx.compile(tx.System(rates={R: w, w: tx.linalg.Cross(np.array([1.0, 2.0, 3.0]) * w, w)}))
    method, x = tx.CommutatorFree(), {"R": np.eye(3), "w": np.array([0.3, -1.0, 0.8])}
    found = discretize(dynamics, 0.0, x, {}, 0.4, method=method, substeps=2)

    def end(d: np.ndarray) -> dict:
        sol = tx.integrate(dynamics, dynamics.retract(x, d), t1=0.4, steps=2, method=method)
        return {name: value[-1] for name, value in sol.xs.items()}

    assert found.hessian is None
    for k, d in enumerate(1e-5 * np.eye(6)):
        slope = (dynamics.difference(found.x1, end(d)) - dynamics.difference(found.x1, end(-d))) / 2e-5
        np.testing.assert_allclose(found.A[:, k], slope, atol=1e-8)
