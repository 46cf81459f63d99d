"""Hessians by option, against exact second derivatives, on problems whose steps tell them apart."""

import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.errors import TrajectoryError
from twistax.trajectory import Collocation, GaussNewton, Phase, Problem, QuasiNewton, solution

p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
pair, push = tx.State("pair", shape=(2,)), tx.Control("push", shape=(2,))
weight, target = tx.Parameter("weight", value=0.3), tx.Parameter("target", value=[1.0, -0.5], shape=(2,))
WEIGHTS = np.array([[2.0, 0.5], [0.5, 1.0]])
off = pair - target
ALL = (None, GaussNewton(), QuasiNewton())

SQUARES: dict[str, Any] = {
    "squares of entries": push[0] ** 2 + 2.0 * push[1] ** 2 + off[0] * off[0] * weight,
    "products of vectors": push @ push + off @ off / 0.2,
    "matrices": off @ WEIGHTS @ off + 0.1 * (push @ push),
    "factors within": 0.1 * push @ push + (-off / 2.0) @ WEIGHTS @ (-0.5 * off) + np.array([1.0, 2.0]) * off @ off,
    "matrices on the right": off @ (WEIGHTS @ off) + weight * tx.linalg.Dot(push, push),
    "weights in front": np.array([1.0, 3.0]) @ off**2 + tx.linalg.Sum(0.1 * push**2),
    "norms": tx.linalg.Norm(off) ** 2 + 0.1 * tx.linalg.Norm(push) ** 2,
    "linear terms": 0.1 * push @ push + off @ off + pair[0] - 2.0 * tx.Time() + 1.0,
    "weights of time": (1.0 + tx.Time()) * (push @ push) + off @ off,
    "differences": push @ push - (0.1 * (-off) @ off),
}


def linear(running: Any, hessian: Any = None, **options: Any) -> Problem:
    """A point in a plane, pushed, without limits."""
    speed = tx.State("speed", shape=(2,))
    dynamics = tx.compile(tx.System(rates={pair: speed, speed: push - 0.3 * pair}))
    objective = tx.Minimize(3.0 * tx.linalg.Sum((pair - 0.5) ** 2), running=running)
    ends = {pair: [0.0, 0.2], speed: [0.0, 0.0]}
    return Problem(dynamics, objective, nodes=9, final_time=2.0, initial=ends, hessian=hessian, **options)


def pendulum(hessian: Any = None, swing: bool = False, **options: Any) -> Problem:
    """A damped pendulum, swung up at the least torque, or held at an angle that it can be held at."""
    angle, rate, torque = tx.State("angle"), tx.State("rate"), tx.Control("torque", min=-8.0, max=8.0)
    dynamics = tx.compile(tx.System(rates={angle: rate, rate: torque - 9.81 * tx.Sin(angle) - 0.1 * rate}))
    cost: Any = tx.Minimize(running=torque**2)
    if not swing:
        cost = tx.Minimize(running=(tx.Sin(angle) - 0.6) ** 2 + 0.1 * rate**2 + 1e-3 * torque**2)
    ends = {"initial": {angle: 0.0, rate: 0.0}, "final": {angle: np.pi, rate: 0.0} if swing else None}
    return Problem(dynamics, cost, **{"nodes": 21, "final_time": 2.0, "hessian": hessian, **ends, **options})


def fastest(hessian: Any = None) -> Problem:
    """A double integrator in the least time, which is 2."""
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends: Any = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=25, final_time=(0.5, 6.0), hessian=hessian, **ends)


@pytest.mark.parametrize("name", SQUARES)
def test_gauss_newton_takes_the_steps_of_newton_where_residuals_are_linear(name: str) -> None:
    exact, found = (linear(SQUARES[name], hessian).solve() for hessian in (None, GaussNewton()))
    assert found.solved
    assert found.iterations <= exact.iterations <= 3
    assert found.cost == pytest.approx(exact.cost, rel=1e-10)


def test_gauss_newton_of_collocation_and_of_a_free_time_has_the_same_optimum() -> None:
    options: Any = {"transcription": Collocation(tx.tableaus.RADAU_IIA5)}
    exact, found = (linear(SQUARES["matrices"], hessian, **options).solve() for hessian in (None, GaussNewton()))
    assert found.iterations <= exact.iterations <= 3
    exact, found = (pendulum(hessian, final_time=(1.0, 3.0)).solve() for hessian in (None, GaussNewton()))
    assert exact.solved
    assert found.solved
    assert found.final_time == pytest.approx(exact.final_time, rel=1e-4)
    assert found.cost == pytest.approx(exact.cost, rel=1e-6)


def test_gauss_newton_follows_a_nonlinear_residual() -> None:
    exact, found = (pendulum(hessian).solve() for hessian in (None, GaussNewton()))
    assert found.solved
    assert found.iterations <= 2 * exact.iterations
    assert found.cost == pytest.approx(exact.cost, rel=1e-6)


def test_gauss_newton_of_attitudes() -> None:
    R, spin = tx.State("R", group=tx.SO3), tx.Control("spin", shape=(3,))
    dynamics = tx.compile(tx.System(rates={R: spin}))
    wanted = np.asarray(tx.SO3.exp(jnp.array([0.3, -1.0, 0.4])))
    error = tx.lie.SO3Log(tx.lie.Compose(wanted.T, R))
    cost = tx.Minimize(error @ error, running=0.1 * spin @ spin)
    exact, found = (
        Problem(dynamics, cost, nodes=9, final_time=1.0, initial={R: np.eye(3)}, hessian=hessian).solve()
        for hessian in (None, GaussNewton())
    )
    # Turned about one axis at constant rate: a turn theta costs (a - theta)^2 + 0.1 theta^2.
    turn = np.sqrt(0.3**2 + 1.0 + 0.4**2)
    assert found.solved
    assert found.cost == pytest.approx(turn**2 * 0.1 / 1.1, rel=1e-6)
    assert found.iterations <= exact.iterations + 2


@pytest.mark.parametrize("objective", [p * u, u**4, tx.Cos(p), p**3])
def test_what_is_no_sum_of_squares_is_refused(objective: Any) -> None:
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    with pytest.raises(TrajectoryError, match=r"GaussNewton expects .* sum of squares.*\n.*fix: "):
        Problem(
            dynamics, tx.Minimize(running=objective), final_time=1.0, initial={p: 0.0, v: 0.0}, hessian=GaussNewton()
        )


def test_quasi_newton_has_the_optima_of_newton() -> None:
    exact, found = (pendulum(hessian, swing=True).solve() for hessian in (None, QuasiNewton()))
    assert found.solved
    assert found.cost == pytest.approx(exact.cost, rel=1e-6)
    assert found.iterations <= 60
    found = fastest(QuasiNewton()).solve()
    assert found.solved
    assert found.cost == pytest.approx(2.0, abs=1e-6)
    assert found.iterations <= 35


def test_solvers_of_others_get_no_updates() -> None:
    with pytest.raises(
        TrajectoryError, match=r"QuasiNewton\(\) has no second derivatives for IPOPT.*\n.*leave out hessian= or solver="
    ):
        fastest(QuasiNewton()).solve(solver=tx.trajectory.IPOPT())


def test_quasi_newton_of_phases_and_attitudes() -> None:
    R, spin = tx.State("R", group=tx.SO3), tx.Control("spin", shape=(3,))
    turning = tx.compile(tx.System(rates={R: spin}, constraints={"slow": spin[2] <= 0.5}))
    wanted, cost = np.asarray(tx.SO3.exp(jnp.array([0.3, -1.0, 0.4]))), tx.Minimize(running=spin @ spin)
    first = Phase(turning, cost, nodes=7, final_time=0.5, initial={R: np.eye(3)}, name="a", hessian=QuasiNewton())
    last = Phase(turning, cost, nodes=7, final_time=(0.2, 0.5), final={R: wanted}, name="b", hessian=QuasiNewton())
    found = Problem([first, last]).solve()
    assert found.solved
    assert found.cost == pytest.approx(0.3**2 + 1.0 + 0.4**2, rel=1e-6)  # at a constant rate, in the longest time
    assert found.iterations <= 40  # 193 on six nodes where tangent spaces count as one


def test_an_optimum_by_updates_has_exact_derivatives() -> None:
    optima = [solution(pendulum(hessian)) for hessian in ALL]
    slopes = [jax.jacfwd(lambda v0, own=own: own(initial={"rate": v0}).cost)(0.1) for own in optima]
    np.testing.assert_allclose(slopes, np.full(3, slopes[0]), rtol=1e-6)


def test_prices_of_soft_constraints_are_squares_and_what_is_linear() -> None:
    dynamics = tx.compile(tx.System(rates={p: v, v: u}, constraints={"slow": tx.Soft(v <= 0.4, l1=weight, l2=2.0)}))
    ends: Any = {"initial": {p: 0.0, v: 0.0}, "final": {p: 0.5, v: 0.0}, "nodes": 9, "final_time": 2.0}
    exact, found, updated = (
        Problem(dynamics, tx.Minimize(running=u**2), hessian=hessian, **ends).solve()
        for hessian in (None, GaussNewton(), QuasiNewton())
    )
    assert exact.solved
    assert found.cost == pytest.approx(exact.cost, rel=1e-6)
    assert updated.cost == pytest.approx(exact.cost, rel=1e-6)
    assert found.iterations <= exact.iterations + 2


@pytest.mark.parametrize("hessian", [GaussNewton(), QuasiNewton()])
def test_a_hessian_stays_with_its_problem(hessian: Any) -> None:
    stated = pendulum(hessian)
    known = stated.solve()
    copied = pickle.loads(pickle.dumps(stated)).solve()
    assert copied.cost == pytest.approx(known.cost, rel=1e-12)
    assert copied.iterations == known.iterations
    assert stated.solve(warm=known).iterations == 0
    assert stated.solve(refine=1e-5).problem.hessian == hessian
    assert stated.solve_many(initial={"angle": np.array([0.0, 0.1])})[0].cost == pytest.approx(known.cost, rel=1e-6)
