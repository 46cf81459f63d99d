"""Starts that are far off, start at the optimum but for noise, or lead astray."""

import functools
from typing import Any

import numpy as np
import pytest
from trajectory_systems import EULER, HEUN

import twistax as tx
from twistax.jax_inside import in_double
from twistax.trajectory import Collocation, Integral, Linear, Maximum, Minimum, Problem

x, u = tx.State("x"), tx.Control("u")
WALL = u**2 + tx.Exp(10.0 * (x - 1.0)) - x


def along(running: Any, **options: Any) -> Problem:
    """x' = u over 1 s."""
    dynamics = tx.compile(tx.System(rates={x: u}))
    return Problem(dynamics, tx.Minimize(running=running), nodes=11, final_time=1.0, **{**HEUN, **options})


@pytest.mark.parametrize(
    ("running", "far"), [(tx.Exp(x) + u**2, 50.0), ((x - 1.0) ** 4 + u**2 - x, 1e3), (WALL, 10.0)], ids=str
)
def test_the_cost_of_a_start_says_nothing_of_the_optimum(running: Any, far: float) -> None:
    """It may be 1e40 times as large."""
    problem = along(running, initial={x: 0.0})
    near, found = problem.solve(), problem.solve({x: np.linspace(0.0, far, 11)})
    assert near.solved
    assert found.solved
    assert found.cost == pytest.approx(near.cost, rel=1e-6)


def test_a_start_of_far_too_little_time_says_nothing_of_the_optimum() -> None:
    """Time and work of 1 km from rest to rest: T = (3 c)^(1/4), c = 12 w L^2, and 4/3 T by all."""
    p, v, push = tx.State("p"), tx.State("v"), tx.Control("push", min=-1e9, max=1e9)
    problem = Problem(
        tx.compile(tx.System(rates={p: v, v: push})),
        tx.Minimize(tx.Time(), running=1e-3 * push * push),
        nodes=21,
        final_time=(1e-6, 1e6),
        initial={p: 0.0, v: 0.0},
        final={p: 1e3, v: 0.0},
    )
    exact = 4.0 / 3.0 * (36.0 * 1e-3 * 1e6) ** 0.25
    for guess in (1e-5, 1e-3):
        result = problem.solve(final_time_guess=guess)
        assert result.solved
        assert result.cost == pytest.approx(exact, rel=2e-3)  # held controls


@pytest.mark.parametrize("weight", [1.0, 1e6])
def test_noise_about_an_optimum_where_the_objective_vanishes(weight: float) -> None:
    """A controller at its goal: neither the objective nor what moves is of any size there."""
    rng = np.random.default_rng(0)
    problem = along(weight * (x - 1.0) ** 2 + 0.1 * u**2, initial={x: 1.0})
    for noise in (1e-12, 1e-9, 1e-6):
        guess = {x: 1.0 + noise * rng.normal(size=11), u: noise * rng.normal(size=10)}
        result = problem.solve(guess)
        assert result.solved
        assert result.iterations <= 5
        np.testing.assert_allclose(result.xs["x"], 1.0, rtol=0.0, atol=1e-13)


@functools.cache
def stopping() -> Problem:
    """A mass comes to rest at 0 in least time, |u| <= 1."""
    p, v, push = tx.State("p"), tx.State("v"), tx.Control("push", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: push}))
    ends: dict[str, Any] = {"initial": {p: 1.0, v: 0.7}, "final": {p: 0.0, v: 0.0}}
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=15, final_time=(0.1, 6.0), **ends, **HEUN)


@pytest.mark.parametrize(("place", "speed"), [(1.0, 0.7), (1.0, -1.5), (0.2, 1.4), (0.2, -1.0)])
@pytest.mark.parametrize("latest", [6.0, 60.0])
def test_a_mass_that_moves_is_stopped_in_least_time(place: float, speed: float, latest: float) -> None:
    """T = v + 2 sqrt(x + v^2 / 2), away from 0 and past it. With less time it comes nearest at once."""
    side = np.sign(place + 0.5 * speed * abs(speed))
    exact = side * speed + 2.0 * np.sqrt(side * place + 0.5 * speed**2)
    counts = list[int]()
    result = stopping().solve(
        initial={"p": place, "v": speed}, final_time=(0.1, latest), callback=lambda count, *_: counts.append(count)
    )
    assert result.solved
    assert result.cost == pytest.approx(exact, rel=2e-2)  # of 15 nodes
    assert counts == sorted(counts)


def test_a_target_that_moves_is_met_in_least_time() -> None:
    """From rest at -1, at most 0.8 m/s, beside what moves at 0.3 m/s: T = 2.89. A time that falls at once is lost."""
    p, v, push = tx.State("p"), tx.State("v"), tx.Control("push", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: push}, constraints={"speed": v <= 0.8}))
    ends: dict[str, Any] = {"initial": {p: -1.0, v: 0.0}, "final": [p == 0.3 * tx.Time(), v == 0.3]}
    result = Problem(dynamics, tx.Minimize(tx.Time()), nodes=25, final_time=(0.5, 6.0), **ends).solve()
    assert result.solved
    assert result.iterations <= 60
    # 0.8 s up to 0.8 m/s, 0.5 s down to 0.3; the rest of 1 + 0.3 T at 0.8.
    exact = (1.0 - 0.5 * 0.8**2 - 0.5 * (0.8 + 0.3) * 0.5 + 0.8 * 1.3) / (0.8 - 0.3)
    assert exact <= result.final_time + 1e-6
    assert result.final_time == pytest.approx(exact, rel=3e-3)


@pytest.mark.parametrize("constant", [0.0, 3.0])
def test_any_trajectory_will_do_where_the_objective_has_no_slope(constant: float) -> None:
    c = tx.Parameter("c", value=constant)
    result = along(0.0 * u + c, initial={x: 0.0}, final={x: 1.0}).solve()
    assert result.solved
    assert result.iterations <= 10
    assert result.xs["x"][-1] == pytest.approx(1.0)


def test_an_end_at_its_limit_but_for_rounding_is_at_it() -> None:
    place, push = tx.State("place", min=1e6), tx.Control("push")
    dynamics = tx.compile(tx.System(rates={place: push}))
    cost = tx.Minimize(running=push**2)
    ends: dict[str, Any] = {"initial": {place: 1e6 - 5e-4}, "final": {place: 1e6 + 0.1}}
    result = Problem(dynamics, cost, nodes=5, final_time=1.0, **ends, **EULER).solve()
    assert result.solved
    assert result.xs["place"][0] == 1e6


def pushed(unit: float, kind: str, controls: Any = None) -> Problem:
    """A rendezvous in a plane, places and pushes in a unit."""
    place, v, push = tx.State("place", shape=(2,)), tx.State("v", shape=(2,)), tx.Control("push", shape=(2,))
    size = tx.Sqrt(push @ push) if kind == "root" else tx.linalg.Norm(push)
    objective = tx.Minimize(Maximum(size)) if kind == "maximum" else tx.Minimize(running=size)
    limits = {} if kind == "maximum" else {"thrust": size <= unit}
    dynamics = tx.compile(tx.System(rates={place: v, v: push}, constraints=limits))
    ends: dict[str, Any] = {"final": {place: np.zeros(2), v: np.zeros(2)}}
    ends["initial"] = {place: unit * np.array([1.0, 0.5]), v: unit * np.array([0.0, 0.3])}
    # Heun's method is exact for held pushes; for linear ones its mesh would be too coarse.
    return Problem(
        dynamics, objective, nodes=13, final_time=3.0, controls=controls, **ends, **({} if controls else HEUN)
    )


@pytest.mark.parametrize("kind", ["cost", "root", "maximum"])
def test_bounds_on_norms_have_the_unit_of_what_they_bound(kind: str) -> None:
    plain, large = pushed(1.0, kind).solve(), pushed(1e4, kind)
    result = large.solve()
    assert result.solved
    assert result.cost == pytest.approx(1e4 * plain.cost, rel=1e-5)
    assert result.iterations <= 2 * plain.iterations
    places, speeds, sizes = np.array([1.0, 0.5]), np.array([0.0, 0.3]), np.array([1.0, 3e3, 7e3, 1e4])
    starts = {"place": sizes[:, None] * places, "v": sizes[:, None] * speeds}
    many = large.solve_many(initial=starts)
    for k, each in enumerate(many):
        alone = large.solve(initial={name: values[k] for name, values in starts.items()})
        assert each.solved
        assert each.iterations == alone.iterations


@pytest.mark.parametrize("kind", ["cost", "maximum"])
def test_bounds_on_norms_of_linear_controls_have_their_unit(kind: str) -> None:
    plain, large = (pushed(unit, kind, Linear()).solve(tolerance=1e-7) for unit in (1.0, 1e4))
    assert large.solved
    assert large.cost == pytest.approx(1e4 * plain.cost, rel=1e-5)
    assert large.iterations <= 2 * plain.iterations
    assert plain.iterations <= 80


def test_a_budget_that_is_used_up_by_coasting_is_met_at_a_minimum() -> None:
    """Norms are at the apex of their cones over most of the way, and there a point outside bends the other way."""
    place, v, push = tx.State("place", shape=(2,)), tx.State("v", shape=(2,)), tx.Control("push", shape=(2,))
    dynamics = tx.compile(tx.System(rates={place: v, v: push}))
    result = Problem(
        dynamics,
        tx.Minimize(running=push @ push),
        nodes=21,
        final_time=3.0,
        initial={place: np.array([1.0, 0.5]), v: np.array([0.0, 0.3])},
        final=[place == np.zeros(2), v == np.zeros(2), Integral(tx.linalg.Norm(push)) <= 1.0],
    ).solve()
    assert result.solved
    assert not result.saddle
    sizes = np.linalg.norm(result.us["push"], axis=1)
    assert sizes.sum() * 0.15 == pytest.approx(1.0, rel=1e-5)
    assert (sizes < 1e-6).sum() > 10


def test_steps_that_explode_do_not_make_all_else_count_as_nothing() -> None:
    """An explicit step of 1,000 time constants: what it makes of a state, 4e10 times as much, is no measure of it."""
    c = tx.Control("c", min=-5.0, max=5.0)
    dynamics = tx.compile(tx.System(rates={x: -1e4 * (x - c)}))
    cost = tx.Minimize(running=(x - tx.Sin(3.0 * tx.Time())) ** 2)
    options: dict[str, Any] = {"nodes": 21, "final_time": 2.0, "initial": {x: 0.0}, "controls": Linear()}
    explicit = Problem(dynamics, cost, **options).solve()
    stiff = Problem(dynamics, cost, **options, transcription=Collocation(tx.tableaus.RADAU_IIA5)).solve()
    assert stiff.solved
    assert stiff.cost < 1e-4
    assert explicit.cost == pytest.approx(stiff.cost, rel=1e-6)  # solved by the same steps in the end
    assert "Explicit steps are unstable" in explicit.message
    assert stiff.mesh_error["x"]["distance"] < 1e-5  # by implicit steps
    assert "limits exceeded by that rollout: none" in stiff.explain()


def test_states_that_explode_together_do_not_either() -> None:
    """A step of Euler's method over 1,000 rad of an oscillator, where no state grows by itself: 0.0087 at the best."""
    p, v, c = tx.State("p"), tx.State("v"), tx.Control("c", min=-5.0, max=5.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: -1e8 * (p - c)}))
    cost = tx.Minimize(running=(p - tx.Sin(3.0 * tx.Time())) ** 2)
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}}
    result = Problem(dynamics, cost, nodes=21, final_time=2.0, **ends, **EULER).solve()
    assert not result.solved or result.cost < 0.01


def test_extremes_of_any_sign_begin_where_the_guess_keeps_them() -> None:
    """What is pushed in one direction, and how an extreme of it is written, changes nothing."""
    push = tx.Control("push", min=-4.0, max=4.0)
    v = tx.State("v")
    dynamics = tx.compile(tx.System(rates={x: v, v: push}))
    ends: dict[str, Any] = {"initial": {x: 0.0, v: 0.0}, "final": {x: 1.0, v: 0.0}}
    costs = list[float]()
    for objective, sign in ((tx.Minimize(Maximum(-push)), 1.0), (tx.Maximize(Minimum(push)), -1.0)):
        problem = Problem(dynamics, objective, nodes=7, final_time=2.0, **ends, **HEUN)
        with in_double():
            bound = problem.started(sizes=[{"push": np.array([2.0])}]).point.border[-1]
        assert sign * bound >= 2.0
        costs.append(sign * problem.solve().cost)
    # At 4 m/s2 for 0.25 s, then at 1 / 1.75 m/s2 to rest: with held pushes a little more.
    assert costs[0] == pytest.approx(costs[1], rel=1e-5)
    assert 1.0 / 1.75 - 1e-5 <= costs[0] <= 0.61


def test_sizes_of_parameters_alone_need_no_bound() -> None:
    k = tx.Parameter("k", value=2.0)
    plain = tx.compile(tx.System(rates={x: k}))
    result = Problem(plain, tx.Minimize(running=tx.Abs(k)), nodes=4, final_time=1.0, initial={x: 0.0}, **EULER).solve()
    assert result.cost == pytest.approx(2.0)
    budget: list[Any] = [{x: 1.0}, Integral(tx.Abs(k)) <= 3.0]
    driven = tx.compile(tx.System(rates={x: k * u}))
    cost = tx.Minimize(running=u**2)
    result = Problem(driven, cost, nodes=4, final_time=1.0, initial={x: 0.0}, final=budget, **EULER).solve()
    assert result.solved
    assert result.cost == pytest.approx(0.25)
