"""Normal equations of a chain: every interval ties two neighbouring nodes and a few shared unknowns together.

Ordered node by node the matrix is block-tridiagonal with a border for the shared unknowns (the final time). The band is
factored by LAPACK's banded Cholesky, the border goes through a Schur complement.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from .arrays import Array

__all__ = ["Chain", "NotPositiveDefinite"]


class NotPositiveDefinite(Exception):
    """The damped matrix is not positive definite; the caller raises the damping."""


class Chain:
    """Where the unknowns of a chain sit, and how to solve its symmetric positive definite equations.

    An interval sees its unknowns as [left node (block), right node (block), shared].

    Args:
        nodes: number of nodes.
        block: unknowns of a node.
        shared: unknowns all intervals see.
        free: which unknowns may move, shape (nodes * block + shared,); the others get a zero step.
    """

    def __init__(self, nodes: int, block: int, shared: int, free: Array) -> None:
        self.nodes, self.block, self.shared = nodes, block, shared
        self.length = nodes * block
        self.local = 2 * block + shared
        self.free = free
        self._width = 2 * block - 1
        starts = block * np.arange(nodes - 1)
        self._columns = starts[:, None] + np.arange(2 * block)
        row, column = np.triu_indices(2 * block)
        self._upper = (row, column)
        self._band = (self._width + row - column) * self.length + starts[:, None] + column
        seen = np.concatenate([self._columns, np.broadcast_to(self.length + np.arange(shared), (nodes - 1, shared))], 1)
        self.seen_free = free[seen]

    def gather(self, vector: Array) -> Array:
        """The unknowns every interval sees, (nodes - 1, local)."""
        tail = np.broadcast_to(vector[self.length :], (self.nodes - 1, self.shared))
        return np.concatenate([vector[self._columns], tail], axis=1)

    def scatter(self, local: Array) -> Array:
        """Sum of the intervals' contributions to every unknown; adjoint of `gather`."""
        inner = 2 * self.block
        summed = np.bincount(self._columns.ravel(), local[:, :inner].ravel(), minlength=self.length)
        return np.concatenate([summed, local[:, inner:].sum(axis=0)])

    def solve(self, matrices: Array, damping: float, right: Array) -> Array:
        """Solve (sum of the intervals' matrices + damping I) y = right over the free unknowns.

        Args:
            matrices: (nodes - 1, local, local), symmetric.
            right: (nodes * block + shared,).
        Raises:
            NotPositiveDefinite: the damping is too small.
        """
        inner, free = 2 * self.block, self.free
        matrices = matrices * (self.seen_free[:, :, None] & self.seen_free[:, None, :])
        right = np.where(free, right, 0.0)
        diagonal = np.where(free, damping, 1.0)
        size = (self._width + 1) * self.length
        band = np.bincount(self._band.ravel(), matrices[:, *self._upper].ravel(), minlength=size)
        band = band.reshape(self._width + 1, self.length)
        band[-1] += diagonal[: self.length]
        border = np.stack([self._summed(matrices[:, :inner, inner + j]) for j in range(self.shared)] + [right[: self.length]], 1)
        corner = matrices[:, inner:, inner:].sum(axis=0) + np.diag(diagonal[self.length :])
        try:
            solved = scipy.linalg.solveh_banded(band, border, overwrite_ab=True, check_finite=False)
            schur = corner - border[:, :-1].T @ solved[:, :-1]
            tail = scipy.linalg.solve(schur, right[self.length :] - border[:, :-1].T @ solved[:, -1], assume_a="pos")
        except (scipy.linalg.LinAlgError, ValueError) as error:
            raise NotPositiveDefinite(str(error)) from None
        return np.concatenate([solved[:, -1] - solved[:, :-1] @ tail, tail])

    def _summed(self, local: Array) -> Array:
        return np.bincount(self._columns.ravel(), local.ravel(), minlength=self.length)
