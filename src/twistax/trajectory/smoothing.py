"""The small price on steps of the controls: half of sum |u_(k+1) - u_k|^2, in scaled controls."""

from __future__ import annotations

import numpy as np

from .arrays import Array
from .banded import Chain

__all__ = ["Smoothing"]


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
