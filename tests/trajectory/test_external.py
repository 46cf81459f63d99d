"""IPOPT and Fatrop on the same transcription: their derivatives, their answers, and what their ends mean."""

import gc
import time

import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import EULER, HEUN, double_integrator, fastest_turn

import twistax as tx

casadi = pytest.importorskip("casadi")

#: Fatrop runs in a process of its own unless it has no limit of time, IPOPT if it has one.
SOLVERS = [tx.trajectory.IPOPT(), tx.trajectory.Fatrop()]
IDS = ["ipopt", "fatrop"]


@pytest.fixture
def turning() -> tx.trajectory.Problem:
    return fastest_turn()


def test_they_find_what_the_interior_point_finds(turning: tx.trajectory.Problem) -> None:
    plain = turning.solve()
    assert plain.solved
    for solver in SOLVERS:
        result = turning.solve(solver=solver)
        assert result.solved, result.message
        assert result.cost == pytest.approx(plain.cost, rel=1e-6)
        assert np.allclose(result.us["M"], plain.us["M"], atol=2e-3)
        assert np.allclose(result.multipliers["dynamics of w"], plain.multipliers["dynamics of w"], atol=1e-4)
        assert result.optimality.stationarity <= 1e-6
        assert turning.solve(warm=result, solver=solver).iterations < result.iterations
        short = turning.solve(solver=solver, max_iterations=3)
        assert short.status is tx.trajectory.Status.MAX_ITERATIONS


@pytest.fixture(scope="module")
def pushing() -> tx.trajectory.Problem:
    """Least energy, rest to rest, in a second; 5 is as far as the limit lets it go."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-20.0, max=20.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
    return tx.trajectory.Problem(dynamics, tx.Minimize(running=u**2), nodes=6, final_time=1.0, **ends, **HEUN)


@pytest.mark.parametrize("solver", SOLVERS, ids=IDS)
def test_their_ends_are_said(
    pushing: tx.trajectory.Problem, solver: tx.trajectory.IPOPT | tx.trajectory.Fatrop
) -> None:
    seen: list[int] = []
    result = pushing.solve(solver=solver, callback=lambda count, cost, violation: seen.append(count))
    assert result.solved
    assert result.multipliers["final p"].shape == (1,)
    # Held over five intervals: 12 * 25 / 24.
    assert result.cost == pytest.approx(12.5, rel=1e-7)
    assert seen
    with pytest.raises(ZeroDivisionError):  # what users' functions raise is not taken for numbers that are not finite
        pushing.solve(solver=solver, callback=lambda count, cost, violation: 1 / 0)
    with pytest.raises(tx.TrajectoryError, match="nonsense"):
        pushing.solve(solver=type(solver)(options={"nonsense": 1}))


@pytest.mark.parametrize("solver", SOLVERS, ids=IDS)
def test_what_cannot_be_is_measured(
    pushing: tx.trajectory.Problem, solver: tx.trajectory.IPOPT | tx.trajectory.Fatrop
) -> None:
    """Fatrop has no word for it."""
    result = pushing.solve(solver=solver, final={"p": 20.0, "v": 0.0})
    assert result.status is tx.trajectory.Status.INFEASIBLE
    assert result.optimality.feasibility > 1e-3


@pytest.mark.parametrize("kind", [tx.trajectory.IPOPT, tx.trajectory.Fatrop], ids=IDS)
def test_a_process_of_their_own_finds_the_same(pushing: tx.trajectory.Problem, kind: type) -> None:
    here, there = (pushing.solve(solver=kind(max_seconds=own)) for own in (None, 100.0))
    assert here.solved
    assert here.cost == there.cost
    assert here.iterations == there.iterations
    assert np.array_equal(here.us["u"], there.us["u"])


def test_a_solver_that_hangs_is_ended() -> None:
    """Fatrop raises the diagonal until the inertia is right, by nothing here: a loop that calls nothing back."""
    u, p = tx.Control("u", min=-20.0, max=20.0), tx.State("p")
    dynamics = tx.compile(tx.System(rates={p: u}))
    ends = {"initial": {p: 0.0}, "final": {p: 1.0}}
    problem = tx.trajectory.Problem(dynamics, tx.Minimize(running=-(u**2)), nodes=4, final_time=1.0, **ends, **EULER)
    plain = problem.solve(solver=tx.trajectory.Fatrop())  # compiles
    for _ in range(2):
        begin = time.monotonic()
        result = problem.solve(solver=tx.trajectory.Fatrop({"delta_w0": 0.0, "delta_wmin": 0.0}, max_seconds=0.5))
        assert 0.5 <= time.monotonic() - begin < 5.0
        assert result.status is tx.trajectory.Status.OUT_OF_TIME
    assert problem.solve(solver=tx.trajectory.Fatrop()).cost == plain.cost


def test_a_process_that_ends_early_is_said(pushing: tx.trajectory.Problem) -> None:
    solver = tx.trajectory.Fatrop({"max_soc": 4})
    pushing.solve(solver=solver)
    (own,) = pushing._cores.values()
    (made,) = (made for key, made in own.made.items() if "max_soc" in str(key))
    process = made._process

    def broken(count: int, cost: float, violation: float) -> None:
        process.kill()
        process.wait()

    with pytest.raises(tx.TrajectoryError, match="ended before the solve was complete"):
        pushing.solve(solver=solver, callback=broken)
    assert pushing.solve(solver=solver).solved
    process = made._process
    del made, own
    pushing.forget()
    gc.collect()
    assert process.poll() is not None


def test_saddles_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """2 rad about z with rates in a box: straight it takes 2 s, and less by way of the other axes."""
    R, w = tx.State("R", group=tx.SO3), tx.Control("w", shape=(3,), min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={R: w}))
    ends = {"initial": {R: np.eye(3)}, "final": {R: np.asarray(tx.SO3.exp(jnp.array([0.0, 0.0, 2.0])))}}
    objective = tx.Minimize(tx.Time())
    problem = tx.trajectory.Problem(dynamics, objective, nodes=6, final_time=(0.5, 9.0), **ends, **EULER)
    result = problem.solve(solver=SOLVERS[0])
    assert result.solved
    assert not result.saddle
    assert result.final_time < 1.9
    monkeypatch.setattr(tx.trajectory.strategy.strategies, "_AWAY", ())
    result = problem.solve(solver=SOLVERS[0])
    assert result.saddle
    assert result.final_time == pytest.approx(2.0, rel=1e-5)


def test_what_is_no_solver_is_refused() -> None:
    problem = tx.trajectory.Problem(tx.compile(double_integrator()), tx.Minimize(tx.Time()), nodes=3, final_time=1.0)
    for solver in ("ipopt", tx.trajectory.IPOPT):
        with pytest.raises(tx.TrajectoryError, match="solver expects"):
            problem.solve(solver=solver)
    for seconds in (0.0, float("inf")):
        with pytest.raises(tx.TrajectoryError, match="max_seconds"):
            tx.trajectory.Fatrop(max_seconds=seconds)
    for options, text in (("ma27", "dict of options, got 'ma27'"), ({"max_iter": 3}, "max_iterations")):
        with pytest.raises(tx.TrajectoryError, match=text):
            tx.trajectory.IPOPT(options)
