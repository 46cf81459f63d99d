"""What diffrax offers around a solver works with Lie-group steps: saving, events, meters, derivatives, batches."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from lie_solver_cases import apart, defect, last, reference, solve, start, starts, top

import twistax as tx

TIMES = np.array([0.0, 0.13, 0.4, 0.77, 1.0])


def wanted_at(ts: Any) -> dict[str, jax.Array]:
    return tx.integrate(top(), start(), t1=1.0, rtol=1e-11, method=tx.RKMK(tx.tableaus.DOP853), save_at=ts).xs


def test_saved_times_dense_output_steps_and_functions() -> None:
    """One solution that saves everything, the state between steps in its group."""
    subs = {
        "times": diffrax.SubSaveAt(ts=TIMES),
        "steps": diffrax.SubSaveAt(t0=True, steps=1),
        "seen": diffrax.SubSaveAt(ts=TIMES, fn=lambda t, y, args: y["R"][0] @ y["w"] + t),
    }
    sol = solve(diffrax.Tsit5(), 1.0, saveat=diffrax.SaveAt(subs=subs, dense=True), max_steps=128)
    wanted = wanted_at(TIMES)
    assert apart(sol.ys["times"], wanted) < 2e-6
    assert defect(sol.ys["times"]["R"]) < 2e-15
    seen = jnp.einsum("ti,ti->t", wanted["R"][:, 0], wanted["w"]) + TIMES
    np.testing.assert_allclose(sol.ys["seen"], seen, atol=1e-5)
    between = jax.vmap(sol.evaluate)(jnp.asarray(TIMES))
    assert apart(between, sol.ys["times"]) < 1e-15
    steps = int(sol.stats["num_accepted_steps"])
    assert sol.ts["steps"][steps] == 1.0
    assert not np.isfinite(sol.ts["steps"][steps + 1 :]).any()
    assert apart({name: value[steps] for name, value in sol.ys["steps"].items()}, reference(1.0)) < 1e-6
    rate = sol.derivative(jnp.asarray(0.5))["w"]
    at = sol.evaluate(jnp.asarray(0.5))
    np.testing.assert_allclose(rate, top()(0.5, at)["w"], atol=1e-4)


def spinner() -> tx.Dynamics:
    """A body that falls and spins at its own rate, both known exactly."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(3,))
    spin = tx.Parameter("spin", shape=(3,), value=[0.3, -0.4, 1.2])
    velocity = g[:3, :3].T @ V
    return tx.compile(tx.System(rates={g: tx.lie.twist(linear=velocity, angular=spin), V: np.array([0.0, 0.0, -9.81])}))


FALL = {"g": np.asarray(tx.pose(position=[0.0, 0.0, 5.0])), "V": np.zeros(3)}


def meeting(height: Any) -> tuple[Any, Any]:
    """When the ground is met, the pose there, and whether it was met at all."""
    dynamics = spinner()
    x = {"g": jnp.asarray(FALL["g"]).at[2, 3].set(height), "V": jnp.asarray(FALL["V"])}
    sol = diffrax.diffeqsolve(
        tx.diffrax.lie_term(dynamics),
        tx.diffrax.LieSolver(diffrax.Bosh3(), dynamics),
        0.0,
        3.0,
        0.3,
        x,
        event=diffrax.Event(lambda t, y, args, **_: y["g"][2, 3], optimistix.Newton(rtol=1e-12, atol=1e-12)),
        max_steps=16,
    )
    return sol.ts[-1], (sol.ys["g"][-1], sol.event_mask)


def test_an_event_is_found_on_the_group() -> None:
    """The ground is met at sqrt(2 h / g); the spin is constant, so the chart is exact."""
    time, (pose, mask) = jax.jit(meeting)(jnp.asarray(5.0))
    exact = np.sqrt(2.0 * 5.0 / 9.81)
    assert bool(mask)
    np.testing.assert_allclose(time, exact, rtol=1e-3)
    np.testing.assert_allclose(pose[2, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], tx.lie.so3.exp(np.array([0.3, -0.4, 1.2]) * time), atol=1e-12)


@pytest.mark.slow
def test_the_time_of_an_event_has_its_derivative() -> None:
    slope = jax.jit(jax.grad(lambda height: meeting(height)[0]))(jnp.asarray(5.0))
    np.testing.assert_allclose(slope, 1.0 / np.sqrt(2.0 * 5.0 * 9.81), rtol=1e-2)


def cost(z: jax.Array, adjoint: Any) -> jax.Array:
    """Of the start's spin, how it is turned, and of a parameter."""
    x = {"R": tx.lie.so3.compose(start()["R"], tx.lie.so3.exp(z[:3])), "w": start()["w"] + z[3:6]}
    sol = solve(
        diffrax.Tsit5(),
        0.5,
        0.05,
        x,
        args=(None, {"J": jnp.array([1.0, 2.0, 3.0]) + z[6:]}),
        adjoint=adjoint,
        max_steps=16,
    )
    return jnp.sum(jnp.sin(sol.ys["R"][-1] @ sol.ys["w"][-1]))


@pytest.mark.slow
@pytest.mark.parametrize(
    "adjoint", [diffrax.RecursiveCheckpointAdjoint(), pytest.param(diffrax.DirectAdjoint(), marks=pytest.mark.slow)]
)
def test_reverse_derivatives(adjoint: Any) -> None:
    z = jnp.asarray(np.random.default_rng(5).normal(size=9) * 0.1)
    run = jax.jit(jax.value_and_grad(lambda z: cost(z, adjoint)))
    slope = run(z)[1]
    for direction in np.random.default_rng(6).normal(size=(3, 9)):
        numeric = (run(z + 1e-5 * direction)[0] - run(z - 1e-5 * direction)[0]) / 2e-5
        np.testing.assert_allclose(slope @ direction, numeric, rtol=1e-7)


@pytest.mark.slow
def test_forward_derivatives() -> None:
    z = jnp.asarray(np.random.default_rng(5).normal(size=9) * 0.1)
    direction = jnp.ones(9)
    run = jax.jit(lambda z: jax.jvp(lambda z: cost(z, diffrax.ForwardMode()), (z,), (direction,)))
    slope = run(z)[1]
    numeric = (run(z + 1e-5 * direction)[0] - run(z - 1e-5 * direction)[0]) / 2e-5
    np.testing.assert_allclose(slope, numeric, rtol=1e-7)


@pytest.mark.slow
def test_derivatives_through_an_implicit_solver() -> None:
    solver = diffrax.Kvaerno3(root_finder=optimistix.Newton(rtol=1e-10, atol=1e-12))

    def end(w: jax.Array) -> jax.Array:
        return jnp.sum(last(solve(solver, 0.5, 0.05, {"R": start()["R"], "w": w}, max_steps=16))["R"] ** 3)

    w = jnp.asarray(start()["w"])
    value, slope = jax.jit(jax.value_and_grad(end)), jax.jit(jax.grad(end))(w)
    step = 1e-5 * jnp.ones(3)
    np.testing.assert_allclose((value(w + step)[0] - value(w - step)[0]) / 2e-5, slope.sum(), rtol=1e-6)


def test_a_batch_is_its_members(capfd: pytest.CaptureFixture[str]) -> None:
    """With a progress meter, which must not mind; each member takes its own steps."""
    meter = diffrax.TextProgressMeter(minimum_increase=0.5)
    solve_one = jax.jit(lambda x: last(solve(diffrax.Bosh3(), 0.5, x=x, progress_meter=meter)))
    many = starts(3)
    found = jax.jit(jax.vmap(lambda x: last(solve(diffrax.Bosh3(), 0.5, x=x))))(many)
    for i in range(3):
        one = solve_one({name: value[i] for name, value in many.items()})
        assert apart({name: value[i] for name, value in found.items()}, one) < 1e-12
    assert "100" in capfd.readouterr().out


@pytest.mark.slow
def test_backwards_and_forwards_is_home_again() -> None:
    dynamics, control = top(), tx.diffrax.controller(1e-10)
    solver = tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics)
    there = last(solve(diffrax.Tsit5(), 1.0, stepsize_controller=control))
    back = diffrax.diffeqsolve(
        tx.diffrax.lie_term(dynamics), solver, 1.0, 0.0, None, there, stepsize_controller=control
    )
    assert apart(last(back), start()) < 1e-8


@pytest.mark.slow
def test_jumps_of_tables_and_functions() -> None:
    """A table that jumps at the end of a step is read on the right side by every step; a function with jump_ts too."""
    x, F = tx.State("x"), tx.Control("F")
    motor = tx.compile(tx.System(rates={x: F - x}))
    exact = 2.0 * np.exp(-0.5) * (1.0 - np.exp(-0.5)) - (1.0 - np.exp(-0.5))

    def integrated(u: Any, control: Any) -> float:
        sol = diffrax.diffeqsolve(
            tx.diffrax.lie_term(motor),
            tx.diffrax.LieSolver(diffrax.Tsit5(), motor),
            0.0,
            1.0,
            0.05,
            {"x": np.array(0.0)},
            args=(u, None),
            stepsize_controller=control,
        )
        return float(sol.ys["x"][-1])

    table = {"F": tx.ZeroOrderHold([0.0, 0.5], [2.0, -1.0])}
    assert abs(integrated(table, diffrax.ConstantStepSize()) - exact) < 1e-9
    assert abs(integrated(table, tx.diffrax.controller(1e-10, step_ts=[0.5])) - exact) < 1e-9
    switched = lambda t: {"F": jnp.where(t < 0.5, 2.0, -1.0)}  # noqa: E731
    assert abs(integrated(switched, tx.diffrax.controller(1e-10, jump_ts=[0.5])) - exact) < 1e-9
