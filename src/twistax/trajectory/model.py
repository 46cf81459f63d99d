"""The damped model of the merit around an iterate: linear residuals, so convex and piecewise quadratic.

And the small price on steps of the controls that the merit holds: half of sum |u_(k+1) - u_k|^2, in scaled controls.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy import ndarray as Array

from .banded import Chain

__all__ = ["Model", "Smoothing"]

#: Newton iterations on the model before its best step so far is taken.
_ITERATIONS = 20


@dataclasses.dataclass(frozen=True)
class Model:
    """m(z) = b.z + z.B z / 2 + mu/2 sum over rows (r + J z)^2, where inequality rows count only while positive.

    Everything is given interval by interval and scaled.

    Attributes:
        chain: where the unknowns sit.
        start: (intervals, rows) r, zero where a row is not asked.
        slopes: (intervals, rows, local) J.
        equality: (rows,) which rows always count.
        pull: (unknowns,) b.
        bends: (intervals, local, local) B, positive semidefinite.
        penalty: mu.
    """

    chain: Chain
    start: Array
    slopes: Array
    equality: Array
    pull: Array
    bends: Array
    penalty: float

    def minimize(self, damping: float, largest: float) -> tuple[Array, float]:
        """The z that minimises m(z) + damping |z|^2 / 2, shortened to `largest` in any entry, and m(0) - m(z).

        Newton's method, each step with an exact search along it, until the rows that count stay the same.

        Raises:
            NotPositiveDefinite: the damping is too small for the arithmetic.
        """
        chain, free = self.chain, self.chain.free
        step = np.zeros(len(self.pull))
        bent = np.zeros(len(self.pull))
        values = self.start
        counts = self._counts(values)
        for _ in range(_ITERATIONS):
            rows = np.einsum("kr,krl->kl", np.where(counts, values, 0.0), self.slopes)
            slope = np.where(free, self.pull + bent + self.penalty * chain.scatter(rows) + damping * step, 0.0)
            seen = self.slopes * counts[:, :, None]
            matrices = self.bends + self.penalty * np.matmul(seen.transpose(0, 2, 1), self.slopes)
            move = chain.factor(matrices, damping).solve(-slope)
            local = chain.gather(move)
            moves = np.einsum("krl,kl->kr", self.slopes, local)
            bent_moves = chain.scatter(np.einsum("kab,kb->ka", self.bends, local))
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

    Args:
        chain: where unknowns sit.
        controls: the slice of the controls within a node's block.
        scales: (m,) sizes of the controls.
        weight: of the whole.

    Attributes:
        curvature: (intervals, local, local) second derivative.
    """

    def __init__(self, chain: Chain, controls: slice, scales: Array, weight: float) -> None:
        self._chain, self._controls, self._scales, self._weight = chain, controls, scales, weight
        self._next = slice(chain.block + controls.start, chain.block + controls.stop)
        difference = np.zeros((controls.stop - controls.start, chain.local))
        difference[:, controls] = -np.eye(len(difference))
        difference[:, self._next] = np.eye(len(difference))
        # The last interval has no control after it.
        paired = np.arange(chain.nodes - 1) < chain.nodes - 2
        self.curvature = weight * paired[:, None, None] * (difference.T @ difference)

    def value(self, us: Array) -> float:
        """The price of controls (intervals, m)."""
        return 0.5 * self._weight * float((self._steps(us) ** 2).sum())

    def gradient(self, us: Array) -> Array:
        """(intervals, local) first derivative."""
        pull = np.zeros((self._chain.nodes - 1, self._chain.local))
        steps = self._weight * self._steps(us)
        pull[:-1, self._controls] = -steps
        pull[:-1, self._next] = steps
        return pull

    def _steps(self, us: Array) -> Array:
        return np.diff(us / self._scales, axis=0)
