"""Derivatives of a whole solution, maps over starts, and solutions inside jit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import forced, free_body, start

import twistax as tx

HEUN = tx.RKMK(tx.tableaus.HEUN)


@pytest.fixture(scope="module")
def body() -> tx.Dynamics:
    """A free body that is pushed, in which every kind of input matters."""
    system = free_body()
    g, V = system.states
    M = system.parameters[0]
    F = tx.Control("F", shape=(6,))
    return tx.compile(tx.System(rates={g: V, V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V))}))


@pytest.mark.slow
def test_forward_reverse_and_finite_differences_agree(body: tx.Dynamics) -> None:
    """All inputs at once: start (in tangent coordinates), controls, parameters, start and end time, saved times."""
    x0 = body.functions.prepare(0.0, start(), reads=()).x
    M = jnp.asarray(body.system.parameters[0].value)
    ts = np.array([0.0, 0.33, 1.0])

    def cost(z: dict[str, jax.Array]) -> jax.Array:
        u = {"F": tx.FirstOrderHold(ts, z["F"])}
        t0, t1 = z["times"]
        sol = tx.integrate(
            body,
            body.retract(x0, z["d"]),
            t0=t0,
            t1=t1,
            steps=20,
            method=HEUN,
            u=u,
            params={"M": M * z["size"]},
            save_at=t0 + (t1 - t0) * z["share"],
        )
        weights = jnp.cos(jnp.arange(16.0)).reshape(4, 4)
        return jnp.sum(sol.xs["g"][0] * weights) + jnp.sum(jnp.sin(sol.xs["V"][1])) + jnp.sum(sol.xs["g"][1, :3, 3])

    rng = np.random.default_rng(1)
    z = {
        "d": jnp.asarray(0.1 * rng.normal(size=12)),
        "F": jnp.asarray(rng.normal(size=(3, 6))),
        "size": jnp.asarray(1.3),
        "times": jnp.array([0.1, 0.9]),
        "share": jnp.array([0.43, 0.91]),
    }

    def along(direction: dict[str, jax.Array], distance: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The cost some way along a direction, and its forward derivative there."""

        def line(s: jax.Array) -> jax.Array:
            return cost(jax.tree.map(lambda a, d: a + s * d, z, direction))

        return jax.jvp(line, (distance,), (jnp.ones(()),))

    directions = {name: jnp.asarray(rng.normal(size=(4, *value.shape))) for name, value in z.items()}
    gradient = jax.jit(jax.grad(cost))(z)
    reverse = sum(jnp.sum((gradient[n][None] * d).reshape(4, -1), axis=1) for n, d in directions.items())
    forward = jax.jit(jax.vmap(along, in_axes=(0, None)))
    np.testing.assert_allclose(reverse, forward(directions, jnp.zeros(()))[1], rtol=1e-11)
    e = 1e-5
    difference = (forward(directions, jnp.asarray(e))[0] - forward(directions, jnp.asarray(-e))[0]) / (2 * e)
    np.testing.assert_allclose(reverse, difference, rtol=1e-8)
    assert min(float(jnp.abs(part).min()) for part in gradient.values()) > 1e-6


def test_a_traced_solution_is_the_known_one(body: tx.Dynamics) -> None:
    ts = np.array([0.0, 0.4, 0.73, 1.0])

    def solve(x0: dict[str, np.ndarray]) -> tx.Solution:
        return tx.integrate(body, x0, t1=1.0, dt=0.1, u={"F": np.ones(6)}, save_at=ts, method=HEUN)

    known, traced = solve(start()), jax.jit(solve)(start())
    assert traced.result is tx.Result.SUCCESS
    assert traced.stats.steps == known.stats.steps
    assert traced.stats.rhs_evaluations == known.stats.rhs_evaluations
    for name in known.xs:
        np.testing.assert_allclose(traced.xs[name], known.xs[name], atol=1e-14)
        np.testing.assert_array_equal(traced.xs[name][0], start()[name])
    np.testing.assert_array_equal(traced.ts, known.ts)


def test_a_map_over_starts_is_a_solution_of_each() -> None:
    dynamics = forced()
    starts = [start(seed) for seed in (3, 4, 5)]
    batch = {name: np.stack([x0[name] for x0 in starts]) for name in starts[0]}
    mapped = jax.vmap(lambda x0: tx.integrate(dynamics, x0, t1=0.5, dt=0.05, method=HEUN))(batch)
    assert mapped.xs["g"].shape == (3, 1, 4, 4)
    assert (mapped.result == tx.Result.SUCCESS).all()
    for i, x0 in enumerate(starts):
        np.testing.assert_allclose(
            mapped.xs["g"][i], tx.integrate(dynamics, x0, t1=0.5, dt=0.05, method=HEUN).xs["g"], atol=1e-14
        )


def test_a_traced_failure_stays_in_the_solution() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: x * x}))
    solve = jax.jit(lambda x0: tx.integrate(dynamics, {"x": x0}, t1=2.0, dt=0.01, save_at=np.array([0.5, 2.0])))
    good, bad = solve(0.1), solve(1.0)
    assert good.result is tx.Result.SUCCESS
    assert bad.result is tx.Result.NON_FINITE
    assert np.isfinite(bad.xs["x"][0])
    assert not np.isfinite(bad.xs["x"][1])


@pytest.mark.parametrize("throw", [True, False])
@pytest.mark.parametrize("rows", [{}, {"save_at": np.linspace(0.0, 2.0, 8)}], ids=["end", "rows"])
def test_a_failure_under_eager_derivatives_is_that_under_jit(throw: bool, rows: dict) -> None:
    """There counts are numbers while states are traced."""
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: x * x}))
    end = lambda x0: tx.integrate(dynamics, {"x": x0}, t1=2.0, rtol=1e-7, throw=throw, **rows).xs["x"]  # noqa: E731
    found, expected = (jax.jvp(f, (jnp.ones(()),), (jnp.ones(()),)) for f in (end, jax.jit(end)))
    assert not np.isfinite(found[0][-1])
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)


def test_a_known_pose_may_stand_beside_a_traced_twist() -> None:
    x0 = start()
    g = jnp.asarray(x0["g"])
    solve = jax.jit(lambda V: tx.integrate(forced(), {"g": g, "V": V}, t1=0.2, dt=0.1).xs["V"][0])
    known = tx.integrate(forced(), x0, t1=0.2, dt=0.1).xs["V"][0]
    np.testing.assert_allclose(solve(x0["V"]), known, rtol=1e-12)
