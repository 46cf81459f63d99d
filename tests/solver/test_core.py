"""The interior-point core beside IPOPT, and where its answers are known."""

import dataclasses
import re
import threading
from typing import Any

import numpy as np
import pytest
from solver_problems import NODES, PROBLEMS, least_time, too_fast
from solver_stages import AS_IPOPT, Stage, Staged, refusing

import twistax as tx
from twistax.solver import SOURCES, CoreStatus, Options


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_steps_of_ipopt(name: str) -> None:
    """With IPOPT's choices the core takes its steps, to the last digits of the point where both end."""
    problem, start = PROBLEMS[name]()
    z, cost, iterations = problem.by_ipopt(start)
    solution = problem.solve(start, **AS_IPOPT)
    assert solution.status is CoreStatus.SOLVED
    assert abs(solution.statistics["iterations"] - iterations) <= 1
    assert solution.statistics["cost"] == pytest.approx(cost, rel=1e-9)
    np.testing.assert_allclose(solution.z, z, atol=1e-7)


@pytest.mark.parametrize("name", PROBLEMS)
def test_default_options_find_the_same_optima(name: str) -> None:
    problem, start = PROBLEMS[name]()
    _, cost, iterations = problem.by_ipopt(start)
    solution = problem.solve(start)
    assert solution.status is CoreStatus.SOLVED
    assert solution.statistics["cost"] == pytest.approx(cost, rel=1e-6)
    assert solution.statistics["iterations"] <= 1.5 * iterations


@pytest.mark.parametrize("name", PROBLEMS)
def test_multipliers_satisfy_the_optimality_conditions(name: str) -> None:
    """Of the problem as stated, with its rows and cost unscaled, in units of 1: by the test's functions alone."""
    problem, start = PROBLEMS[name]()
    found = problem.solve(start)
    stages = problem.stages
    gradient, of_after, of_h, of_e = problem._slopes(found.z)
    left = gradient - found.zl + found.zu
    at, p = 0, stages.variables - stages.parameters
    counts = [0, 0, 0]
    for k, nv in enumerate(x + u for x, u in zip(stages.states, stages.controls)):
        for i, (blocks, multipliers) in enumerate(((of_after, found.lam), (of_h, found.y), (of_e, found.ye))):
            rows = len(blocks[k])
            pull = blocks[k].T @ multipliers[counts[i] : counts[i] + rows]
            left[at : at + nv] += pull[:nv]
            left[p:] += pull[nv:]
            counts[i] += rows
        if k:
            before = found.lam[counts[0] - len(of_after[k]) - stages.states[k] : counts[0] - len(of_after[k])]
            left[at : at + stages.states[k]] -= before
        at += nv
    free = problem.lower < problem.upper
    assert np.abs(left[free]).max() < 1e-6
    assert found.y.min(initial=0.0) > -1e-9


def test_least_time_is_known() -> None:
    problem, start = least_time()
    solution = problem.solve(start)
    assert solution.statistics["cost"] == pytest.approx(2.0, abs=1e-6)


def test_units_change_nothing() -> None:
    """Lengths in mm and sizes of 1e3 give the steps that lengths in m give."""

    def moved(unit: float) -> tuple[float, float]:
        h = 0.15
        stages = [
            Stage(
                *(2, 1),
                cost=lambda x, u, p: (u[0] / unit) ** 2 + (x[0] / unit) ** 4,
                after=lambda x, u, p: [x[0] + h * x[1], x[1] + h * u[0]],
                states_within=(-np.inf, np.inf) if k else ([0.5 * unit, 0.0], [0.5 * unit, 0.0]),
                controls_within=(-unit, unit),
            )
            for k in range(NODES - 1)
        ]
        stages.append(Stage(2, equalities=lambda x, u, p: [x[0] / unit - 1, x[1] / unit]))
        problem = Staged(stages)
        start = np.full(problem.stages.variables, 0.1 * unit)
        found = problem.solve(start, size=np.full(problem.stages.variables, unit))
        return found.statistics["iterations"], found.statistics["cost"]

    in_metres, in_millimetres = moved(1.0), moved(1e3)
    assert in_metres[0] == in_millimetres[0]
    assert in_metres[1] == pytest.approx(in_millimetres[1], rel=1e-8)


@pytest.mark.parametrize(("duration", "status"), [(1.9, CoreStatus.INFEASIBLE), (2.1, CoreStatus.SOLVED)])
def test_infeasible_is_told_from_hard(duration: float, status: CoreStatus) -> None:
    problem, start = too_fast(duration)
    solution = problem.solve(start)
    assert solution.status is status
    assert (solution.statistics["violation"] > 1e-3) == (status is CoreStatus.INFEASIBLE)


def test_a_warm_start_ends_at_once() -> None:
    problem, start = PROBLEMS["swing_up"]()
    cold = problem.solve(start)
    near = {"barrier_start": 1e-9, "bound_push": 1e-9, "bound_share": 1e-9, "slack_push": 1e-9}
    warm = problem.solve(cold.z, warm=cold, **near)
    assert warm.status is CoreStatus.SOLVED
    assert warm.statistics["iterations"] <= 2 < cold.statistics["iterations"]
    assert warm.statistics["cost"] == pytest.approx(cold.statistics["cost"], rel=1e-7)


def test_a_solve_stops_when_asked() -> None:
    problem, start = PROBLEMS["swing_up"]()
    solution = problem.solve(start, stop=lambda iteration: iteration >= 3)
    assert solution.status is CoreStatus.STOPPED
    assert solution.statistics["iterations"] == 3 == len(solution.log)
    assert np.isfinite(solution.z).all()


def test_the_count_of_iterations_is_limited() -> None:
    problem, start = PROBLEMS["swing_up"]()
    assert problem.solve(start, iterations=2).status is CoreStatus.MAX_ITERATIONS


def test_a_start_without_finite_values() -> None:
    stages = [Stage(1, 1, after=lambda x, u, p: [x[0] / u[0]]), Stage(1)]
    assert Staged(stages).solve(np.zeros(3)).status is CoreStatus.NON_FINITE


def test_bounds_that_fix_a_later_state_are_refused() -> None:
    stages = [Stage(1, 1, after=lambda x, u, p: [x[0] + u[0]]), Stage(1, states_within=(1.0, 1.0))]
    with pytest.raises(tx.TrajectoryError, match="fix a later state by an equality"):
        Staged(stages).solve(np.zeros(3))


def test_an_exception_of_a_function_is_raised() -> None:
    problem, start = least_time()
    problem._slopes = lambda z: 1 / 0
    with pytest.raises(ZeroDivisionError):
        problem.solve(start)


def test_threads_solve_side_by_side() -> None:
    """The core has no state: two problems at once give what each gives alone."""
    problems = {name: make() for name, make in PROBLEMS.items()}
    alone = {name: problem.solve(start).z for name, (problem, start) in problems.items()}
    together: dict[str, np.ndarray] = {}

    def run(name: str) -> None:
        problem, start = PROBLEMS[name]()
        together[name] = problem.solve(start).z

    threads = [threading.Thread(target=run, args=(name,)) for name in PROBLEMS]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for name, z in alone.items():
        np.testing.assert_array_equal(together[name], z)


# ---- how far the cost is above the minimum ---------------------------------------------------------------------------


def test_a_unit_of_the_cost_that_is_far_too_large_is_no_optimum() -> None:
    """In such a unit every error is small. What a Newton step gains says how far the cost is above the minimum."""
    problem, start = least_time()
    exact = problem.solve(start, tolerance=1e-10, complementarity=1e-10).statistics["cost"]
    wide: dict[str, float] = {"cost": 1e6, "tolerance": 1e-4, "complementarity": 1e-4, "acceptable": 1e-4}
    solution, early = problem.solve(start, **wide), problem.solve(start, **wide, excess=1e30)
    assert solution.status is early.status is CoreStatus.SOLVED
    assert solution.statistics["cost"] == pytest.approx(exact, rel=2e-6)
    above = early.statistics["cost"] - exact
    assert above > 1e-4 * abs(exact)
    assert 0.3 * above < early.statistics["excess"] < 10.0 * above


def chain(cost: Any, lower: float, upper: float, count: int = 6) -> tuple[Staged, np.ndarray]:
    """x_(k+1) = x_k + u_k from 0, with limits of u."""
    step = Stage(1, 1, cost=cost, after=lambda x, u, p: [x[0] + u[0]], controls_within=(lower, upper))
    first = dataclasses.replace(step, states_within=(0.0, 0.0))
    return Staged([first, *[step] * (count - 1), Stage(1)]), np.linspace(0.1, 0.7, 2 * count + 1)


def test_a_minimum_of_zero_is_solved() -> None:
    """Where the cost and the multipliers of the dynamics vanish an excess relative to them does not."""
    problem, start = chain(lambda x, u, p: u[0], 0.0, np.inf)
    solution = problem.solve(start)
    assert solution.status is CoreStatus.SOLVED
    assert solution.statistics["cost"] < 1e-10
    assert solution.statistics["iterations"] <= 30


@pytest.mark.parametrize(("iterations", "known"), [(2, False), (200, True)])
def test_the_excess_is_estimated_near_an_optimum(iterations: int, known: bool) -> None:
    """Few iterations of a controller need no estimate, and it takes a factorisation."""
    problem, start = PROBLEMS["swing_up"]()
    statistics = problem.solve(start, iterations=iterations).statistics
    assert np.isfinite(statistics["excess"]) == known
    plain = problem.solve(start, iterations=iterations, excess=1e30).statistics
    assert statistics["factorizations"] == plain["factorizations"]


# ---- bounds ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bound", [0.0, 0.1, -3.0, 1e3])
def test_bounds_are_relaxed_by_a_share_of_themselves(bound: float) -> None:
    """One at zero is not: what is divided by keeps its sign."""
    seen: list[float] = []
    problem, start = chain(lambda x, u, p: u[0], bound, np.inf)
    values = problem._numbers
    problem._numbers = lambda z: (seen.append(z[1:-1:2].min()), values(z))[1]
    solution = problem.solve(start + bound, bound_relaxation=1e-4)
    assert solution.status is CoreStatus.SOLVED
    np.testing.assert_allclose(solution.z[1:-1:2], bound - 1e-4 * abs(bound), atol=1e-6 * max(1.0, abs(bound)))
    assert bound != 0.0 or min(seen[1:]) > 0.0


# ---- the sources -----------------------------------------------------------------------------------------------------


def test_every_option_has_a_source() -> None:
    assert list(SOURCES) == list(Options.__dataclass_fields__)
    words = r"\[WB\]|\[BV\]|IPOPT|1:|weight|largest count|residual|factor|Math\. Programming|rounding"
    assert all(re.search(words, source) for source in SOURCES.values())


# ---- what goes wrong -------------------------------------------------------------------------------------------------


def test_a_start_that_is_not_finite_returns_no_leftovers() -> None:
    """Multipliers are zero and measures NaN, whatever the memory held before."""
    stages = [Stage(1, 1, after=lambda x, u, p: [x[0] / u[0]]), Stage(1, equalities=lambda x, u, p: [x[0], x[0] - 1])]
    filled = [np.full(5000, 7.7e77) for _ in range(4)]
    del filled
    solution = Staged(stages).solve(np.zeros(3))
    assert solution.status is CoreStatus.NON_FINITE
    np.testing.assert_array_equal(np.concatenate([solution.lam, solution.ye, solution.zl, solution.zu]), 0.0)
    assert np.isnan(solution.statistics["cost"])
    assert np.isnan(solution.statistics["error"])


def test_a_line_search_without_violation_ends() -> None:
    """There the shortest step is zero long: lengths that are halved must still come to an end."""
    problem = Staged([Stage(1, cost=lambda x, u, p: (x[0] - 1) ** 2, after=lambda x, u, p: [x[0]]), Stage(1)])
    calls = refusing(problem, 2, 10**9)
    assert problem.solve(np.zeros(2)).status is not CoreStatus.SOLVED
    assert calls[0] < 3000


@pytest.mark.parametrize("count", [1, 2])
def test_equalities_may_depend_on_each_other(count: int) -> None:
    stages = [
        Stage(1, 1, cost=lambda x, u, p: u[0] ** 2, after=lambda x, u, p: [x[0] + u[0]], states_within=(0.0, 0.0)),
        Stage(1, 1, cost=lambda x, u, p: u[0] ** 2, after=lambda x, u, p: [x[0] + u[0]]),
        Stage(1, equalities=lambda x, u, p: [x[0] - 1.0] * count),
    ]
    solution = Staged(stages).solve(np.zeros(5))
    assert solution.status is CoreStatus.SOLVED
    assert solution.statistics["cost"] == pytest.approx(0.5, abs=1e-7)
    assert solution.ye.sum() == pytest.approx(-1.0, abs=1e-5)


@pytest.mark.parametrize("off", [1e-5, 3e-7, 1e-7])
def test_a_small_violation_is_restored(off: float) -> None:
    """After a line search that failed. Squares of so small a violation are no stationary point of it."""
    problem = Staged([Stage(1, after=lambda x, u, p: [x[0]]), Stage(1, equalities=lambda x, u, p: [x[0] - 1.0])])
    refusing(problem, 2, 59)
    solution = problem.solve(np.full(2, 1.0 + off))
    assert solution.statistics["restorations"] == 1
    assert solution.status is CoreStatus.SOLVED


@pytest.mark.parametrize(("most", "status"), [(5, CoreStatus.MAX_ITERATIONS), (100, CoreStatus.SOLVED)])
def test_few_steps_of_a_restoration_say_nothing_of_feasibility(most: int, status: CoreStatus) -> None:
    """Source: A. Waechter, L. T. Biegler, Failure of global convergence for a class of interior point methods for
    nonlinear programming, Math. Program. 88 (2000), equation (5)."""
    rows = lambda x, u, p: [x[0] ** 2 - x[1] - 1.0, x[0] - x[2] - 0.5]  # noqa: E731
    first = Stage(
        3,
        cost=lambda x, u, p: x[0],
        after=lambda x, u, p: [x[0]],
        equalities=rows,
        states_within=([-np.inf, 0.0, 0.0], np.inf),
    )
    solution = Staged([first, Stage(1)]).solve(np.array([-2.0, 3.0, 1.0, -2.0]), restoration_iterations=most)
    assert solution.status is status


def test_options_are_checked() -> None:
    problem, start = least_time()
    with pytest.raises(tx.TrajectoryError, match="iterations expects"):
        problem.solve(start, iterations=1e10)
    with pytest.raises(tx.TrajectoryError, match="tolerance expects"):
        problem.solve(start, tolerance=np.nan)
