"""Weighted least squares for data that may not determine all directions: the determined combinations and their
covariance.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Singular values below this fraction of the largest one are round-off.
_ROUNDING = 1e-10
#: Coefficients below this value are round-off.
ZERO = 1e-7


@dataclasses.dataclass(frozen=True)
class LeastSquaresSolution:
    """The least squares solution of $A x = y$ with noise of unit variance.

    Attributes:
        combinations: D (r, b): the data determine D x. Its columns `pivots` form the identity matrix.
        values: the values of D x, (r,).
        covariance: the covariance of the values, (r, r).
        pivots: for each combination, the index of a column that only this combination contains.
        left: the other columns: for any values of these unknowns, some x fits the data with the same D x.
        residuals: $y - A x$, (N,), for the x of minimum norm.
    """

    combinations: Array
    values: Array
    covariance: Array
    pivots: tuple[int, ...]
    left: tuple[int, ...]
    residuals: Array


def determined(A: Array, y: Array, tolerance: float) -> LeastSquaresSolution:
    """The solution of $A x = y$ in the directions whose standard deviation is at most the tolerance.

    Unknowns that are determined individually are returned as they are. For the others, the information matrix is that
    of the lower right block R of a QR decomposition; the right singular vectors of R with singular values of at least 1
    / tolerance span the determined directions. Reduced echelon form makes them sums of few unknowns.

    Args:
        A: (N, b), in units of the noise, with unknowns as fractions of their sizes.
        y: (N,), in units of the noise.
        tolerance: ().
    """
    from scipy.linalg import qr, solve_triangular  # imported here because the import takes 50 ms

    b = A.shape[1]
    all_rows = np.vstack([np.column_stack([A, y]), np.zeros((max(b + 1 - len(A), 0), b + 1))])
    small: Array = np.asarray(np.linalg.qr(all_rows, mode="r"))  # as many rows as columns
    single = _deviations(small[:, :b]) <= tolerance
    order, p = np.concatenate([np.flatnonzero(single), np.flatnonzero(~single)]), int(single.sum())
    R: Array = np.asarray(np.linalg.qr(small[:, [*order, b]], mode="r"))
    R, c = R[:b, :b], R[:b, b]
    U, s, Vt = np.linalg.svd(R[p:, p:])
    seen = s > _ROUNDING * (np.abs(R).max(initial=0.0) + np.finfo(float).tiny)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=seen)
    well = seen & (s * tolerance >= 1.0)
    # Estimates are E c: of x[:p], and of the other directions.
    E = np.zeros((b, b))
    inverse_R = (Vt.T * inverse) @ U.T
    E[:p, :p] = solve_triangular(R[:p, :p], np.eye(p))
    E[:p, p:] = -E[:p, :p] @ R[:p, p:] @ inverse_R
    E[p:, p:] = inverse[:, None] * U.T
    x = np.zeros(b)
    x[order] = np.concatenate([E[:p] @ c, inverse_R @ c[p:]])
    E = E[np.concatenate([np.ones(p, dtype=bool), well])]
    rows = Vt[well]
    pivots = np.sort(qr(rows, mode="r", pivoting=True)[1][: len(rows)]) if len(rows) else np.zeros(0, dtype=int)
    T = np.linalg.inv(rows[:, pivots])
    D = np.zeros((len(E), b))
    D[:p, :p], D[p:, p:] = np.eye(p), T @ rows
    E[p:] = T @ E[p:]
    at = np.concatenate([np.arange(p), p + pivots])
    D[:, at] = np.eye(len(D))
    D[np.abs(D) < ZERO] = 0.0
    begin = order[at]
    first = np.argsort(begin)
    D, E = D[:, np.argsort(order)][first], E[first]
    left = np.setdiff1d(np.arange(b), begin)
    return LeastSquaresSolution(D, E @ c, E @ E.T, tuple(begin[first].tolist()), tuple(left.tolist()), y - A @ x)


def _deviations(A: Array) -> Array:
    """The standard deviation (b,) of each unknown if all others are unknown too; infinite if it is not determined."""
    _, s, Vt = np.linalg.svd(A, full_matrices=False)
    seen = s > _ROUNDING * s.max(initial=0.0)
    known = np.sqrt(np.sum((Vt[seen] / s[seen, None]) ** 2, axis=0))
    return np.where(np.linalg.norm(Vt[~seen], axis=0) > _ROUNDING**0.5, np.inf, known)
