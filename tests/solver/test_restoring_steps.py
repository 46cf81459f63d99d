"""Steps of the feasibility restoration: how many it takes."""

import casadi as ca
import numpy as np
import pytest
from numpy import ndarray as Array
from solver_problems import too_fast
from solver_stages import Stage, Staged, refusing

from twistax.solver import CoreStatus

COUNT, STEP = 12, 0.3


def car(limit: float) -> tuple[Staged, Array]:
    """A car that turns by its control in each step, to a place behind it; the start goes straight ahead."""

    def after(x: ca.SX, u: ca.SX, p: ca.SX) -> list[ca.SX]:
        return [x[0] + STEP * ca.cos(x[2]), x[1] + STEP * ca.sin(x[2]), x[2] + u[0]]

    anywhere, at_start = (-np.inf, np.inf), (np.zeros(3), np.zeros(3))
    stages = [
        Stage(
            *(3, 1),
            cost=lambda x, u, p: u[0] ** 2,
            after=after,
            states_within=anywhere if k else at_start,
            controls_within=(-limit, limit),
        )
        for k in range(COUNT)
    ]
    stages.append(Stage(3, equalities=lambda x, u, p: [x[0] + 1.0, x[1] - 1.0]))
    places = np.zeros((COUNT + 1, 4))
    places[:, 0] = STEP * np.arange(COUNT + 1)
    return Staged(stages), places.ravel()[:-1]


@pytest.mark.parametrize("limit", [np.inf, 0.6])
def test_corrections_of_curved_dynamics_allow_long_steps(limit: float) -> None:
    """The search begins with a restoration, for no trial of its first step has values. Without corrections a step of it
    breaks the dynamics more than it reduces the violation, and is halved: five or six steps for two."""
    problem, start = car(limit)
    refusing(problem, 2, 59)
    solution = problem.solve(start)
    assert solution.status is CoreStatus.SOLVED
    assert solution.statistics["restorations"] == 1
    assert solution.statistics["restoration_iterations"] <= 3


@pytest.mark.parametrize("duration", [1.5, 1.99])
def test_the_barrier_of_a_restoration_falls_as_soon_as_its_problem_is_solved_to_a_multiple_of_it(
    duration: float,
) -> None:
    """As that of the search does. Where every problem is solved to a hundredth of its barrier these take 90 steps."""
    problem, start = too_fast(duration)
    solution = problem.solve(start)
    assert solution.status is CoreStatus.INFEASIBLE
    assert solution.statistics["restorations"] == 1
    assert solution.statistics["restoration_iterations"] <= 70
