"""Optima of a mesh that are none of the equations, and rows that are flat to several orders: never SOLVED."""

import numpy as np
import pytest

import twistax as tx
from twistax.trajectory import Collocation, Mesh, Problem, Status


def lag(rate: float, **options: object) -> Problem:
    """A place whose speed follows a control with a lag."""
    x, z, w = tx.State("x"), tx.State("z"), tx.Control("w", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={x: z, z: -rate * (z - w)}))
    objective = tx.Minimize(running=x**2 + 0.01 * w**2)
    return Problem(dynamics, objective, nodes=21, final_time=2.0, initial={x: 1.0, z: 0.0}, **options)


@pytest.mark.parametrize("rate", [200.0, 500.0])
def test_a_method_that_is_not_stable_gives_no_optimum(rate: float) -> None:
    """At rest the trajectory follows the equations to rounding; any control makes this method diverge."""
    result = lag(rate).solve()
    assert result.status is not Status.SOLVED
    if result.status is Status.COARSE and result.accuracy.error <= 1e-2:
        assert "not stable" in result.message
        assert result.accuracy.factor > 1e2
    right = lag(rate, transcription=Collocation(tx.tableaus.RADAU_IIA5)).solve(mesh_tolerance=0.3)
    assert right.solved
    assert right.accuracy.factor == 1.0
    assert right.cost < 0.4


def test_the_factor_is_that_of_the_method() -> None:
    """Of RK4: the polynomial of its stability."""
    z = -200.0 * 2.0 / 20 / 2  # two substeps
    found = lag(200.0).solve(strategies=()).accuracy.amplified
    np.testing.assert_allclose(np.concatenate(found), 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rtol=1e-9)


def test_an_oscillation_that_free_nodes_step_over_is_not_solved() -> None:
    """Scales that grow with the result say nothing about it."""
    x, k, w = tx.State("x"), tx.State("k", shape=(2,)), tx.Control("w", min=-1.0, max=1.0)
    rates = {x: k[0] + w, k: tx.Concat(40.0 * k[1], -40.0 * k[0] + 5 * w)}
    objective = tx.Minimize(running=x**2 + 0.01 * w**2)
    ends = {"initial": {x: 1.0, k: [0.0, 1.0]}, "final": {x: 0.0}}
    problem = Problem(tx.compile(tx.System(rates=rates)), objective, nodes=Mesh(12, free=True), final_time=2.0, **ends)
    assert not problem.solve(max_iterations=150).solved


@pytest.mark.parametrize("power", [2, 4, 6])
def test_a_row_that_is_flat_to_any_order_is_not_solved_away_from_its_zero(power: int) -> None:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends = {"initial": {p: 0.0, v: 0.0}, "final": [p == 1.0, v**power <= 0.0]}
    result = Problem(dynamics, tx.Minimize(tx.Time()), nodes=21, final_time=(0.1, 6.0), **ends).solve()
    assert result.cost == pytest.approx(2.0, abs=1e-6) or result.status is Status.DEGENERATE


def test_limits_that_do_not_bind_are_not_degenerate() -> None:
    """A climb out of air of exponential density: a whole move away, below the ground, its drag overflows."""
    h, v = tx.State("h", max=30.0), tx.State("v", max=30.0)
    thrust = tx.Control("thrust", min=-40.0, max=40.0)
    drag = tx.Exp(-100.0 * h) * v
    problem = Problem(
        tx.compile(tx.System(rates={h: v, v: thrust - drag})),
        tx.Minimize(running=thrust**2),
        nodes=21,
        final_time=2.0,
        initial={h: 0.0, v: 0.0},
        final={h: 10.0, v: 0.0},
    )
    assert problem.solve().status is Status.SOLVED
