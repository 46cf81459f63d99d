"""The dense quadratic program: optimality conditions by other arithmetic, solvers of SciPy, and known answers."""

import threading
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from qp_problems import FAMILIES, QP, contact_forces, solvable, with_row

import twistax as tx
from twistax.solver import QPOptions, QPSolution, QPStatus, solve_qp


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", range(12))
def test_solutions_satisfy_the_optimality_conditions(family: str, seed: int) -> None:
    qp = solvable(seed, **FAMILIES[family])
    solution = qp.solve()
    assert solution.status is QPStatus.SOLVED
    assert max(qp.errors(solution).values()) < 1e-11
    assert solution.error <= QPOptions().tolerance
    assert solution.cost == pytest.approx(qp.cost(solution.x), rel=1e-12)
    assert (solution.x >= qp.lower).all()
    assert (solution.x <= qp.upper).all()


@pytest.mark.parametrize("seed", range(12))
def test_linear_programs_have_the_cost_of_highs(seed: int) -> None:
    qp = solvable(seed, rank=0.0, dependent=seed % 2 == 0)
    low, high = np.isfinite(qp.row_lower), np.isfinite(qp.row_upper)
    expected = scipy.optimize.linprog(
        qp.g,
        A_ub=np.vstack([qp.C[high], -qp.C[low]]),
        b_ub=np.concatenate([qp.row_upper[high], -qp.row_lower[low]]),
        A_eq=qp.A,
        b_eq=qp.b,
        bounds=np.stack([qp.lower, qp.upper], axis=1),
    )
    assert expected.status == 0
    assert qp.solve().cost == pytest.approx(expected.fun, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("time", [0.0, 0.05, 0.3])
def test_contact_forces_are_those_of_slsqp(time: float) -> None:
    qp = contact_forces(time)
    expected = scipy.optimize.minimize(
        lambda x: qp.cost(x) / 1e3,
        np.full(12, 10.0) * (qp.upper > 0),
        jac=lambda x: (qp.H @ x + qp.g) / 1e3,
        bounds=np.stack([qp.lower, qp.upper], axis=1),
        constraints={"type": "ineq", "fun": lambda x: qp.row_upper - qp.C @ x, "jac": lambda x: -qp.C},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 1000},
    )
    solution = qp.solve()
    assert solution.status is QPStatus.SOLVED
    np.testing.assert_allclose(solution.x, expected.x, atol=0.1)  # forces against each other cost 1e-4
    assert qp.cost(expected.x) - 1e-3 < solution.cost <= qp.cost(expected.x) + 1e-6


def test_a_projection_onto_the_simplex_is_known() -> None:
    """The point (0.6, 0.3, -0.4) becomes (0.65, 0.35, 0)."""
    solution = solve_qp(np.eye(3), [-0.6, -0.3, 0.4], A=np.ones((1, 3)), b=[1.0], lower=np.zeros(3))
    np.testing.assert_allclose(solution.x, [0.65, 0.35, 0.0], atol=1e-14)
    np.testing.assert_allclose(solution.y, [-0.05], atol=1e-14)
    np.testing.assert_allclose(solution.w, [0.0, 0.0, -0.35], atol=1e-14)


def test_without_constraints() -> None:
    solution = solve_qp([[2.0, 1.0], [1.0, 3.0]], [-1.0, 2.0])
    np.testing.assert_allclose(solution.x, np.linalg.solve([[2.0, 1.0], [1.0, 3.0]], [1.0, -2.0]), rtol=1e-14)


def test_equal_bounds_fix_variables_and_rows() -> None:
    C, fixed = np.array([[1.0, 1.0, 1.0, 0.0]]), [-np.inf, 2.0, -np.inf, -1.0]
    solution = solve_qp(
        np.eye(4), np.zeros(4), C=C, row_lower=[3.0], row_upper=[3.0], lower=fixed, upper=[np.inf, 2.0, np.inf, -1.0]
    )
    np.testing.assert_allclose(solution.x, [0.5, 2.0, 0.5, -1.0], atol=1e-14)
    assert solution.x[1] == 2.0
    assert solution.x[3] == -1.0


def test_bounds_that_are_far_away_are_no_bounds() -> None:
    near = solve_qp(np.eye(2), [-1.0, -2.0], C=[[1.0, 1.0]], row_upper=[2.0])
    far = solve_qp(
        np.eye(2), [-1.0, -2.0], None, None, [[1.0, 1.0]], [-1e20], [2.0], lower=[-1e12] * 2, upper=[1e15] * 2
    )
    assert far.status is near.status is QPStatus.SOLVED
    assert near.iterations <= 4 >= far.iterations
    np.testing.assert_allclose(far.x, near.x, atol=1e-13)


def test_a_face_of_solutions_of_a_linear_program() -> None:
    solution = solve_qp(np.zeros((2, 2)), [-1.0, -1.0], C=[[1.0, 1.0]], row_upper=[1.0], lower=[0.0, 0.0])
    assert solution.status is QPStatus.SOLVED
    assert solution.cost == pytest.approx(-1.0, abs=1e-13)


def test_bounds_alone_in_any_units() -> None:
    lower = np.array([-1e-7, -3e4, 2e9, -1.0])
    solution = solve_qp(np.zeros((4, 4)), [2e5, 1e-3, 1e-9, 1.0], lower=lower)
    assert solution.status is QPStatus.SOLVED
    np.testing.assert_array_equal(solution.x, lower)


def test_a_cost_that_vanishes_at_the_solution() -> None:
    """All that errors of the gradient could be compared with is 0 there."""
    n = 12
    H, A = np.diag(np.arange(n) % 3.0), np.random.default_rng(1).normal(size=(3, n))
    x = np.where(np.arange(n) % 3 == 0, np.linspace(-1, 1, n), 0.0)
    solution = solve_qp(H, np.zeros(n), A, A @ x, lower=np.full(n, -2.0), upper=np.full(n, 1.5))
    assert solution.status is QPStatus.SOLVED
    assert solution.iterations <= 12
    assert solution.cost == pytest.approx(0.0, abs=1e-15)


def test_a_feasible_set_without_interior() -> None:
    """Two rows leave one value of x_0 + x_1, and bounds one of x_0."""
    C = [[1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]
    solution = solve_qp(np.eye(3), [1.0, 2.0, 3.0], C=C, row_upper=[1.0, -1.0, 0.25, -0.5])
    assert solution.status is QPStatus.SOLVED
    np.testing.assert_allclose(solution.x, [0.25, 0.75, -3.0], atol=1e-12)


# ---- units, order ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("decades", [3, 6])
def test_units_change_nothing(family: str, decades: int) -> None:
    """Units of each variable, of each row and of the cost."""
    for seed in range(8):
        qp, rng = solvable(seed, **FAMILIES[family]), np.random.default_rng(seed)
        d, e, f, c = (10.0 ** rng.uniform(-decades, decades, size) for size in (*qp.A.shape[::-1], len(qp.C), 1))
        usual, scaled = qp.solve(), qp.in_units(d, e, f, float(c[0])).solve()
        assert scaled.status is QPStatus.SOLVED
        assert qp.cost(d * scaled.x) == pytest.approx(usual.cost, rel=1e-8, abs=1e-8)
        in_first_units = {"x": d * scaled.x, "y": scaled.y * e / c, "z": scaled.z * f / c, "w": scaled.w / (d * c)}
        assert max(qp.errors(replace(scaled, **in_first_units)).values()) < 1e-8
        if family == "definite":
            np.testing.assert_allclose(d * scaled.x, usual.x, atol=1e-8)
        assert scaled.iterations <= 2 * usual.iterations + 4


@pytest.mark.parametrize("size", [1e-150, 1e-12, 1e12, 1e150])
def test_small_and_large_numbers(size: float) -> None:
    """The solution is proportional to g and to bounds."""
    qp = contact_forces(0.05)
    g, lower, upper = qp.g * size, qp.lower * size, qp.upper * size
    solution = replace(qp, g=g, lower=lower, upper=upper, row_upper=qp.row_upper * size).solve()
    assert solution.status is QPStatus.SOLVED
    np.testing.assert_allclose(solution.x / size, qp.solve().x, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_order_changes_nothing(seed: int) -> None:
    qp, rng = solvable(seed), np.random.default_rng(seed)
    of_x, of_rows = rng.permutation(len(qp.g)), rng.permutation(len(qp.C))
    np.testing.assert_allclose(qp.permuted(of_x, of_rows).solve().x, qp.solve().x[of_x], atol=1e-11)


# ---- warm starts, threads, limits ------------------------------------------------------------------------------------


def test_a_warm_start_ends_at_once() -> None:
    for seed in range(8):
        qp = solvable(seed)
        cold = qp.solve()
        warm = qp.solve(warm=cold)
        assert warm.status is QPStatus.SOLVED
        assert warm.iterations == warm.changes == 0 < cold.iterations
        np.testing.assert_allclose(warm.x, cold.x, atol=1e-12)


def test_a_controller_needs_no_interior_point_after_its_first_solve() -> None:
    """The result is that of a cold solve at every step, feet on and off the ground."""
    previous, interior_points = None, 0
    for step in range(150):
        qp = contact_forces(0.003 * step)
        previous = qp.solve(warm=previous)
        interior_points += previous.iterations > 0
        np.testing.assert_allclose(previous.x, qp.solve().x, atol=1e-10)
    assert interior_points <= 5


def test_a_warm_start_of_another_problem_does_no_harm() -> None:
    qp = solvable(3)
    other = replace(solvable(3), g=-5 * qp.g).solve()
    bad = replace(other, x=np.full_like(other.x, np.nan), scales=np.zeros_like(other.scales))
    for warm in (other, bad):
        np.testing.assert_allclose(qp.solve(warm=warm).x, qp.solve().x, atol=1e-11)


def test_threads_solve_side_by_side() -> None:
    problems = [solvable(seed) for seed in range(4)]
    alone = [qp.solve().x for qp in problems]
    together: dict[int, list[np.ndarray]] = {}

    def run(index: int) -> None:
        together[index] = [problems[index].solve().x for _ in range(100)]

    threads = [threading.Thread(target=run, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for index, expected in enumerate(alone):
        for x in together[index]:
            np.testing.assert_array_equal(x, expected)


@pytest.mark.parametrize("leftover", [np.nan, 1e300, -1.0])
def test_what_the_memory_held_before_changes_nothing(leftover: float, monkeypatch: pytest.MonkeyPatch) -> None:
    problems = [solvable(seed, **options) for seed in range(6) for options in FAMILIES.values()]
    problems.append(with_row(contact_forces(0.3), np.tile([0.0, 0.0, 1.0], 4), 1000.0, np.inf))
    usual = [qp.solve() for qp in problems]
    monkeypatch.setattr("twistax.solver.qp.np.empty", lambda size: np.full(size, leftover))
    for qp, expected in zip(problems, usual, strict=True):
        np.testing.assert_array_equal(values_of(qp.solve()), values_of(expected))


def values_of(solution: QPSolution) -> np.ndarray:
    return np.concatenate([solution.x, solution.y, solution.z, solution.w])


def test_the_count_of_iterations_is_limited() -> None:
    qp = solvable(1)
    options = QPOptions(iterations=1.0, finish_changes=0.0)
    solution = qp.solve(options=options)
    assert solution.status is QPStatus.MAX_ITERATIONS
    assert np.isfinite(solution.x).all()
    assert solution.error > 1e-9


# ---- bad input -------------------------------------------------------------------------------------------------------

ONES = np.ones(2)
GOOD = QP(np.eye(2), ONES, ONES[None], ONES[:1], np.eye(2), -ONES, ONES, -ONES, ONES)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("H", [[1.0, np.nan], [np.nan, 1.0]], r"H expects finite numbers, got nan at \[0, 1\]"),
        ("H", [[1.0, 2.0], [0.0, 1.0]], r"H expects a symmetric matrix, got 2.0 at \[0, 1\] and 0.0"),
        ("H", np.eye(3), r"H expects shape \(2, 2\), got \(3, 3\)"),
        ("g", [1.0, np.inf], r"g expects finite numbers, got inf at \[1\]"),
        ("g", [], r"g expects shape \(n,\)"),
        ("g", ["a", "b"], "g expects real numbers"),
        ("A", [[np.inf, 1.0]], "A expects finite numbers"),
        ("A", [[1.0, 1.0, 1.0]], r"A expects shape \(1, 2\)"),
        ("b", [np.nan], "b expects finite numbers"),
        ("b", None, "b expects shape .* got None"),
        ("C", [[1.0, np.nan], [0.0, 1.0]], "C expects finite numbers"),
        ("row_lower", [np.nan, 0.0], "row_lower expects numbers or infinities"),
        ("row_upper", [0.0], r"row_upper expects shape \(2,\)"),
        ("row_upper", [-2.0, 0.0], r"row_lower <= row_upper, got -1.0 and -2.0 at \[0\]"),
        ("lower", [0.0, 2.0], r"lower <= upper, got 2.0 and 1.0 at \[1\]"),
        ("upper", [np.nan, 0.0], "upper expects numbers or infinities"),
        ("lower", [np.inf, 0.0], "lower <= upper"),
    ],
)
def test_bad_data_are_named(name: str, value: object, message: str) -> None:
    with pytest.raises(tx.InputError, match=message):
        solve_qp(**(vars(GOOD) | {name: value}))


def test_a_warm_start_of_other_shapes_is_refused() -> None:
    with pytest.raises(tx.InputError, match=r"warm.x expects shape \(2,\)"):
        GOOD.solve(warm=solvable(0).solve())


@pytest.mark.parametrize("H", [[[1.0, 2.0], [2.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]])
def test_a_cost_that_is_not_convex_is_refused(H: list[list[float]]) -> None:
    solution = solve_qp(H, [1.0, 1.0], lower=[-1.0, -1.0], upper=[1.0, 1.0])
    assert solution.status is QPStatus.NOT_CONVEX
    np.testing.assert_array_equal(solution.x, 0.0)


@pytest.mark.parametrize("seed", [0, 5, 7, 12])
def test_little_curvature_along_the_rows_takes_few_steps(seed: int) -> None:
    """The weights of rows round by more than the curvature of a millionth: once 42 steps, or a false UNBOUNDED."""
    rng = np.random.default_rng(seed)
    J = np.diag([30.0, 10.0]) @ rng.normal(size=(2, 20))
    H, g = J.T @ J + 10.0 ** (-2 - seed % 5) * np.eye(20), rng.normal(size=20)
    A, b = rng.normal(size=(6, 20)), 0.01 * rng.normal(size=6)
    solution = solve_qp(H, g, A, b)
    assert solution.status is QPStatus.SOLVED
    assert solution.iterations <= 3
    null = np.linalg.svd(A)[2][6:].T
    start = np.linalg.pinv(A) @ b
    exact = start - null @ np.linalg.solve(null.T @ H @ null, null.T @ (g + H @ start))
    np.testing.assert_allclose(solution.x, exact, rtol=0.0, atol=1e-6 * np.abs(exact).max())
