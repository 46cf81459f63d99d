"""The damped model of the merit around an iterate: linear residuals, so convex and piecewise quadratic.

Its normal equations tie two neighbouring nodes and the final time, which all share, together: ordered node by node the
matrix is block-tridiagonal with a border. The band is factored by LAPACK's banded
Cholesky, the border goes through a Schur complement.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.linalg
from numpy import ndarray as Array

#: Newton iterations on the model before its best step so far is taken.
_ITERATIONS = 20


class NotPositiveDefinite(Exception):
    """The damped matrix is not positive definite; the caller raises the damping."""


class BorderedBand:
    """Where the unknowns sit, and how to solve their symmetric positive definite equations.

    An interval sees its unknowns as [left node (block), right node (block), the shared one]. Those not in `free`
    (nodes * block + 1,) get a zero step.
    """

    def __init__(self, nodes: int, block: int, free: Array) -> None:
        self.nodes, self.block, self.free = nodes, block, free
        self.length, self.local = nodes * block, 2 * block + 1
        starts = block * np.arange(nodes - 1)[:, None]
        self._columns = starts + np.arange(2 * block)
        row, column = self._lower = np.tril_indices(2 * block)
        self._band = (row - column) * self.length + starts + column
        self._seen = np.concatenate([self._columns, np.full((nodes - 1, 1), self.length)], axis=1)

    def gather(self, vector: Array) -> Array:
        """The unknowns every interval sees, (nodes - 1, local)."""
        return vector[self._seen]

    def scatter(self, local: Array) -> Array:
        """Sum of the intervals' contributions to every unknown; adjoint of `gather`."""
        return np.concatenate([self._summed(local[:, :-1]), local[:, -1:].sum(axis=0)])

    def solve(self, matrices: Array, damping: float, right: Array) -> Array:
        """The solution of (sum of the intervals' matrices + damping I) x = right over the free unknowns.

        Args:
            matrices: (nodes - 1, local, local), symmetric.
        Raises:
            NotPositiveDefinite: the damping is too small.
        """
        seen, length = self.free[self._seen], self.length
        matrices = matrices * (seen[:, :, None] & seen[:, None, :])
        diagonal = np.where(self.free, damping, 1.0)
        right = np.where(self.free, right, 0.0)
        size = 2 * self.block * length
        entries = np.bincount(self._band.ravel(), matrices[:, *self._lower].ravel(), minlength=size).reshape(-1, length)
        entries[0] += diagonal[:-1]
        border = self._summed(matrices[:, :-1, -1])[:, None]
        corner = matrices[:, -1:, -1:].sum(axis=0) + diagonal[-1]
        try:
            # The lower form: OpenBLAS starts threads for every column of the upper one, which a busy machine punishes.
            chol = scipy.linalg.cholesky_banded(entries, overwrite_ab=True, lower=True, check_finite=False)
            solved = scipy.linalg.cho_solve_banded((chol, True), border, check_finite=False)
            schur = scipy.linalg.cholesky(corner - border.T @ solved, lower=True)
        except (scipy.linalg.LinAlgError, ValueError) as error:
            raise NotPositiveDefinite(str(error)) from None
        inner = scipy.linalg.cho_solve_banded((chol, True), right[:-1], check_finite=False)
        tail = scipy.linalg.cho_solve((schur, True), right[-1:] - border.T @ inner, check_finite=False)
        return np.concatenate([inner - solved @ tail, tail])

    def _summed(self, local: Array) -> Array:
        return np.bincount(self._columns.ravel(), local.ravel(), minlength=self.length)


@dataclasses.dataclass(frozen=True)
class Model:
    """m(z) = b.z + z.B z / 2 + mu/2 sum over rows (r + J z)^2, where inequality rows count only while positive.

    Everything is given interval by interval and scaled.
    """

    band: BorderedBand  # where the unknowns sit
    start: Array  # (intervals, rows) r, zero where a row is not asked
    slopes: Array  # (intervals, rows, local) J
    equality: Array  # (rows,) which rows always count
    pull: Array  # (unknowns,) b
    bends: Array  # (intervals, local, local) B, positive semidefinite
    penalty: float  # mu

    def minimize(self, damping: float, largest: float) -> tuple[Array, float]:
        """The z that minimises m(z) + damping |z|^2 / 2, shortened to `largest` in any entry, and m(0) - m(z).

        Newton's method, each step with an exact search along it, until the rows that count stay the same.

        Raises:
            NotPositiveDefinite: the damping is too small for the arithmetic.
        """
        band, free = self.band, self.band.free
        step = np.zeros(len(self.pull))
        bent = np.zeros(len(self.pull))
        values = self.start
        counts = self._counts(values)
        for _ in range(_ITERATIONS):
            rows = np.einsum("kr,krl->kl", np.where(counts, values, 0.0), self.slopes)
            slope = np.where(free, self.pull + bent + self.penalty * band.scatter(rows) + damping * step, 0.0)
            seen = self.slopes * counts[:, :, None]
            matrices = self.bends + self.penalty * np.matmul(seen.transpose(0, 2, 1), self.slopes)
            move = band.solve(matrices, damping, -slope)
            local = band.gather(move)
            moves = np.einsum("krl,kl->kr", self.slopes, local)
            bent_moves = band.scatter(np.einsum("kab,kb->ka", self.bends, local))
            tilt = float((self.pull + bent + damping * step) @ move)
            share = self._search(values, moves, tilt, float((bent_moves + damping * move) @ move))
            step, values, bent = step + share * move, values + share * moves, bent + share * bent_moves
            before, counts = counts, self._counts(values)
            if share == 1.0 and (before == counts).all():
                break
        shrink = min(1.0, largest / max(float(np.abs(step).max()), 1e-300))
        step, bent, values = shrink * step, shrink * bent, self.start + shrink * (values - self.start)
        fall = self._half_squares(self.start) - self._half_squares(values)
        return step, fall - float((self.pull + 0.5 * bent) @ step)

    def _counts(self, values: Array) -> Array:
        return self.equality | (values > 0.0)

    def _half_squares(self, values: Array) -> float:
        return 0.5 * self.penalty * float((np.where(self._counts(values), values, 0.0) ** 2).sum())

    def _search(self, values: Array, moves: Array, tilt: float, bend: float) -> float:
        """The share in (0, 1] of a move at which the damped model is least; its slope grows along the move."""

        def slope(share: float) -> float:
            now = values + share * moves
            return tilt + share * bend + self.penalty * float((np.where(self._counts(now), now, 0.0) * moves).sum())

        if slope(1.0) <= 1e-12 * abs(slope(0.0)):
            return 1.0
        low, high = 0.0, 1.0
        while high - low > 1e-3 * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if slope(middle) < 0.0 else (low, middle)
        return high


class Smoothing:
    """A weighted sum of squares of the differences between neighbouring intervals' controls.

    `controls` is their slice within a block, `scales` (m,) are their sizes; `curvature` (intervals, local, local)
    is the second derivative.
    """

    def __init__(self, band: BorderedBand, controls: slice, scales: Array, weight: float) -> None:
        self._scales, self._weight = scales, weight
        one = np.eye(controls.stop - controls.start)
        #: (m, local) of an interval's unknowns: its controls are subtracted from the next one's.
        self._difference = np.zeros((len(one), band.local))
        self._difference[:, controls] = -one
        self._difference[:, band.block + controls.start : band.block + controls.stop] = one
        # The last interval has no control after it.
        paired = np.arange(band.nodes - 1) < band.nodes - 2
        self.curvature = weight * paired[:, None, None] * (self._difference.T @ self._difference)

    def value(self, us: Array) -> float:
        """The price of controls (intervals, m)."""
        return 0.5 * self._weight * float((self._steps(us) ** 2).sum())

    def gradient(self, us: Array) -> Array:
        """(intervals, local) first derivative."""
        steps = np.pad(self._steps(us), ((0, 1), (0, 0)))
        return self._weight * (steps @ self._difference)

    def _steps(self, us: Array) -> Array:
        return np.diff(us / self._scales, axis=0)
