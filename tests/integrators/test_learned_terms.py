"""Rates with a network in them: gradients through the steps, and weights that an optimiser chooses."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

START = np.array([1.0, -0.5, 0.3, 0.2])


def learned(net: Any) -> tuple[tx.Dynamics, tx.ParameterTree]:
    x, weights = tx.State("x", shape=(4,)), tx.ParameterTree("net", net)
    return tx.compile(tx.System(rates={x: -x + tx.Function(lambda m, y: m(y), (4,))(weights, x)})), weights


def flat_gradient(loss: Any, net: Any) -> np.ndarray:
    arrays, rest = eqx.partition(net, eqx.is_inexact_array)
    gradient = jax.jit(jax.grad(lambda a: loss(eqx.combine(a, rest))))(arrays)
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(gradient)])


def test_the_gradient_through_twenty_steps_is_that_of_the_steps_written_out() -> None:
    net = eqx.nn.MLP(4, 4, 5, 1, activation=jnp.tanh, key=jax.random.key(0))
    dynamics, weights = learned(net)

    def by_steps(m: Any) -> jax.Array:
        def rate(y: jax.Array) -> jax.Array:
            return -y + m(y)

        def step(y: jax.Array, _: None) -> tuple[jax.Array, None]:
            k1 = rate(y)
            k2 = rate(y + 0.025 * k1)
            k3 = rate(y + 0.025 * k2)
            k4 = rate(y + 0.05 * k3)
            return y + 0.05 * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0, None

        return jnp.sum(jax.lax.scan(step, jnp.asarray(START), None, length=20)[0] ** 2)

    def by_integrate(m: Any) -> jax.Array:
        run = tx.integrate(
            dynamics, {"x": START}, t1=1.0, dt=0.05, method=tx.RKMK(tx.tableaus.RK4), params=weights.values(m)
        )
        return jnp.sum(run.last["x"] ** 2)

    np.testing.assert_allclose(flat_gradient(by_integrate, net), flat_gradient(by_steps, net), atol=1e-12)


def test_a_gradient_through_twenty_steps_is_that_of_diffrax() -> None:
    net = eqx.nn.MLP(4, 4, 64, 2, key=jax.random.key(0))
    dynamics, weights = learned(net)

    def by_integrate(m: Any) -> jax.Array:
        method = tx.RKMK(tx.tableaus.TSIT5)
        run = tx.integrate(dynamics, {"x": START}, t1=1.0, dt=0.05, method=method, params=weights.values(m))
        return jnp.sum(run.last["x"] ** 2)

    def by_diffrax(m: Any) -> jax.Array:
        term = diffrax.ODETerm(lambda t, y, args: -y + m(y))
        run = diffrax.diffeqsolve(term, diffrax.Tsit5(), 0.0, 1.0, 0.05, jnp.asarray(START))
        return jnp.sum(run.ys[-1] ** 2)

    np.testing.assert_allclose(flat_gradient(by_integrate, net), flat_gradient(by_diffrax, net), atol=1e-7)


def drag(p: Any, v: jax.Array) -> jax.Array:
    return -p["c"] * jnp.tanh(p["w"] * v)


def double_integrator(term: Any) -> tx.System:
    q, v, force = tx.State("q"), tx.State("v"), tx.Control("force", min=-3.0, max=3.0)
    return tx.System(rates={q: v, v: force + term(v)})


def moved(system: tx.System) -> Any:
    """The cheapest way from rest to rest, one metre in two seconds."""
    cost = tx.Minimize(running=system.controls[0] ** 2)
    ends = {"initial": {"q": 0.0, "v": 0.0}, "final": {"q": 1.0, "v": 0.0}}
    return tx.trajectory.Problem(tx.compile(system), cost, nodes=9, final_time=2.0, **ends).solve()


def test_a_plan_through_a_learned_term_is_that_through_the_same_nodes() -> None:
    """A learned model inside of a double integrator, as l4casadi's example of model-predictive control has it."""
    tree = {"c": np.array(0.8), "w": np.array(1.5)}
    by_function = moved(double_integrator(lambda v: tx.Function(drag, ())(tx.ParameterTree("net", tree), v)))
    by_nodes = moved(double_integrator(lambda v: -0.8 * tx.Tanh(1.5 * v)))
    assert by_function.status is tx.trajectory.Status.SOLVED
    np.testing.assert_allclose(by_function.cost, by_nodes.cost, rtol=1e-9)
    np.testing.assert_allclose(by_function.us["force"], by_nodes.us["force"], atol=1e-6)


def test_weights_are_free_in_a_problem() -> None:
    """The measured end of a coasting body decides one weight; the rest are fixed by their limits."""
    q, v = tx.State("q"), tx.State("v")
    weights = tx.ParameterTree("net", {"c": np.array(0.1), "w": np.array(1.5)})
    coast = tx.compile(tx.System(rates={q: v, v: tx.Function(drag, ())(weights, v)}))
    truth = {"c": np.array(0.7), "w": np.array(1.5)}
    seen = tx.integrate(coast, {"q": 0.0, "v": 2.0}, t1=1.0, dt=1e-3, params=weights.values(truth)).last
    c, w = weights.parameters
    problem = tx.trajectory.Problem(
        coast,
        tx.Minimize((q - seen["q"]) ** 2 + (v - seen["v"]) ** 2),
        nodes=9,
        final_time=1.0,
        initial={"q": 0.0, "v": 2.0},
        free={c: (0.0, 2.0), w: (1.5, 1.5)},
    )
    result = problem.solve()
    assert result.status is tx.trajectory.Status.SOLVED
    np.testing.assert_allclose(weights.tree(result.params)["c"], 0.7, atol=1e-4)
