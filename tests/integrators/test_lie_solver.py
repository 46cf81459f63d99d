"""Lie-group steps inside diffrax: orders, groups, agreement with `tx.integrate`."""

from typing import Any

import diffrax
import jax
import numpy as np
import optimistix
import pytest
from integrator_bodies import start as body_start
from lie_solver_cases import apart, defect, halves, last, reference, references, solve, starts

import twistax as tx

NEWTON = optimistix.Newton(rtol=1e-9, atol=1e-12)
SPLIT = diffrax.MultiTerm(*(tx.diffrax.lie_term(half) for half in halves()))


def observed_order(solver: Any, fewest: int, **rest: Any) -> float:
    """The slope of log error over log step, the error being the root of its mean square over four starts."""
    run = jax.jit(jax.vmap(lambda x, dt: last(solve(solver, 1.0, dt, x, **rest)), in_axes=(0, None)))
    counts = (np.array([1.0, 1.4, 2.0]) * fewest).astype(int)
    wanted, errors = references(1.0, 4), []
    for count in counts:
        found = run(starts(4), np.asarray(1.0 / count))
        off = [np.ravel(np.asarray(found[name]) - wanted[name]) for name in wanted]
        errors.append(np.sqrt(np.mean(np.concatenate(off) ** 2)))
    assert min(errors) > 1e-12
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


@pytest.mark.parametrize(
    ("solver", "order", "steps"),
    [
        (diffrax.Euler(), 1, 200),
        (diffrax.Ralston(), 2, 40),
        (diffrax.Tsit5(), 5, 40),
        (diffrax.Dopri8(), 8, 8),
        pytest.param(diffrax.Heun(), 2, 40, marks=pytest.mark.slow),
        pytest.param(diffrax.Midpoint(), 2, 40, marks=pytest.mark.slow),
        pytest.param(diffrax.Bosh3(), 3, 60, marks=pytest.mark.slow),
        pytest.param(diffrax.Dopri5(), 5, 40, marks=pytest.mark.slow),
        pytest.param(diffrax.HalfSolver(diffrax.Heun()), 2, 20, marks=pytest.mark.slow),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, int) else "",
)
def test_explicit_solvers_keep_their_order(solver: Any, order: int, steps: int) -> None:
    assert observed_order(solver, steps) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize(
    ("kind", "order", "steps"),
    [
        (diffrax.Kvaerno3, 3, 20),
        pytest.param(diffrax.Kvaerno4, 4, 16, marks=pytest.mark.slow),
        pytest.param(diffrax.Kvaerno5, 5, 10, marks=pytest.mark.slow),
        pytest.param(diffrax.ImplicitEuler, 1, 100, marks=pytest.mark.slow),
    ],
)
def test_implicit_solvers_keep_their_order(kind: Any, order: int, steps: int) -> None:
    assert observed_order(kind(root_finder=NEWTON), steps) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize(
    ("kind", "order", "steps"),
    [
        pytest.param(diffrax.KenCarp3, 3, 20, marks=pytest.mark.slow),
        pytest.param(diffrax.KenCarp4, 4, 16, marks=pytest.mark.slow),
        pytest.param(diffrax.KenCarp5, 5, 10, marks=pytest.mark.slow),
    ],
)
def test_two_parts_one_implicit(kind: Any, order: int, steps: int) -> None:
    assert observed_order(kind(root_finder=NEWTON), steps, terms=SPLIT) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize(
    "chart",
    [
        None,
        tx.charts.SplitExponential(),
        pytest.param(tx.charts.Exponential(), marks=pytest.mark.slow),
        pytest.param(tx.charts.Ambient(), marks=pytest.mark.slow),
    ],
)
def test_the_steps_are_those_of_integrate(chart: Any) -> None:
    """The same tableau in the same chart, a pose, a table as control and a parameter: equal up to round-off."""
    dynamics = tx.compile(pushed())
    u = {"F": tx.FirstOrderHold([0.0, 0.2, 0.5], np.random.default_rng(1).normal(size=(3, 6)))}
    params = {"m": 1.7}
    solver = tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics, chart)
    sol = diffrax.diffeqsolve(
        tx.diffrax.lie_term(dynamics),
        solver,
        0.0,
        0.5,
        0.1,
        body_start(),
        args=(u, params),
        saveat=diffrax.SaveAt(steps=True),
    )
    method = tx.RKMK(tx.tableaus.TSIT5, chart)
    ts = np.linspace(0.1, 0.5, 5)
    wanted = tx.integrate(dynamics, body_start(), t1=0.5, dt=0.1, u=u, params=params, method=method, save_at=ts)
    np.testing.assert_allclose(sol.ts[:5], ts, atol=1e-15)
    assert apart(jax.tree.map(lambda a: a[:5], sol.ys), wanted.xs) < 1e-13


def pushed() -> tx.System:
    """A body under a wrench that is an input, its mass a parameter."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, m = tx.Control("F", shape=(6,)), tx.Parameter("m", value=2.0)
    inertia = tx.Concat(m, m, m, 1.0, 2.0, 3.0)
    weight = tx.lie.wrench(force=g[:3, :3].T @ np.array([0.0, 0.0, -9.81]), torque=np.array([0.1, 0.0, 0.0]))
    return tx.System(rates={g: V, V: (F + weight - tx.lie.AdjointDual(V, inertia * V)) / inertia})


def tumbling(order: tx.Order) -> tx.System:
    """A free body, its centre of mass at the origin."""
    g, V = tx.State("g", group=tx.SE3, order=order), tx.State("V", shape=(6,))
    inertia = np.array([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    inertia = inertia if order == tx.LINEAR_FIRST else np.roll(inertia, 3)
    return tx.System(rates={g: V, V: -tx.lie.AdjointDual(V, inertia * V, order=order) / inertia})


@pytest.mark.slow
def test_chosen_steps_are_nearly_those_of_integrate_in_either_order() -> None:
    """Nearly: diffrax never shortens a step right after one that was kept. The order does not matter at all."""
    steps = []
    for order in (tx.LINEAR_FIRST, tx.ANGULAR_FIRST):
        dynamics = tx.compile(tumbling(order))
        x = body_start()
        if order == tx.ANGULAR_FIRST:
            x["V"] = np.roll(x["V"], 3)
        atol = {"g": (1e-9, 1e-7), "V": 1e-8}
        sol = diffrax.diffeqsolve(
            tx.diffrax.lie_term(dynamics),
            tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics),
            0.0,
            2.0,
            None,
            x,
            stepsize_controller=tx.diffrax.controller(1e-9, atol),
        )
        own = tx.integrate(dynamics, x, t1=2.0, rtol=1e-9, atol=atol, method=tx.RKMK(tx.tableaus.TSIT5))
        steps += [int(sol.stats["num_accepted_steps"]), own.stats.accepted]
        assert apart(last(sol), {name: value[-1] for name, value in own.xs.items()}) < 1e-6
    lie, own = steps[::2], steps[1::2]
    assert lie[0] == lie[1]
    assert 0.85 < lie[0] / own[0] < 1.15, steps


def test_rotations_stay_in_their_group() -> None:
    sol = solve(diffrax.Tsit5(), 40.0, 0.02, saveat=diffrax.SaveAt(ts=np.linspace(0.0, 40.0, 7)))
    assert int(sol.stats["num_steps"]) == 2000
    assert defect(sol.ys["R"][1:]) < 2e-15


@pytest.mark.slow
def test_a_plain_controller_works_too() -> None:
    control = diffrax.PIDController(rtol=1e-8, atol=1e-8)
    sol = solve(diffrax.Tsit5(), 1.0, 0.01, stepsize_controller=control)
    assert apart(last(sol), reference(1.0)) < 1e-6


def test_a_step_that_turns_too_far_is_taken_back() -> None:
    """With ten seconds to try, the first step turns by many turns; constant steps come out as not a number."""
    sol = solve(diffrax.Tsit5(), 10.0, 10.0, stepsize_controller=tx.diffrax.controller(1e-8))
    assert int(sol.stats["num_rejected_steps"]) > 0
    assert apart(last(sol), reference(10.0)) < 1e-4


@pytest.mark.slow
def test_stiff_damping_takes_few_steps() -> None:
    """Rates of 1e5: an explicit solver would need 3e4 steps a second."""
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
    t = tx.Time()
    wanted = tx.Concat(tx.Cos(t), 0.5, tx.Sin(2.0 * t)) + R[0, :]
    dynamics = tx.compile(tx.System(rates={R: w, w: 1e5 * (wanted - w)}))
    x = {"R": np.eye(3), "w": np.array([2.0, 0.5, 0.0])}
    sol = diffrax.diffeqsolve(
        tx.diffrax.lie_term(dynamics),
        tx.diffrax.LieSolver(diffrax.Kvaerno5(), dynamics),
        0.0,
        1.0,
        None,
        x,
        stepsize_controller=tx.diffrax.controller(1e-4),
    )
    # The slow motion, to first order in 1e-5: w follows what is wanted, late by 1e-5 s.
    slow = tx.compile(tx.System(rates={R: tx.Concat(tx.Cos(t), 0.5, tx.Sin(2.0 * t)) + R[0, :]}))
    near = tx.integrate(slow, {"R": np.eye(3)}, t1=1.0, rtol=1e-10).xs["R"][-1]
    assert int(sol.stats["num_steps"]) < 300
    assert apart({"R": sol.ys["R"][-1]}, {"R": near}) < 1e-3
