"""Hundreds of random quadratic programs of each kind: none may end without its solution or with a wrong one."""

import numpy as np
import pytest
from qp_problems import FAMILIES, solvable

from twistax.solver import QPSolution, QPStatus, solve_qp


@pytest.mark.parametrize("family", FAMILIES)
def test_random_problems_are_solved(family: str) -> None:
    solutions: list[QPSolution] = []
    for seed in range(1000, 1400):
        qp = solvable(seed, **FAMILIES[family])
        solutions.append(qp.solve())
        assert solutions[-1].status is QPStatus.SOLVED, seed
        assert max(qp.errors(solutions[-1]).values()) < 1e-9
    iterations = np.array([s.iterations for s in solutions])
    assert np.median(iterations) <= 9
    assert iterations.max() <= 30


@pytest.mark.parametrize(("decades", "solved"), [(0, 1.0), (6, 1.0), (9, 1.0), (12, 0.98)])
def test_badly_conditioned_costs_are_solved(decades: int, solved: float) -> None:
    """Eigenvalues of H over many decades. What is not solved says so."""
    statuses = []
    for seed in range(200):
        qp, rng = solvable(seed), np.random.default_rng(seed)
        Q, _ = np.linalg.qr(rng.normal(size=qp.H.shape))
        H = (Q * 10.0 ** -np.linspace(0, decades, len(Q))) @ Q.T
        qp = type(qp)(**(vars(qp) | {"H": (H + H.T) / 2}))
        solution = qp.solve()
        statuses.append(solution.status)
        assert solution.status not in (QPStatus.INFEASIBLE, QPStatus.UNBOUNDED)
        assert solution.status is not QPStatus.SOLVED or max(qp.errors(solution).values()) < 1e-8
    assert np.mean([status is QPStatus.SOLVED for status in statuses]) >= solved


@pytest.mark.parametrize(("decades", "solved"), [(2, 1.0), (3, 0.9), (4, 0.5)])
def test_costs_that_vanish_are_solved(decades: int, solved: float) -> None:
    """At the solution the gradient and all multipliers are 0; curvatures over twice as many decades lead there."""
    statuses = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        B = rng.normal(size=(8, 20)) * 10.0 ** -np.linspace(0, decades, 8)[:, None]
        x = np.linalg.svd(B)[2][8:].T @ rng.normal(size=12)
        A, C, nothing = rng.normal(size=(3, 20)), rng.normal(size=(30, 20)), np.full(30, -np.inf)
        high = C @ x + rng.exponential(size=30) * (rng.random(30) < 0.7)
        solution = solve_qp(B.T @ B, np.zeros(20), A, A @ x, C, nothing, high)
        statuses.append(solution.status)
        assert solution.status is not QPStatus.SOLVED or np.abs(B @ solution.x).max() < 1e-4
    assert np.mean([status is QPStatus.SOLVED for status in statuses]) >= solved


@pytest.mark.parametrize(("off", "solved"), [(1e-3, 1.0), (1e-4, 1.0), (1e-5, 0.9)])
def test_equalities_that_almost_depend_on_each_other(off: float, solved: float) -> None:
    """A third row is nearly the first, as at a singular pose of an arm. What is not solved says so."""
    statuses = []
    for seed in range(150):
        qp, rng = solvable(seed), np.random.default_rng(seed)
        n = len(qp.g)
        if n < 5:
            continue
        A, x = rng.normal(size=(3, n)), rng.uniform(-1, 1, n)
        A[2] = A[0] + off * rng.normal(size=n)
        t = qp.C @ x
        rows = {"row_lower": t - rng.exponential(size=len(t)), "row_upper": t + rng.exponential(size=len(t))}
        bounds = {"lower": np.full(n, -20.0), "upper": np.full(n, 20.0)}
        qp = type(qp)(**(vars(qp) | {"A": A, "b": A @ x} | rows | bounds))
        solution = qp.solve()
        statuses.append(solution.status)
        assert solution.status not in (QPStatus.INFEASIBLE, QPStatus.UNBOUNDED)
        assert solution.status is not QPStatus.SOLVED or max(qp.errors(solution).values()) < 1e-8
    assert np.mean([status is QPStatus.SOLVED for status in statuses]) >= solved
