"""Derivatives of whole solutions, both ways and with respect to everything; batches of solutions."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import start

import twistax as tx
from twistax.groups import so3
from twistax.tableaus import TSIT5

Inputs = dict[str, jax.Array]
METHOD = tx.RKMK(TSIT5)
#: Programs that run once need not be fast: half the time of compiling.
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
FEW = tx.StepControl(max_steps=200)


@functools.cache
def glider() -> tx.Dynamics:
    """A rotation and a speed that a control and a parameter change; everything matters to everything."""
    R, v = tx.State("R", group=tx.SO3), tx.State("v")
    F, G, k, t = tx.Control("F"), tx.Control("G", shape=(2,)), tx.Parameter("k", value=0.7), tx.Time()
    return tx.compile(
        tx.System(rates={R: tx.Concat(v, k * G[0], 0.2), v: F - k * v + R[2, 1] + v * v * G[1] + tx.Cos(2.0 * t)})
    )


X0 = {"R": start()["g"][:3, :3], "v": np.array(0.8)}


def test_of_a_batch_with_fixed_steps() -> None:
    """What all lanes share, as the length of a step, must not confuse JAX."""
    x, k = tx.State("x"), tx.Parameter("k", value=1.0)
    dynamics = tx.compile(tx.System(rates={x: -k * x}), backend=tx.JAX())

    def total(k: jax.Array) -> jax.Array:
        def end(x0: jax.Array) -> jax.Array:
            return tx.integrate(dynamics, {"x": x0}, t1=0.5, steps=20, params={"k": k}).xs["x"][0]

        return jnp.sum(jax.vmap(end)(jnp.arange(3.0)))

    slopes = jax.jit(lambda k: (jax.grad(total)(k), jax.jacfwd(total)(k)), compiler_options=QUICK)(2.0)
    np.testing.assert_allclose(slopes, -1.5 * np.exp(-1.0), rtol=1e-6)


def inputs() -> Inputs:
    rng = np.random.default_rng(1)
    return {
        "d": jnp.asarray(0.1 * rng.normal(size=4)),
        "F": jnp.asarray(rng.normal(size=3)),
        "switch": jnp.array([0.0, 0.47, 0.81]),
        "G": jnp.asarray(rng.normal(size=(3, 2))),
        "bend": jnp.array([0.05, 0.4, 1.35]),
        "k": jnp.asarray(0.9),
        "times": jnp.array([0.1, 1.3]),
        "share": jnp.array([0.43, 0.91]),
    }


def cost(z: Inputs, **how: Any) -> jax.Array:
    """A number that every input changes: of two saved states between steps, and of the end."""
    t0, t1 = z["times"]
    saved = t0 + (t1 - t0) * jnp.append(z["share"], 1.0)
    x0 = glider().retract({name: jnp.asarray(value) for name, value in X0.items()}, z["d"])
    u = {"F": tx.ZeroOrderHold(z["switch"], z["F"]), "G": tx.FirstOrderHold(z["bend"], z["G"])}
    sol = tx.integrate(glider(), x0, t0=t0, t1=t1, u=u, params={"k": z["k"]}, save_at=saved, method=METHOD, **how)
    weights = jnp.cos(jnp.arange(27.0)).reshape(3, 3, 3)
    return jnp.sum(sol.xs["R"] * weights) + jnp.sum(jnp.sin(sol.xs["v"]) * weights[0, 0])


def directions(z: Inputs) -> list[Inputs]:
    """One for each input alone, and one for all."""
    rng = np.random.default_rng(2)
    whole = {name: jnp.asarray(rng.normal(size=value.shape)) for name, value in z.items()}
    nothing = jax.tree.map(jnp.zeros_like, z)
    return [nothing | {name: whole[name]} for name in z] + [whole]


def checked(f: Callable[[Inputs], jax.Array], z: Inputs, e: float, rtol: float) -> Inputs:
    """Reverse = forward, to round-off, = central differences of fourth order, along every direction."""
    lines = jax.tree.map(lambda *rows: jnp.stack(rows), *directions(z))

    def along(d: Inputs, s: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The value some way along a direction, and its forward derivative there."""
        return jax.jvp(lambda s: f(jax.tree.map(lambda a, b: a + s * b, z, d)), (s,), (jnp.ones(()),))

    gradient = jax.jit(jax.grad(f), compiler_options=QUICK)(z)
    reverse = sum(jnp.sum((lines[n] * gradient[n][None]).reshape(len(lines[n]), -1), axis=1) for n in z)
    both = jax.jit(jax.vmap(jax.vmap(along, in_axes=(None, 0)), in_axes=(0, None)), compiler_options=QUICK)
    at, slopes = both(lines, e * jnp.array([-2.0, -1.0, 0.0, 1.0, 2.0]))
    difference, forward = at @ jnp.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * e), slopes[:, 2]
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(reverse, difference, rtol=rtol, atol=rtol)
    return gradient


@pytest.mark.parametrize(
    "how",
    [{"rtol": 1e-11, "atol": 1e-11, "control": FEW}, pytest.param({"steps": 40}, marks=pytest.mark.slow)],
    ids=["chosen", "fixed"],
)
def test_derivatives_by_all_inputs(how: dict[str, Any]) -> None:
    """The steps stay as they were chosen; their ends move with the times of the controls and of the solution."""
    gradient = checked(functools.partial(cost, **how), inputs(), 1e-3, 1e-7)
    for name, part in gradient.items():
        sizes = np.abs(np.asarray(part)).reshape(-1)
        assert np.isfinite(sizes).all()
        # Before its first time a held table has its first value: that time counts for nothing.
        assert (sizes[1:] if name == "switch" else sizes).min() > 1e-4
    assert float(gradient["switch"][0]) == 0.0


def test_a_function_of_time_may_close_over_what_is_differentiated() -> None:
    """x' = a cos(w t) - x from 0: the end is known, and so are its derivatives."""
    x, F = tx.State("x"), tx.Control("F")
    dynamics = tx.compile(tx.System(rates={x: F - x}))

    def end(z: Inputs) -> jax.Array:
        sol = tx.integrate(
            dynamics,
            {"x": jnp.zeros(())},
            t1=z["t1"],
            rtol=1e-11,
            atol=1e-11,
            u=lambda t: {"F": z["a"] * jnp.cos(z["w"] * t)},
            method=METHOD,
            control=tx.StepControl(max_steps=1000),
        )
        return sol.xs["x"][0]

    def exact(z: Inputs) -> jax.Array:
        w, t = z["w"], z["t1"]
        return z["a"] * (jnp.cos(w * t) + w * jnp.sin(w * t) - jnp.exp(-t)) / (1.0 + w * w)

    z = {"a": jnp.asarray(1.7), "w": jnp.asarray(3.0), "t1": jnp.asarray(2.0)}
    for mode in (jax.grad, jax.jacfwd):
        found, wanted = jax.jit(mode(end), compiler_options=QUICK)(z), jax.grad(exact)(z)
        for name in z:
            np.testing.assert_allclose(found[name], wanted[name], rtol=1e-8)


def oscillator() -> tx.Dynamics:
    """A pendulum with a push that may jump."""
    x, F, k = tx.State("x", shape=(2,)), tx.Control("F"), tx.Parameter("k", value=2.0)
    return tx.compile(tx.System(rates={x: tx.Concat(x[1], F - k * tx.Sin(x[0]))}))


@pytest.mark.slow
@pytest.mark.parametrize("how", ["chosen", "equal"])
def test_second_derivatives(how: str) -> None:
    """Forward over reverse against differences of the gradient, in start, parameter, jump and end."""
    dynamics = oscillator()
    options = (
        {"rtol": 1e-12, "atol": 1e-12, "control": tx.StepControl(max_steps=400)} if how == "chosen" else {"steps": 8}
    )

    def value(z: jax.Array) -> jax.Array:
        # Equal steps must end at the jump, whose time therefore scales with the solution.
        jump = z[3] if how == "chosen" else 0.5 * z[4]
        u = {"F": tx.ZeroOrderHold(jnp.stack([jnp.zeros(()), jump]), jnp.array([0.5, -1.0]))}
        sol = tx.integrate(dynamics, {"x": z[:2]}, t1=z[4], u=u, params={"k": z[2]}, method=METHOD, **options)
        return jnp.sin(sol.xs["x"][0, 0]) * sol.xs["x"][0, 1]

    z, e = jnp.array([0.4, 1.1, 2.3, 0.6, 1.3]), 1e-3
    gradient = jax.jit(jax.vmap(jax.grad(value)), compiler_options=QUICK)
    second = jax.jit(jax.jacfwd(jax.grad(value)), compiler_options=QUICK)(z)
    shifts = (e * jnp.array([-2.0, -1.0, 1.0, 2.0])[:, None, None] * jnp.eye(5)[None]).reshape(-1, 5)
    around = gradient(z[None] + shifts).reshape(4, 5, 5)
    difference = jnp.einsum("s,sij->ij", jnp.array([1.0, -8.0, 8.0, -1.0]), around) / (12.0 * e)
    np.testing.assert_allclose(second, difference, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(second, second.T, rtol=1e-7, atol=1e-9)
    assert float(jnp.abs(second[:3, :3]).min()) > 1e-4


@pytest.mark.parametrize("chart", [None, tx.charts.Ambient()], ids=repr)
def test_derivatives_at_no_turn_and_at_a_half_turn(chart: object) -> None:
    """The start is the identity, or turned by pi; w' = 0 and R' = R w: the end is R0 Exp(d) Exp(w), at rest and not."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    dynamics = tx.compile(tx.System(rates={R: w, w: 0.0 * w}))
    weights = jnp.cos(jnp.arange(9.0)).reshape(3, 3)

    def end(d: jax.Array, rate: jax.Array, R0: jax.Array) -> jax.Array:
        x0 = {"R": R0 @ so3.exp(d), "w": rate}
        sol = tx.integrate(
            dynamics,
            x0,
            t1=1.0,
            rtol=1e-11,
            atol=1e-11,
            method=tx.RKMK(TSIT5, chart),
            control=tx.StepControl(max_steps=60),
        )
        return jnp.sum(sol.xs["R"][0] * weights)

    def exact(d: jax.Array, rate: jax.Array, R0: jax.Array) -> jax.Array:
        return jnp.sum((R0 @ so3.exp(d) @ so3.exp(rate)) * weights)

    starts = jnp.stack([jnp.eye(3), jnp.diag(jnp.array([1.0, -1.0, -1.0])), jnp.diag(jnp.array([-1.0, -1.0, 1.0]))])
    rates = jnp.array([[0.0, 0.0, 0.0], [0.4, -0.3, 0.2], [0.0, 0.0, 3.0]])
    R0, rate = jnp.repeat(starts, 3, axis=0), jnp.tile(rates, (3, 1))
    zero = jnp.zeros((9, 3))
    found = jax.jit(jax.vmap(jax.grad(end, argnums=(0, 1))), compiler_options=QUICK)(zero, rate, R0)
    wanted = jax.vmap(jax.grad(exact, argnums=(0, 1)))(zero, rate, R0)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=2e-8)


@pytest.mark.slow
def test_lanes_of_a_batch_are_single_solutions_and_so_are_their_derivatives() -> None:
    """Lanes need different numbers of steps: each has its own."""
    dynamics = oscillator()
    starts = np.array([[0.1, 0.0], [3.0, 0.5], [1.0, 9.0]])
    ks = np.array([0.5, 30.0, 2.0])

    def solve(x: jax.Array, k: jax.Array) -> tx.Solution:
        return tx.integrate(
            dynamics,
            {"x": x},
            t1=2.0,
            rtol=1e-10,
            atol=1e-10,
            u={"F": tx.ZeroOrderHold(np.array([0.0, 0.9]), np.array([0.0, 1.0]))},
            params={"k": k},
            save_at=np.array([0.0, 0.7, 2.0]),
            method=METHOD,
            control=tx.StepControl(max_steps=500),
        )

    def value(x: jax.Array, k: jax.Array) -> jax.Array:
        sol = solve(x, k)
        return jnp.sum(sol.xs["x"][1]) * sol.xs["x"][2, 0]

    lanes = jax.jit(jax.vmap(solve))(starts, ks)
    slopes = jax.jit(jax.grad(lambda x, k: jnp.sum(jax.vmap(value)(x, k)), argnums=(0, 1)), compiler_options=QUICK)(
        starts, ks
    )
    counts = []
    for i in range(3):
        alone = solve(starts[i], ks[i])
        counts.append(alone.stats.accepted)
        # The two programs round differently, which may tip a step over.
        assert int(lanes.stats.accepted[i]) == pytest.approx(alone.stats.accepted, abs=1)
        np.testing.assert_allclose(lanes.xs["x"][i], alone.xs["x"], rtol=0.0, atol=1e-8)
        slope = float(slopes[0][i] @ np.array([0.6, -0.8])) + float(slopes[1][i])
        e = 1e-3
        at = [float(value(starts[i] + s * e * np.array([0.6, -0.8]), ks[i] + s * e)) for s in (-2, -1, 1, 2)]
        difference = (at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * e)
        assert slope == pytest.approx(difference, rel=1e-5, abs=1e-5)
    assert len(set(counts)) == 3


def test_a_traced_failure_is_not_a_number_and_says_why() -> None:
    """Of three lanes one blows up and one runs out of steps; the third is not disturbed."""
    x, k = tx.State("x"), tx.Parameter("k", value=1.0)
    dynamics = tx.compile(tx.System(rates={x: tx.Where(k >= 0.0, x * x * x, tx.Cos(1e4 * k * tx.Time()))}))
    ts = np.array([0.0, 0.25, 2.0])

    def solve(x: jax.Array, k: jax.Array) -> tx.Solution:
        return tx.integrate(
            dynamics,
            {"x": x},
            t1=2.0,
            rtol=1e-6,
            atol=1e-6,
            params={"k": k},
            save_at=ts,
            method=METHOD,
            control=tx.StepControl(max_steps=300),
        )

    starts, ks = np.array([0.1, 1.0, 0.0]), np.array([1.0, 1.0, -1.0])
    sol = jax.jit(jax.vmap(solve))(starts, ks)
    codes = [tx.Result(int(code)) for code in sol.code]
    assert codes[0] is tx.Result.SUCCESS
    assert codes[1] in (tx.Result.STEP_TOO_SMALL, tx.Result.NON_FINITE)
    assert codes[2] is tx.Result.MAX_STEPS
    np.testing.assert_array_equal(
        np.isfinite(sol.xs["x"]), [[True, True, True], [True, True, False], [True, False, False]]
    )
    np.testing.assert_allclose(sol.xs["x"][0], 0.1 / np.sqrt(1.0 - 0.02 * ts), rtol=1e-6)
    np.testing.assert_allclose(sol.xs["x"][1, :2], [1.0, np.sqrt(2.0)], rtol=1e-5)
    slopes = jax.jit(jax.vmap(jax.grad(lambda x, k: solve(x, k).xs["x"][1])))(starts[:2], ks[:2])
    np.testing.assert_allclose(slopes, (1.0 - 0.5 * starts[:2] ** 2) ** -1.5, rtol=1e-4)


@pytest.mark.parametrize("way", [{"steps": 4}, {"rtol": 1e-9}], ids=["equal", "chosen"])
def test_a_saved_time_at_the_start_moves_with_the_rate(way: dict) -> None:
    x, k = tx.State("x"), tx.Parameter("k", value=0.7)
    decay = tx.compile(tx.System(rates={x: -k * x}))

    def first(x0: jax.Array, t: jax.Array) -> jax.Array:
        sol = tx.integrate(decay, {"x": x0}, t1=1.0, save_at=jnp.stack([t, jnp.asarray(0.5)]), method=METHOD, **way)
        return sol.xs["x"][0]

    slopes = jax.jit(jax.grad(first, argnums=(0, 1)))(jnp.asarray(3.0), jnp.asarray(0.0))
    np.testing.assert_allclose(slopes, [1.0, -2.1], rtol=1e-12)
