"""Quadratic programs: random ones that have a solution, those of controllers, and the optimality conditions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from twistax.solver import QPSolution, solve_qp


@dataclass(frozen=True)
class QP:
    """minimise x'H x / 2 + g'x subject to A x = b, row_lower <= C x <= row_upper, lower <= x <= upper."""

    H: Array
    g: Array
    A: Array
    b: Array
    C: Array
    row_lower: Array
    row_upper: Array
    lower: Array
    upper: Array

    def solve(self, **keywords: Any) -> QPSolution:
        return solve_qp(**vars(self), **keywords)

    def in_units(self, d: Array, e: Array, f: Array, c: float) -> QP:
        """With x = d x', rows of A times e, rows of C times f, the cost times c."""
        return QP(
            *(c * self.H * d * d[:, None], c * self.g * d),
            *(e[:, None] * self.A * d, e * self.b),
            *(f[:, None] * self.C * d, f * self.row_lower, f * self.row_upper),
            *(self.lower / d, self.upper / d),
        )

    def permuted(self, of_x: Array, of_rows: Array) -> QP:
        return QP(
            *(self.H[np.ix_(of_x, of_x)], self.g[of_x], self.A[:, of_x], self.b),
            *(self.C[np.ix_(of_rows, of_x)], self.row_lower[of_rows], self.row_upper[of_rows]),
            *(self.lower[of_x], self.upper[of_x]),
        )

    def cost(self, x: Array) -> float:
        return float(x @ self.H @ x / 2 + self.g @ x)

    def errors(self, s: QPSolution) -> dict[str, float]:
        """Of the optimality conditions of the problem as stated, each over the size of its terms."""
        terms = np.array([self.H @ s.x, self.g, self.A.T @ s.y, self.C.T @ s.z, s.w])
        rows = [
            (self.A @ s.x, self.b, self.b, s.y, True),
            (self.C @ s.x, self.row_lower, self.row_upper, s.z, False),
            (s.x, self.lower, self.upper, s.w, False),
        ]
        size_x = 1 + max(np.abs(t).max(initial=0.0) for t, *_ in rows)
        size_z = 1 + max(np.abs(terms).max(), *(np.abs(z).max(initial=0.0) for *_, z, _ in rows))
        violation, complementarity = 0.0, 0.0
        for t, low, high, z, equality in rows:
            violation = max(violation, (low - t).max(initial=0.0), (t - high).max(initial=0.0))
            slack = np.where(z > 0, high - t, t - low)
            if not equality:
                complementarity = max(complementarity, np.minimum(np.abs(z) / size_z, slack / size_x).max(initial=0.0))
        stationarity = np.abs(terms.sum(0)).max() / size_z
        return {"stationarity": stationarity, "violation": violation / size_x, "complementarity": complementarity}


def some(rng: np.random.Generator, t: Array) -> tuple[Array, Array]:
    """Bounds around t: at t, near it, or none."""
    away = rng.exponential(size=(2, len(t))) * (rng.random((2, len(t))) < 0.6)
    kind = rng.integers(0, 4, len(t))
    return np.where(kind == 0, -np.inf, t - away[0]), np.where(kind == 1, np.inf, t + away[1])


def solvable(seed: int, *, rank: float = 1.0, dependent: bool = False, sparse: bool = False) -> QP:
    """A feasible problem whose cost is bounded: g is minus a combination of what the dual allows.

    Args:
        rank: of H, as a share of n; 0 for a linear program.
        dependent: rows repeat each other.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 25))
    ne, ni = int(rng.integers(0, max(1, n // 2))), int(rng.integers(0, 2 * n))
    F, x = rng.normal(size=(round(rank * n), n)), rng.normal(size=n)
    A, C = rng.normal(size=(ne, n)), rng.normal(size=(ni, n))
    if sparse:
        C *= rng.random(C.shape) < 0.4
    if dependent:
        C[ni // 2 :] = C[: ni - ni // 2] * rng.uniform(0.5, 2.0, size=(ni - ni // 2, 1))
        A[-1:] = 2 * A[:1]
    rows, bounds = some(rng, C @ x), some(rng, x)
    multipliers = [
        np.where(np.isfinite(high), rng.exponential(size=len(high)), 0)
        - np.where(np.isfinite(low), rng.exponential(size=len(low)), 0)
        for low, high in (rows, bounds)
    ]
    H = F.T @ F
    g = -(H @ rng.normal(size=n) + A.T @ rng.normal(size=ne) + C.T @ multipliers[0] + multipliers[1])
    return QP(H, g, A, A @ x, C, *rows, *bounds)


FAMILIES: dict[str, dict[str, Any]] = {
    "definite": {},
    "semidefinite": {"rank": 0.4},
    "linear": {"rank": 0.0},
    "dependent": {"dependent": True, "rank": 0.5},
    "linear_dependent": {"dependent": True, "rank": 0.0},
    "sparse": {"sparse": True},
}


def contact_forces(t: float = 0.0) -> QP:
    """Forces of four feet that come nearest to a wrench: friction pyramids, two feet in the air at some times."""
    feet = np.array([[0.2, 0.15, -0.3], [0.2, -0.15, -0.3], [-0.2, 0.15, -0.3], [-0.2, -0.15, -0.3]])
    moments = [np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) for x, y, z in feet + 0.02 * np.sin(3 * t)]
    W = np.vstack([np.hstack([np.eye(3)] * 4), np.hstack(moments)])
    wrench = [60 * np.sin(6 * t), 40 * np.sin(5 * t + 1), 120 + 60 * np.sin(9 * t)]
    wrench += [10 * np.sin(7 * t), 12 * np.sin(8 * t), 5 * np.sin(3 * t)]
    weight = np.diag([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])
    C = np.kron(np.eye(4), [[1, 0, -0.6], [-1, 0, -0.6], [0, 1, -0.6], [0, -1, -0.6]])
    lower, upper = np.full(12, -np.inf), np.full(12, np.inf)
    lower[2::3], upper[2::3] = 5.0, 150.0
    if np.sin(12 * t) > 0:
        lower[3:9] = upper[3:9] = 0.0
    H, g = W.T @ weight @ W + 1e-4 * np.eye(12), -W.T @ weight @ np.array(wrench)
    return QP(H, g, np.zeros((0, 12)), np.zeros(0), C, np.full(16, -np.inf), np.zeros(16), lower, upper)


def with_row(qp: QP, row: Array, low: float, high: float) -> QP:
    added = {"C": np.vstack([qp.C, row]), "row_lower": [*qp.row_lower, low], "row_upper": [*qp.row_upper, high]}
    return replace(qp, **{name: np.asarray(value, float) for name, value in added.items()})
