"""Quadratic programs without a solution: the status comes with a proof, checked by the test's arithmetic."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from qp_problems import FAMILIES, QP, contact_forces, solvable, with_row

from twistax.solver import QPSolution, QPStatus, solve_qp


def check_certificate(qp: QP, s: QPSolution) -> None:
    """Farkas: multipliers whose combination of constraints reads 0 <= a negative number."""
    assert s.status is QPStatus.INFEASIBLE
    bounds = 0.0
    for z, low, high in ((s.y, qp.b, qp.b), (s.z, qp.row_lower, qp.row_upper), (s.w, qp.lower, qp.upper)):
        bounds += np.where(z > 0, z * np.where(z > 0, high, 0), z * np.where(z < 0, low, 0)).sum()
    assert bounds < 0
    size = 1 + np.abs(s.x).max()
    assert np.abs(qp.A.T @ s.y + qp.C.T @ s.z + s.w).max() * size < 1e-6 * -bounds
    assert s.certificate < 1e-7


def out_of_reach(qp: QP, seed: int, gap: float) -> QP | None:
    """With a row that asks for more, by a gap over its size, than another row can have."""
    row = qp.C[np.random.default_rng(seed).integers(len(qp.C))]
    low, high = np.isfinite(qp.row_lower), np.isfinite(qp.row_upper)
    most = scipy.optimize.linprog(
        -row,
        A_ub=np.vstack([qp.C[high], -qp.C[low]]),
        b_ub=np.concatenate([qp.row_upper[high], -qp.row_lower[low]]),
        A_eq=qp.A,
        b_eq=qp.b,
        bounds=np.stack([qp.lower, qp.upper], axis=1),
    )
    if most.status:
        return None
    size = max(abs(most.fun), np.abs(row).max() * np.abs(most.x).max())
    return with_row(qp, row, -most.fun + gap * size, np.inf)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("gap", [1.0, 1e-4])
def test_infeasible_problems_come_with_a_certificate(family: str, gap: float) -> None:
    checked = 0
    for seed in range(10):
        feasible = solvable(seed, **FAMILIES[family])
        qp = out_of_reach(feasible, seed, gap) if len(feasible.C) else None
        if qp is not None:
            check_certificate(qp, qp.solve())
            checked += 1
    assert checked >= 5


def test_the_violation_of_rows_is_the_least() -> None:
    """x <= 0 and x >= 1 by rows: the point between them."""
    solution = solve_qp([[1.0]], [3.0], C=[[1.0], [1.0]], row_lower=[-np.inf, 1.0], row_upper=[0.0, np.inf])
    assert solution.status is QPStatus.INFEASIBLE
    np.testing.assert_allclose(solution.x, [0.5], atol=1e-9)


def test_bounds_of_variables_are_met_where_rows_are_not() -> None:
    """Four feet may press with 150 each: 1,000 is out of reach."""
    qp = with_row(contact_forces(0.3), np.tile([0.0, 0.0, 1.0], 4), 1000.0, np.inf)
    solution = qp.solve()
    check_certificate(qp, solution)
    assert (solution.x >= qp.lower).all()
    assert (solution.x <= qp.upper).all()
    np.testing.assert_allclose(solution.x[2::3], 150.0, atol=1e-6)


def test_equalities_that_contradict_each_other() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(3, 5))
    A[2] = A[0] + A[1]
    qp = replace(solvable(0), A=np.zeros((0, 0)), b=np.zeros(0))
    nothing = (np.zeros((0, 5)), np.zeros(0), np.zeros(0), np.full(5, -np.inf), np.full(5, np.inf))
    qp = QP(np.eye(5), np.ones(5), A, np.array([1.0, 2.0, 3.5]), *nothing)
    check_certificate(qp, qp.solve())
    consistent = replace(qp, b=np.array([1.0, 2.0, 3.0])).solve()
    assert consistent.status is QPStatus.SOLVED
    np.testing.assert_allclose(A @ consistent.x, [1.0, 2.0, 3.0], atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("rank", [0.0, 0.4])
def test_unbounded_problems_come_with_a_direction(rank: float, seed: int) -> None:
    """A direction without curvature is opened, and the cost falls along it."""
    qp, rng = solvable(seed + 20, rank=rank), np.random.default_rng(seed)
    null = scipy.linalg.null_space(np.vstack([qp.H, qp.A, np.zeros_like(qp.H)]))
    if not null.size:
        pytest.skip("no such direction")
    d = null @ rng.normal(size=null.shape[1])
    moved = qp.C @ d
    open_ = replace(
        qp,
        g=qp.g - d * (qp.g @ d + 0.3 * np.linalg.norm(qp.g) * np.linalg.norm(d)) / (d @ d),
        row_lower=np.where(moved < 0, -np.inf, qp.row_lower),
        row_upper=np.where(moved > 0, np.inf, qp.row_upper),
        lower=np.where(d < 0, -np.inf, qp.lower),
        upper=np.where(d > 0, np.inf, qp.upper),
    )
    s = open_.solve()
    assert s.status is QPStatus.UNBOUNDED
    assert s.certificate < 1e-7
    x = s.x / np.abs(s.x).max()
    slope = -open_.g @ x / np.abs(open_.g).max()
    assert slope > 0
    small = 1e-5 * slope
    assert np.abs(open_.H @ x).max() < small
    assert np.abs(open_.A @ x).max(initial=0.0) < small
    for t, low, high in ((open_.C @ x, open_.row_lower, open_.row_upper), (x, open_.lower, open_.upper)):
        assert (t[np.isfinite(low)] > -small).all()
        assert (t[np.isfinite(high)] < small).all()


def test_a_linear_cost_without_constraints_is_unbounded() -> None:
    assert solve_qp(np.zeros((2, 2)), [1.0, 0.0]).status is QPStatus.UNBOUNDED
    assert solve_qp(np.diag([1.0, 0.0]), [1.0, 0.0]).status is QPStatus.SOLVED
