"""SOLVED means an optimum, whatever the units, the limits and what the objective is counted from."""

import functools
import logging
from typing import Any

import jax
import numpy as np
import pytest
from trajectory_systems import EULER, HEUN

import twistax as tx
from twistax.trajectory import Problem, Status, TrajectoryResult


@functools.cache
def fastest(limit: float) -> Problem:
    """Least time (and a constant) of mass p'' = u, |u| <= limit, over as far as the limit: T = 2 s."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-limit, max=limit)
    mass, since = tx.Parameter("mass", value=1.0), tx.Parameter("since", value=0.0)
    return Problem(
        tx.compile(tx.System(rates={p: v, v: u / mass})),
        tx.Minimize(tx.Time() + since),
        nodes=21,
        final_time=(0.5, 6.0),
        initial={p: 0.0, v: 0.0},
        final={p: limit, v: 0.0},
        **HEUN,
    )


@pytest.mark.parametrize("limit", [1e-6, 1.0, pytest.param(1e6, marks=pytest.mark.slow)])
def test_units_do_not_matter(limit: float) -> None:
    seen: list[tuple[int, float, float]] = []
    result = fastest(limit).solve(callback=lambda *state: seen.append(state))
    assert result.status is Status.SOLVED
    assert result.final_time == pytest.approx(2.0, rel=1e-5)
    np.testing.assert_allclose(result.us["u"] / limit, np.repeat([1.0, -1.0], 10), atol=1e-3)
    assert result.cost == pytest.approx(result.final_time)
    assert result.violation <= 1e-6
    assert seen[-1][0] <= result.iterations
    assert seen[-1][1] == pytest.approx(result.cost, abs=1e-2)


@pytest.mark.parametrize("limits", [(0.5, 3.0), (0.5, 2000.0)])
def test_limits_of_the_final_time_do_not_matter(limits: tuple[float, float]) -> None:
    result = fastest(1.0).solve(final_time=limits)
    assert result.status is Status.SOLVED
    assert result.final_time == pytest.approx(2.0, rel=1e-5)


def test_perturbed_starts_do_not_run_off_with_wide_limits() -> None:
    """The first cost is the final time of the start."""

    def begun(latest: float, seed: int) -> float:
        seen: list[float] = []
        watch = lambda count, cost, violation: seen.append(cost)  # noqa: E731
        fastest(1.0).solve(final_time=(0.1, latest), final_time_guess=2.0, seed=seed, callback=watch, max_iterations=1)
        return seen[0]

    times = [begun(1e6, seed) for seed in range(4)]
    assert times == pytest.approx([begun(1e2, seed) for seed in range(4)])
    assert min(times) < 2.0 < max(times) < 5.0


def test_a_constant_in_the_objective_does_not_matter() -> None:
    plain, moved = fastest(1.0).solve(), fastest(1.0).solve(params={"since": 1000.0})
    assert moved.status is Status.SOLVED
    assert moved.cost - 1000.0 == pytest.approx(plain.cost, abs=1e-5)
    np.testing.assert_allclose(moved.us["u"], plain.us["u"], atol=1e-4)
    np.testing.assert_allclose(moved.xs["p"], plain.xs["p"], atol=1e-4)


def test_other_cases_do_not_compile_again(caplog: pytest.LogCaptureFixture) -> None:
    """From rest to rest over a distance D with |u| <= 1 it takes 2 sqrt(mass D)."""
    problem = fastest(1.0)
    assert problem.solve().solved
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        result = problem.solve(
            initial={"p": -1.0}, final={"p": 3.0}, final_time=(1.0, 9.0), params={"mass": 2.25}, final_time_guess=5.0
        )
    assert [record.getMessage() for record in caplog.records if record.getMessage().startswith("Compiling")] == []
    assert result.solved
    assert result.final_time == pytest.approx(6.0, rel=1e-5)
    assert result.xs["p"][0] == -1.0
    assert result.xs["p"][-1] == pytest.approx(3.0, abs=1e-5)
    assert problem.solve().final_time == pytest.approx(2.0, rel=1e-5)


OTHERS: list[tuple[dict[str, Any], str]] = [
    ({"initial": {"p": np.nan}}, r"initial\['p'\] must fix the entries that the problem fixes"),
    ({"final": {"v": np.nan}}, r"final\['v'\] must fix the entries that the problem fixes"),
    ({"final_time": 3.0}, "final_time expects limits .low, high., because it is free"),
]


@pytest.mark.parametrize(("case", "text"), OTHERS, ids=["initial", "final", "time"])
def test_what_needs_another_problem_is_refused(case: dict[str, Any], text: str) -> None:
    with pytest.raises(tx.TrajectoryError, match=text):
        fastest(1.0).solve(**case)


# ---- the first-order conditions ----------------------------------------------------------------------------------

INTERVALS, LENGTH, MOST = 10, 0.2, 1.2


def test_a_weight_that_the_objective_alone_reads_is_set() -> None:
    """x' = u from 0, at least u^2 + weight (x - 1)^2 at the end of 1 s: x ends at weight / (1 + weight)."""
    x, u, weight = tx.State("x"), tx.Control("u"), tx.Parameter("weight", value=1.0)
    dynamics = tx.compile(tx.System(rates={x: u}))
    objective = tx.Minimize(weight * (x - 1.0) ** 2, running=u**2)
    problem = Problem(dynamics, objective, nodes=4, final_time=1.0, initial={x: 0.0}, **EULER)
    for value in (1.0, 3.0):
        result = problem.solve(params={"weight": value})
        assert result.solved
        assert result.xs["x"][-1] == pytest.approx(value / (1.0 + value), rel=1e-6)
        assert result.replay(steps=2).misses["x"]["distance"] < 1e-9
    with pytest.raises(tx.ShapeError, match="weight"):
        problem.solve(params={"weight": [1.0, 2.0]})


@functools.cache
def least_energy() -> TrajectoryResult:
    """The integral of u^2, rest to rest over 1 in 2 s; without the limit the controls would reach 1.35."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", max=MOST)
    return Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(running=u**2),
        nodes=INTERVALS + 1,
        final_time=INTERVALS * LENGTH,
        initial={p: 0.0, v: 0.0},
        final={p: 1.0, v: 0.0},
        **HEUN,
    ).solve(tolerance=1e-8)


def test_the_first_order_conditions_hold() -> None:
    """Of sum h u_k^2 under p_(k+1) = p_k + h v_k + h^2 u_k / 2 and v_(k+1) = v_k + h u_k; it is convex."""
    result = least_energy()
    h, u, p, v = LENGTH, result.us["u"], result.xs["p"], result.xs["v"]
    assert result.status is Status.SOLVED
    np.testing.assert_allclose(p[1:], p[:-1] + h * v[:-1] + h**2 / 2.0 * u, atol=1e-7)
    np.testing.assert_allclose(v[1:], v[:-1] + h * u, atol=1e-7)
    np.testing.assert_allclose([p[0], v[0], p[-1], v[-1]], [0.0, 0.0, 1.0, 0.0], atol=1e-7)
    assert u.max() <= MOST + 1e-7

    y_p, y_v = (result.multipliers[f"dynamics of {name}"][:, 0] for name in "pv")
    limit = result.multipliers[f"u <= {MOST:g}"]
    np.testing.assert_allclose(2.0 * h * u + h**2 / 2.0 * y_p + h * y_v + limit, 0.0, atol=1e-6)
    np.testing.assert_allclose(y_p[1:], y_p[:-1], atol=1e-6)
    np.testing.assert_allclose(y_v[1:] + h * y_p[1:], y_v[:-1], atol=1e-6)
    np.testing.assert_allclose(result.multipliers["final p"], y_p[-1:], atol=1e-6)
    np.testing.assert_allclose(result.multipliers["final v"], y_v[-1:], atol=1e-6)
    assert limit.min() >= 0.0
    np.testing.assert_allclose(limit * (MOST - u), 0.0, atol=1e-6)
    assert (limit > 1e-2).sum() in range(1, INTERVALS - 1)


def test_an_explanation_names_what_is_active() -> None:
    result = least_energy()
    lines = result.explain().splitlines()
    assert lines[0] == result.message
    (active,) = (line for line in lines if line.startswith("active, by multiplier: "))
    assert f"u <= {MOST:g} ({result.multipliers[f'u <= {MOST:g}'].max():.3g})" in active
    assert any(line.startswith("limits exceeded by that rollout") for line in lines)


def test_a_start_where_a_constraint_has_no_slope_is_left() -> None:
    """x.x >= 1.1 from x = 0 with free ends: staying anywhere outside costs nothing."""
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,))
    dynamics = tx.compile(tx.System(rates={x: u}, constraints={"outside": x @ x >= 1.1}))
    problem = Problem(dynamics, tx.Minimize(running=u @ u), nodes=6, final_time=1.0, **EULER)
    result = problem.solve(guess={"x": np.zeros(2)})
    assert result.status is Status.SOLVED
    assert result.cost < 1e-8
    assert (result.xs["x"] ** 2).sum(axis=1).min() >= 1.1 - 1e-5


# ---- between the nodes -------------------------------------------------------------------------------------------


def test_what_a_coarse_mesh_misses_is_told() -> None:
    """An oscillator p'' = u - 4 p, whose held motion is known, swung against a wall in long steps."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
    result = Problem(
        tx.compile(tx.System(rates={p: v, v: u - 4.0 * p}, constraints={"wall": p <= 0.25})),
        tx.Minimize(running=u**2),
        nodes=6,
        substeps=1,
        final_time=2.5,
        initial={p: 0.0, v: 1.0},
        final={p: 0.0, v: -1.0},
    ).solve()
    state, ts, highest = np.array([0.0, 1.0]), np.linspace(0.0, 0.5, 21), 0.0
    for held in result.us["u"]:
        # Of x = p - u / 4 and v: x cos 2t + v / 2 sin 2t, and its slope.
        shift, rate = state[0] - held / 4.0, state[1] / 2.0
        ps = held / 4.0 + shift * np.cos(2.0 * ts) + rate * np.sin(2.0 * ts)
        state = np.array([ps[-1], 2.0 * (rate * np.cos(1.0) - shift * np.sin(1.0))])
        highest = max(highest, float(ps.max()))
    assert result.violations["wall"] < 1e-6
    assert highest > 0.25 + 1e-3
    assert result.between_nodes["wall"] == pytest.approx(highest - 0.25, abs=1e-6)
    p0, v0, held = result.xs["p"][:-1], result.xs["v"][:-1], result.us["u"]
    shift, cos, sin = p0 - held / 4.0, np.cos(1.0), np.sin(1.0)
    ends = np.stack([held / 4.0 + shift * cos + v0 / 2.0 * sin, v0 * cos - 2.0 * shift * sin], axis=1)
    gaps = np.abs(ends - np.stack([result.xs["p"], result.xs["v"]], axis=1)[1:]) / result.warm.scales.d[1:]
    stage = int(gaps.max(axis=1).argmax())
    (told,) = (line for line in result.explain().splitlines() if line.startswith("largest mesh error"))
    assert f"{gaps.max():.1e} between nodes {stage} and {stage + 1}" in told
    assert ("solve(refine=1e-4)" in told) == (gaps.max() > 1e-2)
    assert result.status is (Status.COARSE if gaps.max() > 1e-2 else Status.SOLVED)
    missed = {"p": abs(state[0] - result.xs["p"][-1]), "v": abs(state[1] - result.xs["v"][-1])}
    assert min(missed.values()) > 1e-4
    for name, distance in missed.items():
        assert result.mesh_error[name]["distance"] == pytest.approx(distance, rel=1e-2)
    assert "wall by" in result.explain()


def test_a_limit_that_reads_the_time_counts_at_a_free_end() -> None:
    x, u = tx.State("x"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={x: u}, constraints={"deadline": tx.Time() <= 2.0}))
    ends: dict[str, Any] = {"initial": {x: 0.0}, "final": {x: 0.1}}
    problem = Problem(dynamics, tx.Maximize(tx.Time()), nodes=3, final_time=(0.5, 6.0), **ends, **EULER)
    result = problem.solve(final_time_guess=1.0)
    assert result.solved
    assert result.final_time == pytest.approx(2.0, rel=1e-5)


def test_an_objective_without_slope_at_the_guess_has_its_own_scale() -> None:
    """Any weight of a cost gives the same controls, also where its slope at the guess is zero."""
    p, v, u, weight = tx.State("p"), tx.State("v"), tx.Control("u"), tx.Parameter("weight", value=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
    problem = Problem(dynamics, tx.Minimize(running=weight * u**4), nodes=7, final_time=4.0, **ends, **HEUN)
    plain, light = problem.solve(), problem.solve(params={"weight": 1e-20})
    assert plain.solved
    assert light.solved
    np.testing.assert_allclose(light.us["u"], plain.us["u"], atol=1e-4)


def test_ends_that_break_a_small_limit_are_said() -> None:
    x, u = tx.State("x"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: u}, constraints={"wall": x <= 1e-7}))
    ends: dict[str, Any] = {"initial": {x: 0.0}, "final": {x: 2e-7}}
    result = Problem(dynamics, tx.Minimize(running=u**2), nodes=3, final_time=1.0, **ends, **EULER).solve()
    assert result.status is Status.INFEASIBLE
    assert "'wall' at node 2" in result.message


def test_a_norm_may_stand_twice_in_a_cost() -> None:
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,))
    norm = tx.linalg.Norm(u)
    dynamics = tx.compile(tx.System(rates={x: u}))
    ends: dict[str, Any] = {"initial": {x: [0.0, 0.0]}, "final": {x: [3.0, 4.0]}}
    cost = tx.Minimize(running=norm + 2.0 * tx.linalg.Norm(u))
    problem = Problem(dynamics, cost, nodes=3, final_time=1.0, **ends, **EULER)
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(15.0, rel=1e-5)


@functools.cache
def hill(declared: bool) -> Problem:
    """Straight over a hill is a saddle, around it is better. The same with two states in one unit gives 0.8994."""
    sizes = np.array([1e3, 1e3, 1.0, 1.0])
    x, u = tx.State("x", shape=(4,), scale=sizes if declared else None), tx.Control("u", shape=(2,))
    p, v = (x / sizes)[:2], x[2:]
    dynamics = tx.compile(tx.System(rates={x: tx.Concat(1e3 * v, u - 0.1 * v**3)}))
    ends: dict[str, Any] = {"initial": {x: [-1e3, 0.0, 0.0, 0.0]}, "final": {x: [1e3, 0.0, 0.0, 0.0]}}
    cost = tx.Minimize(running=0.1 * (u @ u) + 3.0 * tx.Exp(-(p @ p) / 0.2))
    return Problem(dynamics, cost, nodes=13, final_time=3.0, **ends)


@pytest.mark.parametrize("declared", [False, True])
def test_a_saddle_is_left_whatever_units_stand_in_one_vector(declared: bool) -> None:
    result = hill(declared).solve()
    assert result.solved
    assert result.cost == pytest.approx(0.8995, rel=1e-4)


def test_a_saddle_along_which_a_run_creeps_is_left_at_every_tolerance_and_of_many_cases() -> None:
    for tolerance in (1e-4, 1e-8):
        result = hill(False).solve(tolerance=tolerance)
        assert result.solved
        assert result.cost == pytest.approx(0.8995, rel=1e-4)
    starts = np.array([[x, 0.0, 0.0, 0.0] for x in (-800.0, -1000.0, -1100.0, -900.0)])
    many = hill(False).solve_many(initial={"x": starts})
    alone = [hill(False).solve(initial={"x": start}) for start in starts]
    assert many.solved.all()
    np.testing.assert_array_equal(many.iterations, [each.iterations for each in alone])
    np.testing.assert_allclose(many.cost, [each.cost for each in alone], rtol=1e-9)


def test_what_is_better_than_a_saddle_counts_where_its_search_has_no_end() -> None:
    """1 / (1 + x^2) from its top: it falls towards zero for ever."""
    x, u = tx.State("x"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: u}))
    result = Problem(
        dynamics, tx.Minimize(1.0 / (1.0 + x * x)), nodes=5, final_time=1.0, initial={x: 0.0}, **EULER
    ).solve(max_iterations=100)
    assert result.status in (Status.MAX_ITERATIONS, Status.STALLED)
    assert result.cost < 1e-6
    assert not result.saddle


def test_a_run_that_starts_with_far_too_little_time_finds_more() -> None:
    """Two links of an arm, moved in least time: 2.98351 s by Luus. Steps from a third of that are jammed at limits."""
    w1, w2, between, first = (tx.State(name) for name in ("w1", "w2", "between", "first"))
    u1, u2 = (tx.Control(name, min=-1.0, max=1.0) for name in ("u1", "u2"))
    s, c = tx.Sin(between), tx.Cos(between)
    inertia = 31.0 / 36.0 + 9.0 / 4.0 * s**2
    turn1 = s * (9.0 / 4.0 * c * w1**2 + 2.0 * w2**2) + 4.0 / 3.0 * (u1 - u2) - 1.5 * c * u2
    turn2 = s * (3.5 * w1**2 + 9.0 / 4.0 * c * w2**2) - 7.0 / 3.0 * u2 + 1.5 * c * (u1 - u2)
    rates: dict[Any, Any] = {w1: turn1 / inertia, w2: -turn2 / inertia, between: w2 - w1, first: w1}
    rest: dict[Any, Any] = {w1: 0.0, w2: 0.0, between: 0.5}
    ends: dict[str, Any] = {"initial": rest | {first: 0.0}, "final": rest | {first: 0.522}}
    problem = Problem(
        tx.compile(tx.System(rates=rates)), tx.Minimize(tx.Time()), nodes=31, final_time=(0.1, 20.0), **ends
    )
    result = problem.solve(final_time_guess=1.0)
    assert result.solved
    assert result.cost == pytest.approx(2.98351, rel=1e-3)


@pytest.mark.parametrize("unit", [1e3, 1e9])
def test_units_of_one_vector_do_not_matter_for_what_rests_there(unit: float) -> None:
    """Places in small units and speeds in one vector; a speed that rests in the guess has a price, and no limits."""

    def dash(unit: float) -> Problem:
        x, u = tx.State("x", shape=(4,)), tx.Control("u", shape=(2,))
        own: dict[str, Any] = {"slow": x[3] >= 0.0, "hard": u[0] <= 1.2, "back": -u[0] <= 1.2}
        dynamics = tx.compile(tx.System(rates={x: tx.Concat(unit * x[2:], u)}, constraints=own))
        ends: dict[str, Any] = {"initial": {x: [-unit, 0.0, 0.0, 0.0]}, "final": {x: [unit, 0.0, 0.0, 0.0]}}
        return Problem(dynamics, tx.Minimize(running=u @ u + x[3]), nodes=7, final_time=3.0, **ends, **HEUN)

    plain, other = dash(1.0).solve(), dash(unit).solve()
    assert plain.solved
    assert other.solved
    assert not other.saddle
    assert other.cost == pytest.approx(plain.cost, rel=2e-5)


def test_an_objective_may_vanish_at_the_optimum() -> None:
    """A linear plant with a quadratic cost: the optimum is as the square of where it starts, down to nothing."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    cost = tx.Minimize(running=p**2 + v**2 + 0.1 * u**2)
    problem = Problem(dynamics, cost, nodes=6, final_time=3.0, initial={p: 1e-3, v: 0.0})
    first = problem.solve()
    for start in (1e-6, 1e-9, 0.0):
        for options in ({}, {"warm": first}):
            result = problem.solve(initial={p: start, v: 0.0}, **options)
            assert result.solved
            assert result.cost == pytest.approx(first.cost * (start / 1e-3) ** 2, rel=1e-6, abs=1e-16 * first.cost)


def test_running_out_of_iterations_is_never_solved() -> None:
    """However many there were: SOLVED asks for errors within the tolerance, in scales just measured."""
    for most in range(1, 14):
        result = fastest(1.0).solve(max_iterations=most)
        errors = result.optimality
        small = max(errors.stationarity, errors.feasibility, errors.gap) <= 1e-6
        assert result.solved is small
        assert result.iterations <= most + 1
