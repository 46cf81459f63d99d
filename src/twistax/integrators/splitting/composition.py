"""The data of a symmetric composition, checked when it is made."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...errors import ModelError
from ..coefficients import coefficients

__all__ = ["Composition"]

#: Weights are given in double precision; sums of them may be off by a few units in the last place.
_TOLERANCE = 1e-14


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Composition:
    """A symmetric composition of a symmetric method of order 2: its steps of length w_1 h, ..., w_s h in a row.

    The order is that of the whole. Some weights are negative from order 4 on: steps back in time.

    Attributes:
        name: how tables call it.
        order: 2, 4, 6, ...
        weights: (s,), read-only: the same read backwards; they sum to 1, and from order 4 on their cubes, from order 6
            on also their fifth powers and so on, sum to 0.

    Raises:
        ModelError: another order, a wrong shape, a value that is not finite, or a sum that is off.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section V.3.
    """

    name: str
    order: int
    weights: Any

    def __post_init__(self) -> None:
        if not isinstance(self.order, int) or self.order < 2 or self.order % 2:
            raise self._error(f"order must be an even whole number, got {self.order!r}")
        weights = coefficients("weights", self.weights, self._error)
        if weights.ndim != 1 or not weights.size:
            raise self._error(f"weights must have shape (s,), got {weights.shape}")
        if not np.array_equal(weights, weights[::-1]):
            raise self._error("weights must read the same backwards")
        for power in range(1, self.order, 2):
            wanted = 1.0 if power == 1 else 0.0
            total = (weights**power).sum()
            if abs(total - wanted) > _TOLERANCE * np.abs(weights**power).sum():
                what = "weights" if power == 1 else f"powers {power} of the weights"
                raise self._error(f"{what} must sum to {wanted:g} for order {self.order}, they sum to {total:.16g}")
        object.__setattr__(self, "weights", weights)

    @property
    def stages(self) -> int:
        """s, the number of weights."""
        return int(self.weights.size)

    @property
    def nodes(self) -> np.ndarray:
        """The middles of the stages, in steps: where forces act."""
        return np.cumsum(self.weights) - 0.5 * self.weights

    @property
    def between(self) -> np.ndarray:
        """(s + 1,): how far it is to the first node, from one to the next, and from the last to the end, in steps."""
        return 0.5 * (np.append(0.0, self.weights) + np.append(self.weights, 0.0))

    def __repr__(self) -> str:
        return f"Composition({self.name}, order {self.order}, {self.stages} stages)"

    def _error(self, sentence: str) -> ModelError:
        return ModelError(f"composition {self.name!r}: {sentence}")
