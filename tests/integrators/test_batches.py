"""Many solutions, many numbers, many saved times: what does not fit into one small function runs the ordinary way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

TSIT5 = tx.RKMK(tx.tableaus.TSIT5)


def swing() -> tx.Dynamics:
    """A rotation that a damped rate turns."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    k = tx.Parameter("k", value=0.3)
    return tx.compile(tx.System(rates={R: w, w: tx.linalg.Cross(np.array([1.0, 2.0, 3.0]) * w, w) - k * w}))


WAYS = {"fixed": {"steps": 20}, "chosen": {"rtol": 1e-8, "atol": 1e-8}}


@pytest.mark.parametrize("way", WAYS)
def test_a_hundred_solutions_at_once_are_each_solution(way: str) -> None:
    dynamics = swing()
    ws = jnp.asarray(np.random.default_rng(0).normal(size=(100, 3)))
    ks = jnp.linspace(0.0, 1.0, 100)

    def solve(w: jax.Array, k: jax.Array) -> tx.Solution:
        x0 = {"R": np.eye(3), "w": w}
        return tx.integrate(dynamics, x0, t1=2.0, params={"k": k}, method=TSIT5, save_at=[0.9, 2.0], **WAYS[way])

    sols = jax.jit(jax.vmap(solve))(ws, ks)
    assert (np.asarray(sols.code) == tx.Result.SUCCESS).all()
    for i in (0, 37, 99):
        alone = solve(ws[i], ks[i])
        np.testing.assert_allclose(sols.xs["R"][i], alone.xs["R"], atol=1e-12)
        assert int(sols.stats.accepted[i]) == alone.stats.accepted


@pytest.mark.parametrize("way", WAYS)
def test_a_state_of_thousands_of_numbers_is_integrated(way: str) -> None:
    x = tx.State("x", shape=(5000,))
    start = np.linspace(0.5, 1.5, 5000)
    sol = tx.integrate(tx.compile(tx.System(rates={x: -x})), {"x": start}, t1=1.0, method=TSIT5, **WAYS[way])
    np.testing.assert_allclose(sol.xs["x"][0], np.exp(-1.0) * start, rtol=1e-6)


@pytest.mark.parametrize("way", WAYS)
def test_thousands_of_saved_times_are_saved(way: str) -> None:
    times = np.linspace(0.0, 2.0, 3001)
    x0 = {"R": np.eye(3), "w": np.array([1.0, 0.2, -0.4])}
    sol = tx.integrate(swing(), x0, t1=2.0, method=TSIT5, save_at=times, **WAYS[way])
    few = tx.integrate(swing(), x0, t1=2.0, method=TSIT5, save_at=times[::1000], **WAYS[way])
    np.testing.assert_allclose(sol.xs["R"][::1000], few.xs["R"], atol=1e-13)


def test_a_batch_may_close_over_whole_numbers() -> None:
    x, F = tx.State("x"), tx.Control("F")
    push = tx.compile(tx.System(rates={x: F}))

    def solve(n: jax.Array) -> jax.Array:
        sol = tx.integrate(push, {"x": 0.0}, t1=1.0, steps=5, u=lambda t: {"F": n.astype(t.dtype) * t})
        return sol.xs["x"][0]

    np.testing.assert_allclose(jax.vmap(solve)(jnp.arange(4)), 0.5 * np.arange(4), rtol=1e-12)
