"""Parameters that the optimiser may move: known optima, their multipliers, and what is refused."""

import functools
from typing import Any

import numpy as np
import pytest
from trajectory_systems import EULER, HEUN

import twistax as tx
from twistax.errors import ModelError, TrajectoryError
from twistax.trajectory import Problem, Status

#: Inertias of load and rotor, torque, and how far to turn.
LOAD, ROTOR, TORQUE, TURN = 2.0, 0.5, 2.0, 3.0


@functools.cache
def geared() -> tx.Dynamics:
    """A motor behind a gear turns a load: (LOAD + gear^2 ROTOR) v' = gear u."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-TORQUE, max=TORQUE)
    gear = tx.Parameter("gear", value=1.0)
    unread = tx.Parameter("unread", value=1.0)
    return tx.compile(
        tx.System(rates={p: v, v: gear * u / (LOAD + gear * gear * ROTOR)}, outputs={"not read": unread * p})
    )


def fastest(**options: Any) -> Problem:
    return Problem(
        geared(),
        tx.Minimize(tx.Time()),
        nodes=21,
        final_time=(0.5, 20.0),
        initial={"p": 0.0, "v": 0.0},
        final={"p": TURN, "v": 0.0},
        **HEUN,
        **options,
    )


def least_time(gear: float) -> float:
    return float(2.0 * np.sqrt(TURN * (LOAD + gear**2 * ROTOR) / (gear * TORQUE)))


def test_the_best_gear_matches_the_inertias() -> None:
    """gear = sqrt(LOAD / ROTOR), from where the objective has another slope; the other sign turns the motor round."""
    result = fastest(free=["gear"], guess={"gear": 0.7}).solve()
    assert result.status is Status.SOLVED
    assert abs(result.params["gear"]) == pytest.approx(np.sqrt(LOAD / ROTOR), rel=1e-4)
    assert result.final_time == pytest.approx(least_time(2.0), rel=1e-6)
    assert not any(name.startswith("gear") for name in result.multipliers)
    assert result.mesh_error["p"]["distance"] < 1e-6


def test_a_limit_that_binds_has_the_slope_of_the_objective_as_multiplier() -> None:
    gear = geared().parameters[0]
    problem = fastest(free={gear: (0.1, 1.5)})
    result = problem.solve(seed=1)
    slope = (least_time(1.5 + 1e-4) - least_time(1.5 - 1e-4)) / 2e-4
    assert result.solved
    assert result.params["gear"] == pytest.approx(1.5, abs=1e-6)
    assert result.multipliers["gear: upper limit"] == pytest.approx(-slope, rel=1e-4)
    assert "gear: upper limit" in result.active
    assert result.violations["gear: upper limit"] == pytest.approx(0.0, abs=1e-8)
    assert problem.solve(params={"gear": 1.2}).final_time == pytest.approx(result.final_time, rel=1e-6)
    assert problem.solve(free={"gear": (0.1, 3.0)}).params["gear"] == pytest.approx(2.0, rel=1e-3)
    assert problem.solve(warm=result, free={gear: (0.1, 1.4)}).params["gear"] == pytest.approx(1.4, abs=1e-6)
    for limits, word in (((None, 3.0), "sides"), ((2.0, 2.0), "low < high")):
        with pytest.raises(TrajectoryError, match=word):
            problem.solve(free={gear: limits})
    with pytest.raises(ModelError, match="leaves free: 'gear'"):
        problem.solve(free={"unread": (0.0, 1.0)})


@pytest.mark.parametrize("size", [pytest.param(1e-6, marks=pytest.mark.slow), 1e6])
def test_units_of_a_parameter_do_not_matter(size: float) -> None:
    """x' = u + push from 0 to size in 1 s at least u^2 + push^2: half each; an entry may have no value and no box."""
    x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,))
    push = tx.Parameter("push", shape=(2,))
    problem = Problem(
        tx.compile(tx.System(rates={x: u + push})),
        tx.Minimize(push @ push, running=u @ u),
        nodes=3,
        final_time=1.0,
        initial={x: np.zeros(2)},
        final={x: [size, -2.0 * size]},
        free={push: (None, [np.inf, -1.5 * size])},
        **EULER,
    )
    result = problem.solve()
    assert result.solved
    np.testing.assert_allclose(result.params["push"] / size, [0.5, -1.5], atol=1e-4)


def test_an_end_may_be_a_parameter_that_constraints_limit() -> None:
    """As far as 1 s allows, where a constraint reads nothing but the parameter."""
    x, u, place = tx.State("x"), tx.Control("u", min=-1.0, max=1.0), tx.Parameter("place", value=0.0)
    dynamics = tx.compile(tx.System(rates={x: u}, constraints={"near": place * place <= 0.25}))
    problem = Problem(
        dynamics,
        tx.Maximize(place),
        nodes=3,
        final_time=1.0,
        initial={x: 0.0},
        final=[x == place],
        free={place: (-9, 9)},
        **EULER,
    )
    result = problem.solve()
    assert result.solved
    assert result.params["place"] == pytest.approx(0.5, abs=1e-6)
    assert result.multipliers["near"] == pytest.approx([1.0], abs=1e-5)


BAD: list[tuple[Any, type[Exception], str]] = [
    ({"gaer": (1.0, 2.0)}, tx.ModelError, r"(?s)'gaer'.*did you mean 'gear'"),
    ({"unread": (1.0, 2.0)}, tx.ModelError, "'unread', but the problem reads the parameters: 'gear'"),
    ({"p": (1.0, 2.0)}, tx.ModelError, "'p'"),
    ({"gear": (2.0, 1.0)}, tx.ModelError, "free: 'gear' expects min below max"),
    ({"gear": ([1.0, 2.0], 3.0)}, tx.ShapeError, "'gear'"),
    ({"gear": 1.0}, tx.ModelError, r"free\['gear'\] expects limits"),
    ("gear", tx.ModelError, "free must be a dict"),
]


@pytest.mark.parametrize(("free", "error", "text"), BAD, ids=[str(number) for number in range(len(BAD))])
def test_what_cannot_be_free_is_refused(free: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        fastest(free=free)


def test_baked_parameters_and_guesses_outside_are_refused() -> None:
    with pytest.raises(tx.TrajectoryError, match=r"guess\['gear'\] must be within its limits"):
        fastest(free={"gear": (0.1, 1.5)}, guess={"gear": 2.0}).solve()
    dynamics = tx.compile(geared().system, bake={"gear": 1.0})
    with pytest.raises(tx.ModelError, match="'gear', which is a constant of the compiled dynamics"):
        Problem(dynamics, tx.Minimize(tx.Time()), final_time=(1.0, 2.0), free={"gear": (1.0, 2.0)})
