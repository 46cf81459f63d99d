"""Solutions by implicit methods: failures by name, saved times, derivatives, batches, precision, compiling once."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from compilations import compilations
from twistax.scenes import stiff_attitude
from twistax.tableaus import GAUSS_LEGENDRE4, RADAU_IIA3, RADAU_IIA5

RADAU = tx.ImplicitRKMK(RADAU_IIA5)
SCENE = stiff_attitude.scene(1e5)


@functools.cache
def hold() -> tx.Dynamics:
    return tx.compile(stiff_attitude.system())


@functools.cache
def wall() -> tx.Dynamics:
    """A rate that turns back at x = 0.5: no step across it has a solution."""
    x = tx.State("x")
    return tx.compile(tx.System(rates={x: tx.Where(x >= 0.5, -1.0, 1.0)}))


# ---- failures --------------------------------------------------------------------------------------------------------


def test_a_fixed_step_without_a_solution_ends_the_solution_by_name() -> None:
    sol = tx.integrate(wall(), {"x": 0.0}, t1=1.0, steps=7, method=RADAU, throw=False)
    assert sol.result is tx.Result.NEWTON_FAILED
    assert sol.stats.accepted == 3
    assert sol.xs["x"][-1] == pytest.approx(3 / 7)
    with pytest.raises(tx.IntegrationError, match=r"Radau IIA 5.* could not be solved at t = 0\.428.*") as caught:
        tx.integrate(wall(), {"x": 0.0}, t1=1.0, steps=7, method=RADAU)
    assert "smaller dt" in str(caught.value)


def test_chosen_steps_shrink_until_none_has_a_solution() -> None:
    options = {"t1": 1.0, "rtol": 1e-6, "method": RADAU, "control": tx.StepControl(dtmin=1e-4)}
    sol = tx.integrate(wall(), {"x": 0.0}, throw=False, **options)
    assert sol.result is tx.Result.NEWTON_FAILED
    assert sol.ts[-1] == pytest.approx(0.5, abs=1e-3)
    assert sol.stats.rejected > 5
    with pytest.raises(tx.IntegrationError, match=r"could not be solved at t = 0\.[45]") as caught:
        tx.integrate(wall(), {"x": 0.0}, **options)
    assert "jumps=" in str(caught.value)


@pytest.mark.parametrize(("push", "damping", "rtol"), [(3.3, 20.0, 1e-5), (3.3, 20.0, 1e-4), (2.0, 5.0, 1e-3)])
def test_a_part_of_a_step_with_a_corner_of_the_rates_has_a_solution(push: float, damping: float, rtol: float) -> None:
    """Friction of a bristle at rest: |v| has a corner, and long steps contain it. Newton's method with the Jacobian at
    the start of the step fails; it starts once more with secants.
    """
    start, times = dict.fromkeys("xvz", 0.0), np.linspace(0.0, 20.0, 41)
    options = {"t1": 20.0, "rtol": rtol, "method": RADAU, "params": {"push": push, "damping": damping}}
    rows = tx.integrate(bristle(), start, save_at=times, dense=True, **options)
    for z in (rows.xs["z"], rows.evaluate(times)["z"]):
        np.testing.assert_allclose(z[20:], push / 4.6 * 1e-3, rtol=rtol)  # the bristle carries the push


@functools.cache
def bristle() -> tx.Dynamics:
    x, v, z = (tx.State(name) for name in "xvz")
    bent, push, damping = v - tx.Abs(v) * z / 1e-3, tx.Parameter("push"), tx.Parameter("damping")
    return tx.compile(tx.System(rates={x: v, z: bent, v: push - 4.6 * (z / 1e-3 + damping * bent)}))


def test_a_part_of_a_step_without_a_solution_is_no_infinite_state() -> None:
    """A rate that is infinite at one time alone, which no whole step meets."""
    x = tx.State("x")
    singular = tx.compile(tx.System(rates={x: -x + 1e-30 / (tx.Time() - 0.5) ** 2}))
    options = {"t1": 1.0, "rtol": 1e-6, "method": RADAU}
    with pytest.raises(tx.IntegrationError, match=r"could not be solved[\s\S]*jumps=save_at"):
        tx.integrate(singular, {"x": 1.0}, save_at=np.array([0.4, 0.5]), **options)
    dense = tx.integrate(singular, {"x": 1.0}, dense=True, **options)
    np.testing.assert_allclose(dense.evaluate(np.array([0.4]))["x"], np.exp(-0.4), rtol=1e-5)
    with pytest.raises(tx.IntegrationError, match="evaluate: the equations"):
        dense.evaluate(np.array([0.4, 0.5]))


def test_a_step_taken_back_is_halved_and_the_solution_goes_on() -> None:
    """A first step far too long for a rate that bends hard."""
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -tx.Exp(20.0 * x)}))
    sol = tx.integrate(dynamics, {"x": 1.0}, t1=1.0, dt=1.0, rtol=1e-8, method=RADAU)
    assert sol.stats.rejected > 3
    exact = -np.log(np.exp(-20.0) + 20.0) / 20.0
    np.testing.assert_allclose(sol.xs["x"][-1], exact, rtol=1e-7)


def test_rates_that_are_no_numbers_are_said_to_be() -> None:
    x, p = tx.State("x"), tx.Parameter("p")
    dynamics = tx.compile(tx.System(rates={x: p / x}))
    for options in ({"steps": 5}, {"rtol": 1e-6}):
        sol = tx.integrate(dynamics, {"x": 0.0}, t1=1.0, params={"p": 1.0}, method=RADAU, throw=False, **options)
        assert sol.result is tx.Result.NON_FINITE


def test_gauss_chooses_no_steps() -> None:
    with pytest.raises(tx.ModelError, match=r"Gauss-Legendre 4.*last stage is not the end"):
        tx.integrate(wall(), {"x": 0.0}, t1=1.0, rtol=1e-6, method=tx.ImplicitRKMK(GAUSS_LEGENDRE4))


def test_what_is_no_tableau_or_chart_is_refused(unchecked: None) -> None:
    with pytest.raises(tx.ModelError, match="RADAU_IIA5"):
        tx.ImplicitRKMK(tx.tableaus.RK4)
    with pytest.raises(tx.ModelError, match="chart"):
        tx.ImplicitRKMK(RADAU_IIA5, "exponential")


# ---- saved times -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_saved_times_change_no_step_and_are_as_accurate_as_the_solution() -> None:
    start = {"R": tx.lie.so3.exp(jnp.array([0.3, -0.2, 0.5])), "w": jnp.asarray(0.4)}
    options = {"params": {"k": 1e5}, "atol": 1e-8, "method": RADAU}
    ts = np.array([0.0, 1e-5, 0.3, 0.30001, 2.0, 5.0])
    alone = tx.integrate(arm(), start, t1=5.0, rtol=1e-8, **options)
    saved = tx.integrate(arm(), start, t1=5.0, rtol=1e-8, save_at=ts, dense=True, **options)
    assert saved.stats.steps == alone.stats.steps
    for name in ("R", "w"):
        np.testing.assert_allclose(saved.xs[name][-1], alone.xs[name][-1], atol=1e-14)
        np.testing.assert_allclose(saved.evaluate(ts)[name], saved.xs[name], atol=1e-12)
    for i, t in enumerate(ts[1:5], start=1):
        end = tx.integrate(arm(), start, t1=t, rtol=1e-11, **options)
        for name in ("R", "w"):
            np.testing.assert_allclose(saved.xs[name][i], end.xs[name][-1], atol=1e-7)
    orthogonal = np.einsum("nij,nik->njk", saved.xs["R"], saved.xs["R"]) - np.eye(3)
    assert np.abs(orthogonal).max() < 1e-14


@pytest.mark.slow
def test_steps_that_learn_from_the_last_one_end_where_steps_alone_do() -> None:
    """With fixed steps both are solved to round-off: a solution of twenty steps is twenty solutions of one."""
    options = {"params": SCENE.params, "method": RADAU}
    start = {"p": 0.3, "w": 0.4}
    together = tx.integrate(actuator(), start, t1=0.4, steps=20, **options)
    x, evaluations = start, 0
    for k in range(20):
        sol = tx.integrate(actuator(), x, t0=0.02 * k, t1=0.02 * (k + 1), steps=1, **options)
        x, evaluations = {name: value[-1] for name, value in sol.xs.items()}, evaluations + sol.stats.rhs_evaluations
    assert together.stats.rhs_evaluations < 0.9 * evaluations
    for name in ("p", "w"):
        np.testing.assert_allclose(together.xs[name][-1], x[name], atol=1e-13)


# ---- derivatives and batches -----------------------------------------------------------------------------------------


@functools.cache
def actuator() -> tx.Dynamics:
    """A number whose rate a stiff, nonlinear actuator sets within 1/k."""
    p, w, k = tx.State("p"), tx.State("w"), tx.Parameter("k")
    return tx.compile(tx.System(rates={p: w, w: k * (tx.Cos(p) - w**3 - w)}))


@functools.cache
def arm() -> tx.Dynamics:
    """A rotation that such an actuator turns."""
    R, w, k = tx.State("R", group=tx.SO3), tx.State("w"), tx.Parameter("k")
    wanted = tx.Cos(R[0, 1]) - w**3
    return tx.compile(tx.System(rates={R: tx.Concat(w, 0.3, R[2, 2]), w: k * (wanted - w)}))


CHOSEN = {"rtol": 1e-11, "method": RADAU, "save_at": [0.3, 0.5], "control": tx.StepControl(max_steps=2048)}
FIXED = {"steps": 12, "method": RADAU}
SYMMETRIC = {"steps": 12, "method": tx.ImplicitRKMK(GAUSS_LEGENDRE4)}


def check_gradient(cost: Callable[[jax.Array], jax.Array], z: jax.Array) -> None:
    """Forward, reverse and differences agree."""
    step, run = 1e-3, jax.jit(cost)
    reverse, forward = jax.jit(lambda z: (jax.grad(cost)(z), jax.jacfwd(cost)(z)))(z)
    numeric = [
        (8.0 * (run(z + e) - run(z - e)) - (run(z + 2.0 * e) - run(z - 2.0 * e))) / (12.0 * step)
        for e in step * jnp.eye(z.size)
    ]
    scale = float(jnp.abs(forward).max())
    assert scale > 0.1
    np.testing.assert_allclose(reverse, forward, atol=1e-12 * scale)
    np.testing.assert_allclose(reverse, jnp.stack(numeric), atol=1e-8 * scale)


@pytest.mark.parametrize(
    ("options", "rate"),
    [(CHOSEN, 1e5), pytest.param(SYMMETRIC, 10.0, marks=pytest.mark.slow)],
    ids=["chosen", "symmetric"],
)
def test_derivatives(options: dict[str, Any], rate: float) -> None:
    """With respect to start, final time and stiffness."""

    def cost(z: jax.Array) -> jax.Array:
        x, params = {"p": z[0], "w": z[1]}, {"k": rate * jnp.exp(z[3])}
        sol = tx.integrate(actuator(), x, t1=0.5 + 0.1 * z[2], params=params, **options)
        return sol.xs["p"][0] + sol.xs["p"][-1] + 2.0 * sol.xs["w"][-1]

    check_gradient(cost, jnp.array([0.3, 0.4, 0.1, -0.3]))


@pytest.mark.slow
@pytest.mark.parametrize("options", [CHOSEN, FIXED], ids=["chosen", "fixed"])
def test_derivatives_on_a_group(options: dict[str, Any]) -> None:
    def cost(z: jax.Array) -> jax.Array:
        x = {"R": tx.lie.so3.exp(z[:3]), "w": z[3]}
        sol = tx.integrate(arm(), x, t1=0.5 + 0.1 * z[4], params={"k": 1e5 * jnp.exp(z[5])}, **options)
        return sol.xs["R"][0, 0, 1] + sol.xs["R"][-1, 1, 2] + sol.xs["w"][-1]

    check_gradient(cost, jnp.array([0.3, -0.2, 0.5, 0.4, 0.1, -0.3]))


@pytest.mark.slow
def test_second_derivatives() -> None:
    x, k = tx.State("x"), tx.Parameter("k")
    dynamics = tx.compile(tx.System(rates={x: -k * x**3}))

    def end(z: jax.Array) -> jax.Array:
        sol = tx.integrate(dynamics, {"x": z[0]}, t1=1.0, steps=20, params={"k": z[1]}, method=RADAU)
        return sol.xs["x"][-1]

    def exact(z: jax.Array) -> jax.Array:
        return z[0] / jnp.sqrt(1.0 + 2.0 * z[1] * z[0] ** 2)

    z = jnp.array([0.8, 1.5])
    np.testing.assert_allclose(jax.jit(jax.hessian(end))(z), jax.hessian(exact)(z), rtol=1e-6)


def test_a_batch_is_a_loop() -> None:
    rates = jnp.array([1e2, 1e5, 1e8])

    def solve(k: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        start = {"p": jnp.asarray(0.3), "w": jnp.asarray(0.4)}
        sol = tx.integrate(actuator(), start, t1=1.0, rtol=1e-7, atol=1e-7, params={"k": k}, method=RADAU)
        return sol.xs, sol.stats.steps

    batch, steps = jax.jit(jax.vmap(solve))(rates)
    one = jax.jit(solve)
    for i, k in enumerate(rates):
        alone, count = one(k)
        assert steps[i] == count
        for name, value in alone.items():
            np.testing.assert_allclose(batch[name][i], value, atol=1e-11)


# ---- precision, values, compiling ------------------------------------------------------------------------------------


def test_single_precision() -> None:
    start = {name: np.asarray(value, np.float32) for name, value in SCENE.start.items()}
    sol = tx.integrate(hold(), start, t1=5.0, params={"k": np.float32(1e5)}, method=RADAU, rtol=1e-4, atol=1e-4)
    equal = tx.integrate(
        actuator(),
        {"p": np.float32(0.3), "w": np.float32(0.4)},
        t1=1.0,
        steps=20,
        params={"k": np.float32(1e5)},
        method=RADAU,
    )
    double = tx.integrate(actuator(), {"p": 0.3, "w": 0.4}, t1=1.0, steps=20, params={"k": 1e5}, method=RADAU)
    for found, wanted in ((sol.xs, SCENE.reference), (equal.xs, {n: v[-1] for n, v in double.xs.items()})):
        for name, value in wanted.items():
            assert found[name].dtype == np.float32
            np.testing.assert_allclose(found[name][-1], value, atol=1e-4)


def test_methods_are_values() -> None:
    assert tx.ImplicitRKMK(RADAU_IIA5, tx.charts.Exponential()) == RADAU
    assert hash(RADAU) == hash(tx.ImplicitRKMK(RADAU_IIA5))
    assert tx.ImplicitRKMK(RADAU_IIA3) != RADAU
    assert tx.ImplicitRKMK(RADAU_IIA5, tx.charts.Ambient()) != RADAU
    assert "Radau IIA 5" in RADAU.name


@pytest.mark.slow
def test_another_solution_does_not_compile_again() -> None:
    def solve(k: float, **options: float) -> None:
        tx.integrate(actuator(), {"p": 0.3, "w": 0.4}, params={"k": k}, method=tx.ImplicitRKMK(RADAU_IIA5), **options)

    solve(1e3, t1=0.1, dt=0.01)
    solve(1e3, t1=0.1, rtol=1e-5)
    with compilations() as more:
        solve(1e6, t1=0.2, dt=0.02)
        solve(1e6, t1=0.2, rtol=1e-7)
    assert not more


@pytest.mark.parametrize(
    "how", [{"dt": 0.25}, pytest.param({"rtol": 1e-6}, marks=pytest.mark.slow)], ids=["fixed", "adaptive"]
)
def test_derivatives_of_saved_states_of_rates_with_branches(how: dict[str, float]) -> None:
    x = tx.State("x", shape=(2,))
    dynamics = tx.compile(tx.System({x: tx.Cond(x[0] <= 5.0, -x * x, -2.0 * x)}))

    def total(start: jax.Array) -> jax.Array:
        method = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)
        found = tx.integrate(dynamics, {"x": start}, t1=1.0, method=method, save_at=np.array([0.3, 0.9]), **how)
        return found.xs["x"].sum()

    start = np.array([1.0, 0.3])
    expected = sum((1.0 / (1.0 + start * t)) ** 2 for t in (0.3, 0.9))  # of x / (1 + x t)
    reverse, forward = jax.jit(lambda start: (jax.grad(total)(start), jax.jacfwd(total)(start)))(start)
    np.testing.assert_allclose(reverse, expected, rtol=2e-4)
    np.testing.assert_allclose(forward, reverse, rtol=1e-8)
