"""The report of published optima: a problem of it, and what its ratios leave out."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import twistax as tx
from twistax.report.harness.expected import Absent
from twistax.report.registry import OPTIMAL
from twistax.report.sections import optimal, problems


def test_every_problem_is_asked_the_same() -> None:
    whats = {check.what for check in OPTIMAL["published"]}
    assert whats == {check.what for check in OPTIMAL["solvers"]} == set(optimal.PROBLEMS)
    assert len(OPTIMAL["solvers"]) == 6 * len(optimal.PROBLEMS)


def test_refined_meshes_are_asked_for_a_millionth_where_digits_are_published() -> None:
    assert {check.what for check in OPTIMAL["refined"]} == set(optimal.KNOWN)
    assert len(OPTIMAL["refined"]) == 5 * len(optimal.KNOWN)
    for name, known in optimal.KNOWN.items():
        # Goddard's climb is published to five decimals; the landing has no optimum of others.
        assert known.bar <= (5e-6 if name.startswith("Goddard") else 1e-6) or "landing" in name


def test_a_convex_problem_is_reached_from_every_start() -> None:
    (name,) = (name for name in optimal.PROBLEMS if name.startswith("Bryson"))
    rows = {check.by: check.run() for check in OPTIMAL["published"] if check.what == name}
    assert rows["apart"].holds
    # A mesh of held controls costs more than the exact 4.
    assert rows["apart"].value > 0.0
    assert rows["starts that reach it, of 8"].value == 8.0


def test_control_loops_are_those_that_casadi_has() -> None:
    pytest.importorskip("casadi")
    checks = [check for check in OPTIMAL["controllers"] if not isinstance(check, str)]
    rows = [check.run() for check in checks if check.by.startswith("optimal costs")]
    assert len(rows) == 2
    assert all(row.holds for row in rows)


def test_ratios_are_over_what_both_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    class Result:
        def __init__(self, cost: float, iterations: int) -> None:
            self.cost, self.iterations = cost, iterations

    found = {("one", "twistax"): Result(1.0, 10), ("one", "IPOPT"): Result(1.0, 20)}
    found |= {("elsewhere", "twistax"): Result(1.0, 90), ("elsewhere", "IPOPT"): Result(2.0, 1)}

    def timed(name: str, by: str) -> Result:
        if (name, by) not in found:
            raise Absent("ends in STALLED")
        return found[name, by]

    monkeypatch.setattr(optimal, "_timed", timed)
    monkeypatch.setattr(optimal, "PROBLEMS", dict.fromkeys(["one", "elsewhere", "unsolved"]))
    assert math.isclose(optimal._ratios(optimal._iterations, max), 0.5)
    found.clear()
    with pytest.raises(Absent, match="none"):
        optimal._ratios(optimal._iterations, max)


def test_what_hangs_has_a_limit_and_what_is_timed_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first solve is of the solver with a limit; what is slow, or not SOLVED, is not repeated in vain."""
    asked: list[float | None] = []

    class Problem:
        def solve(self, solver: tx.trajectory.IPOPT) -> tx.trajectory.TrajectoryResult:
            asked.append(solver.max_seconds)
            result = object.__new__(tx.trajectory.TrajectoryResult)
            vars(result).update(status=status, solve_seconds=1.0)
            return result

    monkeypatch.setattr(optimal, "PROBLEMS", {name: SimpleNamespace(problem=Problem()) for name in ("ends", "hangs")})
    status = tx.trajectory.Status.SOLVED
    optimal._timed("ends", "IPOPT")
    assert asked == [optimal._LONGEST, *[None] * optimal._REPEATS]
    status = tx.trajectory.Status.OUT_OF_TIME
    for _ in range(2):
        with pytest.raises(Absent, match="ends in OUT_OF_TIME"):
            optimal._timed("hangs", "IPOPT")
    assert asked[1 + optimal._REPEATS :] == [optimal._LONGEST]


def test_the_half_turn_with_five_switches() -> None:
    """By SciPy, in quaternions: these arcs, each with every torque at a limit, end at rest after a half turn."""
    a, b = problems.FIVE_SWITCHES
    signs = [(1, 1, 1), (-1, 1, 1), (-1, -1, 1), (-1, -1, -1), (1, -1, -1), (1, 1, -1)]
    y = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for torque, length in zip(signs, (a, b, a, a, b, a), strict=True):

        def rate(_: float, y: np.ndarray, torque: tuple[int, ...] = torque) -> np.ndarray:
            v, w = y[1:4], y[4:]
            return np.concatenate([[-0.5 * v @ w], 0.5 * (y[0] * w + np.cross(v, w)), torque])

        y = solve_ivp(rate, (0.0, length), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(np.delete(y, 3), 0.0, atol=1e-12)
