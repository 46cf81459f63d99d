"""Controllers: feedback is the solve from the measured state, plans move on by an interval, gains are derivatives."""

import copy
import functools
import pickle
import threading
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import HEUN, spinning_ball

import twistax as tx
from twistax.trajectory import Controller, Problem, Status

LENGTH = 0.25


@functools.cache
def regulator() -> Problem:
    """A mass is brought to rest near a reference with a limited force."""
    p, v, u = tx.State("p"), tx.State("v", min=-2.0), tx.Control("u", min=-0.8, max=0.8)
    reference, weight = tx.Parameter("reference", value=0.0), tx.Parameter("weight", value=0.1)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    away = p - reference
    cost = tx.Minimize(5.0 * (away * away + v * v), running=away * away + v * v + weight * u * u)
    return Problem(
        dynamics, cost, nodes=13, final_time=12 * LENGTH, initial={p: 1.0, v: 0.5}, by_node=[reference], **HEUN
    )


@functools.cache
def pointing() -> Problem:
    """A ball turns to the identity, where it must rest in two entries of its rate."""
    system = spinning_ball()
    R, w, u = *system.states, *system.controls
    cost = tx.Minimize(tx.linalg.Norm(w) ** 2 + 5.0 * (3.0 - tx.linalg.Trace(R)), running=u @ u)
    start = {R: tx.lie.so3.exp(np.array([0.3, -0.5, 0.4])), w: np.array([0.1, 0.2, -0.3])}
    final = {w: np.array([0.0, 0.0, np.nan])}
    return Problem(tx.compile(system), cost, nodes=9, final_time=2.0, initial=start, final=final, **HEUN)


def full(problem: Problem, tolerance: float = 1e-10, **options: Any) -> Controller:
    return problem.controller(max_iterations=100, tolerance=tolerance, **options)


def test_feedback_is_the_solve_from_the_measured_state() -> None:
    controller = full(regulator())
    for x in ({"p": 1.0, "v": 0.5}, {"p": 0.6, "v": 0.9}, {"p": -3.0, "v": 0.0}):
        u = controller.feedback(x)
        assert controller.status is Status.SOLVED
        assert np.isnan(controller.measures["excess"])  # it takes as long as an iteration
        expected = regulator().solve(initial=x, tolerance=1e-10)
        np.testing.assert_allclose(u["u"], expected.us["u"][0], atol=1e-6)
        np.testing.assert_allclose(controller.us["u"], expected.us["u"], atol=1e-5)
        np.testing.assert_allclose(controller.xs["v"], expected.xs["v"], atol=1e-5)
        np.testing.assert_allclose(controller.ts, expected.ts)
        assert controller.log[-1].cost == pytest.approx(expected.cost, rel=1e-6)


def test_feedback_on_a_manifold_is_the_solve_from_the_measured_state() -> None:
    controller = full(pointing())
    x = {"R": np.asarray(tx.lie.so3.exp(np.array([-0.4, 0.2, 0.9]))), "w": np.array([0.0, 0.5, 0.1])}
    u = controller.feedback(x)
    expected = pointing().solve(initial=x, tolerance=1e-10)
    assert controller.status is Status.SOLVED
    np.testing.assert_allclose(u["u"], expected.us["u"][0], atol=1e-6)
    np.testing.assert_allclose(controller.xs["R"], expected.xs["R"], atol=1e-6)


def test_what_is_prepared_counts_as_in_a_problem_with_it() -> None:
    x, reference = {"p": 1.0, "v": 0.0}, np.linspace(0.0, 2.0, 13)
    controller = full(regulator())
    controller.prepare({"reference": reference, "weight": 0.3})
    u = controller.feedback(x)
    expected = regulator().solve(initial=x, params={"reference": reference, "weight": 0.3}, tolerance=1e-10)
    np.testing.assert_allclose(u["u"], expected.us["u"][0], atol=1e-6)
    limits = np.full(12, 0.1)
    limits[6:] = 0.8
    controller.prepare({"reference": 0.0, "weight": 0.1}, limits={"u": (-limits, 0.8)})
    controller.feedback({"p": 1.0, "v": 0.5})
    np.testing.assert_allclose(controller.us["u"][:4], -0.1, atol=1e-5)
    assert controller.us["u"][6] < -0.2
    controller.prepare(limits={"u": (-0.8, 0.8)})
    controller.feedback({"p": 1.0, "v": 0.5})
    np.testing.assert_allclose(controller.us["u"], regulator().solve(tolerance=1e-10).us["u"], atol=1e-5)


def test_other_ends_count_as_in_a_problem_with_them() -> None:
    controller, final = full(pointing()), {"w": np.array([0.3, -0.2, np.nan])}
    controller.prepare(final=final)
    stated = pointing().stated["initial"]
    controller.feedback(stated)
    expected = pointing().solve(final=final, tolerance=1e-10)
    np.testing.assert_allclose(controller.us["u"], expected.us["u"], atol=1e-5)
    np.testing.assert_allclose(controller.xs["w"][-1][:2], [0.3, -0.2], atol=1e-7)


@pytest.mark.parametrize("problem", [regulator, pointing])
def test_a_shifted_plan_is_the_plan_one_interval_later(problem: Any) -> None:
    controller = full(problem())
    xs, us = controller.xs, controller.us
    controller.shift()
    for name, values in xs.items():
        np.testing.assert_array_equal(controller.xs[name][:-1], values[1:])
    np.testing.assert_array_equal(controller.us["u"], np.concatenate([us["u"][1:], us["u"][-1:]]))
    last = {name: values[-1] for name, values in xs.items()}
    flown = tx.integrate(
        problem().dynamics,
        last,
        t1=LENGTH,
        dt=LENGTH,
        u={"u": us["u"][-1]},
        method=tx.RKMK(tx.tableaus.HEUN),
    )
    for name, values in flown.xs.items():  # of a turn the method of the integrator truncates more
        np.testing.assert_allclose(controller.xs[name][-1], values[-1], atol=1e-5 if name == "R" else 1e-13)
        assert np.abs(values[-1] - last[name]).max() > 1e-3


def test_multipliers_move_on_with_the_plan() -> None:
    """From the shifted plan, at the state that it starts from, hardly anything is left to do."""
    controller = full(regulator())
    controller.feedback({"p": 1.0, "v": 0.5})
    first = {name: values[1] for name, values in controller.xs.items()}
    controller.shift()
    controller.feedback(first)
    cold = full(regulator())
    cold.feedback(first)
    assert controller.log[-1].iterations < cold.log[-1].iterations


def test_multipliers_of_the_dynamics_move_on() -> None:
    """A call without time for a step measures the plan as it is; a long horizon hardly changes by an interval."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    of_mesh: dict[str, Any] = {"nodes": 61, "final_time": 15.0, "initial": {p: 1.0, v: 0.5}}
    problem = Problem(dynamics, tx.Minimize(running=p * p + v * v + u * u), **of_mesh, **HEUN)
    controller = problem.controller(problem.solve(tolerance=1e-10), max_seconds=1e-9)
    first = {name: values[1] for name, values in controller.xs.items()}
    controller.shift()
    controller.feedback(first)
    assert controller.measures["iterations"] == 0
    assert controller.log[-1].error < 1e-4


@pytest.mark.parametrize("problem", [regulator, pointing])
def test_gains_are_derivatives_of_the_first_control(problem: Any) -> None:
    controller, step = full(problem(), tolerance=1e-11), 1e-4
    x = dict(problem().solve().xs)
    start = {name: values[0] for name, values in x.items()}
    if problem is regulator:
        start = {"p": 0.2, "v": 0.1}  # no limit is active at the first control
    controller.feedback(start)
    gains = controller.gains["u"].reshape(-1, controller.gains["u"].shape[-1])
    group = problem().dynamics.group
    for k, direction in enumerate(np.eye(gains.shape[1])):
        sides = []
        for sign in (1.0, -1.0):
            moved = group.retract(start, sign * step * direction)
            sides.append(np.ravel(controller.feedback({name: np.asarray(a) for name, a in moved.items()})["u"]))
        np.testing.assert_allclose(gains[:, k], (sides[0] - sides[1]) / (2.0 * step), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_control_at_its_limit_has_no_gain(sign: float) -> None:
    controller = full(regulator(), tolerance=1e-11)
    assert controller.feedback({"p": sign, "v": 0.5 * sign})["u"] == pytest.approx(-0.8 * sign, abs=1e-6)
    np.testing.assert_allclose(controller.gains["u"], 0.0, atol=1e-4)


def test_correct_follows_the_gains_within_limits() -> None:
    controller = full(regulator())
    u = controller.feedback({"p": 0.2, "v": 0.1})["u"]
    near = controller.correct({"p": 0.21, "v": 0.08})["u"]
    assert near == pytest.approx(u + controller.gains["u"] @ np.array([0.01, -0.02]))
    assert controller.correct({"p": 9.0, "v": 0.1})["u"] == -0.8


def test_time_that_runs_out_leaves_the_best_iterate() -> None:
    controller = full(regulator(), max_seconds=1e-9)
    u = controller.feedback({"p": -3.0, "v": 0.0})
    assert controller.status is Status.OUT_OF_TIME
    assert controller.log[-1].iterations == 0
    assert np.isfinite(u["u"])
    assert controller.measures["error"] > 0.0


def test_a_plan_outlives_a_solve_that_is_not_finite() -> None:
    p, u = tx.State("p"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: u + 0.1 * tx.Log(p)}))
    problem = Problem(
        dynamics, tx.Minimize(running=(p - 1.0) ** 2 + u * u), nodes=6, final_time=1.0, initial={p: 2.0}, **HEUN
    )
    controller = problem.controller()
    before = controller.feedback({p: 2.0})
    assert controller.feedback({p: -1.0}) == before
    assert controller.status is Status.NON_FINITE
    assert controller.feedback({p: 2.0})["u"] == pytest.approx(before["u"], abs=1e-3)
    assert controller.status in (Status.SOLVED, Status.MAX_ITERATIONS)


def test_two_iterations_control_nearly_as_well_as_full_solves() -> None:
    costs = []
    for iterations in (2, 100):
        controller, rng = regulator().controller(max_iterations=iterations), np.random.default_rng(0)
        x, cost = np.array([1.0, 0.5]), 0.0
        for k in range(40):
            x = x + (k % 10 == 0) * rng.normal(size=2)
            u = controller.feedback({"p": x[0], "v": x[1]})["u"]
            cost += x @ x + 0.1 * u * u
            x = x + LENGTH * np.array([x[1] + 0.5 * LENGTH * u, u])
            controller.shift()
        costs.append(cost)
        assert len(controller.log) == 40
        assert controller.log.iterations.max() <= iterations
    assert costs[0] == pytest.approx(costs[1], rel=0.1)


def test_controllers_run_in_threads() -> None:
    starts = [{"p": 0.3 * k, "v": -0.1 * k} for k in range(8)]
    alone = full(regulator())
    expected = [float(alone.feedback(x)["u"]) for x in starts]
    results: dict[int, list[float]] = {}

    def run(number: int, controller: Controller) -> None:
        results[number] = [float(controller.feedback(x)["u"]) for x in starts]

    threads = [threading.Thread(target=run, args=(k, full(regulator()))) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for values in results.values():
        np.testing.assert_allclose(values, expected, atol=1e-9)
    assert len(results) == 3


def test_the_log_says_what_happened_and_draws_it() -> None:
    controller = regulator().controller(log=3)
    assert repr(controller.log) == "ControllerLog(no calls)"
    with pytest.raises(tx.TrajectoryError, match="has not been called"):
        controller.log.plot()
    for k in range(8):
        controller.feedback({"p": 0.1 * k, "v": 0.0})
    log = controller.log
    assert len(log) == len(log.statuses) == len(log.seconds) == 3
    assert (log.seconds > 0.0).all()
    assert (log.violations < 1e-3).all()
    assert np.isfinite(log.costs).all()
    assert log.errors[-1] == log[-1].error
    pytest.importorskip("matplotlib")
    assert len(log.plot().axes) == 4


def test_what_does_not_fit_is_refused() -> None:
    controller = regulator().controller()
    x = {"p": 0.0, "v": 0.0}
    for wrong, match in (
        ({"p": 0.0}, "a value for every state: 'p', 'v'; got 'p', without 'v'"),
        ({"p": 0.0, "w": 0.0}, "unknown state 'w'"),
        ({"p": np.nan, "v": 0.0}, r"x\['p'\] expects finite numbers"),
        ({"p": np.zeros(2), "v": 0.0}, r"x\['p'\] expects shape \(\)"),
    ):
        with pytest.raises(tx.TwistaxError, match=match):
            controller.feedback(wrong)
    for wrong, match in (
        ({"limits": {"w": (0.0, 1.0)}}, "the controls are: 'u'"),
        ({"limits": {"u": (1.0, 0.0)}}, "low <= high"),
        ({"limits": {"u": 1.0}}, r"expects \(low, high\)"),
        ({"limits": {"u": (np.zeros(3), 1.0)}}, "expects shape"),
        ({"params": {"weigt": 1.0}}, "unknown key 'weigt'"),
        ({"params": {"weight": np.zeros(2)}}, "expects shape"),
        ({"params": {"weight": np.inf}}, "finite numbers"),
    ):
        with pytest.raises(tx.TwistaxError, match=match):
            controller.prepare(**wrong)
    with pytest.raises(tx.InputError, match="not an element of SO3"):
        pointing().controller().feedback({"R": 2.0 * np.eye(3), "w": np.zeros(3)})
    assert np.isfinite(controller.feedback(x)["u"])


def test_problems_without_a_measured_start_are_refused() -> None:
    p, u = tx.State("p"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={p: u}))
    of_all: dict[str, Any] = {"nodes": 4, "final_time": 1.0, **HEUN}
    cost = tx.Minimize(running=u * u)
    for options, match in (
        ({"initial": {p: np.nan}}, "initial value of 'p' is free"),
        ({"initial": {p: 0.0, u: 0.0}, "controls": tx.trajectory.Linear()}, "initial value of the control 'u'"),
        ({"initial": {p: 0.0}, "hessian": tx.trajectory.QuasiNewton()}, "QuasiNewton"),
    ):
        with pytest.raises(tx.TrajectoryError, match=match):
            Problem(dynamics, cost, **of_all, **options).controller()
    uneven = Problem(dynamics, cost, **{**of_all, "nodes": [0.0, 0.2, 1.0]}, initial={p: 0.0}).controller()
    with pytest.raises(tx.TrajectoryError, match="intervals have different lengths"):
        uneven.shift()


def planar(start: Any) -> Problem:
    """A quadrotor in a plane comes to the origin past an obstacle, planned from a start."""
    q, w, r = tx.State("q", (3,)), tx.State("w", (3,)), tx.Control("r", (2,), min=0.0, max=12.0)
    lift, effort = r[0] + r[1], r - 4.905
    rates = {q: w, w: tx.Concat(-lift * tx.Sin(q[2]) - 0.1 * w[0], lift * tx.Cos(q[2]) - 9.81, 20.0 * (r[0] - r[1]))}
    near = 20.0 * tx.Exp(10.0 * (0.6 - tx.linalg.Norm(q[:2] - np.array([-1.2, -0.25]))))
    away = q[:2] @ q[:2]
    cost = tx.Minimize(5.0 * away + w @ w + q[2] ** 2, running=away + 0.2 * (w @ w + effort @ effort) + near)
    mesh: Any = {"nodes": 16, "final_time": 1.5, "substeps": 1}
    return Problem(tx.compile(tx.System(rates=rates)), cost, initial={q: start, w: np.zeros(3)}, **mesh)


@functools.cache
def plane_flight() -> Any:
    x = {"q": np.array([-3.0, 0.05, 0.0]), "w": np.zeros(3)}
    (part,) = planar(x["q"]).parts
    return tx.simulator(part.phase.dynamics, x, t1=0.1, dt=0.05, u={"r": np.full(2, 4.905)})


def flown(controller: Controller) -> float:
    """How far from the origin the loop is after 4 s."""
    x = {"q": np.array([-3.0, 0.05, 0.0]), "w": np.zeros(3)}
    for _ in range(40):
        u = controller.feedback(x)
        x = {name: np.asarray(values[-1]) for name, values in plane_flight()(x, u=u).xs.items()}
        controller.shift()
    return float(np.linalg.norm(x["q"][:2]))


def test_a_first_plan_at_rest_does_not_mislead() -> None:
    """Its units are those of numerical noise; with them the loop is lost, 6 m away."""
    assert flown(planar(np.zeros(3)).controller(max_iterations=2)) < 0.1


@pytest.mark.parametrize("value", ["fast", 1.0j, None, [1.0, 2.0], np.nan, np.inf])
def test_a_measured_state_that_is_no_number_is_refused(value: Any) -> None:
    controller = full(regulator())
    expected = controller.feedback({"p": 0.5, "v": 0.0})["u"]
    with pytest.raises(tx.InputError if value != [1.0, 2.0] else tx.ShapeError, match=r"x\['v'\] expects"):
        controller.feedback({"p": 0.0, "v": value})
    assert controller.feedback({"p": 0.5, "v": 0.0})["u"] == pytest.approx(expected)


def test_a_failed_solve_leaves_the_plan() -> None:
    controller = full(regulator())
    u = controller.feedback({"p": 0.5, "v": 0.0})["u"]
    plan = controller.xs
    assert controller.feedback({"p": 1e200, "v": 0.0})["u"] == u
    assert controller.status is Status.NON_FINITE
    for name, values in plan.items():
        np.testing.assert_array_equal(controller.xs[name], values)


def test_calls_inside_of_a_program_are_those_outside() -> None:
    """A closed loop in `lax.scan`: measured states, changed parameters, shifts and gains in their order."""
    weights = np.array([0.1, 0.3, 0.2, 0.2])

    def step(controller: Controller, x: Any, weight: Any) -> tuple[Any, Any]:
        controller.prepare({"weight": weight})
        u = controller.feedback(x)
        corrected = controller.correct({"p": x["p"] + 0.01, "v": x["v"]})
        controller.shift()
        after = {"p": x["p"] + LENGTH * x["v"], "v": x["v"] + LENGTH * u["u"]}
        return after, (u["u"], corrected["u"], controller.gains["u"])

    outside, inside, x, rows = full(regulator()), full(regulator()), {"p": 1.0, "v": 0.5}, []
    for weight in weights:
        x, row = step(outside, x, weight)
        rows.append(row)
    run = jax.jit(lambda x: jax.lax.scan(functools.partial(step, inside), x, weights))
    end, columns = run({"p": jnp.array(1.0), "v": jnp.array(0.5)})
    for column, expected in zip(columns, zip(*rows, strict=True), strict=True):
        np.testing.assert_allclose(column, np.stack(expected), atol=1e-12)
    assert len(inside.log) == len(outside.log) == 4
    run(end)
    assert len(inside.log) == 8
    assert repr(inside).startswith("Controller(13 nodes, ControllerLog(8 calls: 8 SOLVED")
    with pytest.raises(tx.InputError, match="a value for every state: 'p', 'v'"):
        jax.jit(lambda p: inside.feedback({"p": p}))(1.0)
    with pytest.raises(tx.ShapeError, match=r"x\['p'\] expects shape \(\), got \(2,\)"):
        jax.jit(lambda p: inside.feedback({"p": p, "v": 0.0}))(jnp.ones(2))


@pytest.mark.parametrize("copied", [lambda c: pickle.loads(pickle.dumps(c)), copy.deepcopy], ids=["pickle", "deepcopy"])
def test_a_copy_continues_from_the_same_plan(copied: Any) -> None:
    controller = regulator().controller(max_iterations=3)
    controller.prepare({"reference": 0.3, "weight": 0.2}, limits={"u": (-0.7, 0.6)})
    controller.feedback({"p": 40.0, "v": 0.2})  # far away: the units are measured again
    controller.shift()
    again = copied(controller)
    assert len(again.log) == 1
    assert again.status is controller.status
    for x in ({"p": 0.9, "v": 0.1}, {"p": 0.8, "v": 0.0}):
        np.testing.assert_array_equal(again.feedback(x)["u"], controller.feedback(x)["u"])
        np.testing.assert_array_equal(again.gains["u"], controller.gains["u"])
        again.shift(), controller.shift()
    controller.prepare({"weight": 1.0})
    assert float(again.params["weight"]) == 0.2
