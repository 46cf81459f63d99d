"""Normal equations of a chain: every interval ties two neighbouring nodes and a few shared unknowns together.

Ordered node by node the matrix is block-tridiagonal with a border for the shared unknowns (the final time). The band is
factored by LAPACK's banded Cholesky, the border goes through a Schur complement.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.linalg
from numpy import ndarray as Array

__all__ = ["Chain", "Factor", "NotPositiveDefinite"]


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
        row, column = np.tril_indices(2 * block)
        self._lower = (row, column)
        self._band = (row - column) * self.length + starts[:, None] + column
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

    def factor(self, matrices: Array, damping: float) -> Factor:
        """Factor (sum of the intervals' matrices + damping I) over the free unknowns.

        Args:
            matrices: (nodes - 1, local, local), symmetric.
        Raises:
            NotPositiveDefinite: the damping is too small.
        """
        inner, free = 2 * self.block, self.free
        matrices = matrices * (self.seen_free[:, :, None] & self.seen_free[:, None, :])
        diagonal = np.where(free, damping, 1.0)
        size = (self._width + 1) * self.length
        band = np.bincount(self._band.ravel(), matrices[:, *self._lower].ravel(), minlength=size)
        band = band.reshape(self._width + 1, self.length)
        band[0] += diagonal[: self.length]
        border = np.stack([self._summed(matrices[:, :inner, inner + j]) for j in range(self.shared)], axis=1)
        corner = matrices[:, inner:, inner:].sum(axis=0) + np.diag(diagonal[self.length :])
        try:
            # The lower form: OpenBLAS starts threads for every column of the upper one, which a busy machine punishes.
            chol = scipy.linalg.cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
            solved = scipy.linalg.cho_solve_banded((chol, True), border, check_finite=False)
            schur = scipy.linalg.cholesky(corner - border.T @ solved, lower=True)
        except (scipy.linalg.LinAlgError, ValueError) as error:
            raise NotPositiveDefinite(str(error)) from None
        return Factor(chol, border, solved, schur, free)

    def _summed(self, local: Array) -> Array:
        return np.bincount(self._columns.ravel(), local.ravel(), minlength=self.length)


@dataclasses.dataclass(frozen=True)
class Factor:
    """A factored matrix of a `Chain`: the band's Cholesky factor, the border, and the Schur complement's factor."""

    band: Array
    border: Array
    solved: Array
    schur: Array
    free: Array

    def solve(self, right: Array) -> Array:
        """The solution for a right-hand side (nodes * block + shared,); zero for unknowns that are not free."""
        right = np.where(self.free, right, 0.0)
        length = len(self.border)
        inner = scipy.linalg.cho_solve_banded((self.band, True), right[:length], check_finite=False)
        tail = scipy.linalg.cho_solve((self.schur, True), right[length:] - self.border.T @ inner, check_finite=False)
        return np.concatenate([inner - self.solved @ tail, tail])
