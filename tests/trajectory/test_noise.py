"""Guesses with noise, and runs that begin anew: the way to an optimum does not hang on last digits."""

import functools
from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.report.sections import flights
from twistax.trajectory import Problem, Status

#: Acceleration, distance and the least time from rest to rest.
PUSH, FAR = 10.0, 1000.0
LEAST = 2.0 * np.sqrt(FAR / PUSH)


@functools.cache
def fastest() -> Problem:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-PUSH, max=PUSH)
    return Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(tx.Time()),
        nodes=21,
        final_time=(1.0, 200.0),
        initial={p: 0.0, v: 0.0},
        final={p: FAR, v: 0.0},
        **HEUN,
    )


def noisy(seed: int, size: float) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    straight = {"p": np.linspace(0.0, FAR, 21), "v": np.zeros(21)}
    return {name: values + size * rng.normal(size=21) for name, values in straight.items()}


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e-4])
def test_noise_of_a_guess_is_no_scale(size: float) -> None:
    """A speed that stands at zero but for noise: noise taken for its size costs three to ten times the steps."""
    plain = fastest().solve()
    for seed in (1, 2):
        result = fastest().solve(guess=noisy(seed, size))
        assert result.solved
        assert result.final_time == pytest.approx(LEAST, rel=1e-6)
        assert result.iterations <= 2 * plain.iterations


def test_declared_sizes_are_kept() -> None:
    """Speeds and pushes that are declared to be far smaller than what the guess needs of them."""
    p, v, u = tx.State("p"), tx.State("v", scale=1e-3), tx.Control("u", min=-PUSH, max=PUSH, scale=1e-4)
    problem = Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(tx.Time()),
        nodes=5,
        final_time=20.0,
        initial={p: 0.0, v: 0.0},
        final={p: FAR, v: 0.0},
        **HEUN,
    )
    scales = problem.solve(max_iterations=1).warm.scales
    np.testing.assert_array_equal(scales.d[:, 1], 1e-3)
    np.testing.assert_array_equal(scales.u[:, 0], 1e-4)


def test_the_delta_iii_is_solved_from_its_guess() -> None:
    """Its multipliers run away on the way. Source of the mass: Betts, as `report --optimal` names it."""
    problem = flights.delta_iii()
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(7529.712, rel=1e-5)
    # Perturbed starts lie deep inside of the Earth, under air of 1e200 kg/m3: whatever comes of it, there is a way.
    for seed in (1, 4, 7):
        assert problem.solve(seed=seed).status not in (Status.INFEASIBLE, Status.UNBOUNDED)


@pytest.mark.parametrize("rate", [lambda x: 0.1 * tx.Exp(-40.0 * x), lambda x: 0.05 * tx.Log(x + 0.05)])
def test_random_starts_mean_something(rate: Any) -> None:
    """Where a step of the usual size makes rates of a million, or such as are not numbers."""
    x, u = tx.State("x"), tx.Control("u")
    objective, ends = tx.Minimize(running=u**2), {"initial": {x: 0.0}, "final": {x: 1.0}}
    dynamics = tx.compile(tx.System(rates={x: u + rate(x)}))
    problem = Problem(dynamics, objective, nodes=21, final_time=1.0, **ends, **HEUN)
    plain = problem.solve()
    assert plain.solved
    results = [problem.solve(seed=seed) for seed in range(1, 21)]
    solved = [result for result in results if result.solved]
    # On a coarse mesh there are other optima where the rate is huge: one start in ten ends there, as COARSE.
    assert len(solved) >= 17
    assert all(result.status in (Status.SOLVED, Status.COARSE) for result in results)
    np.testing.assert_allclose([result.cost for result in solved], plain.cost, rtol=1e-5)
