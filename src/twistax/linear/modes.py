"""The modes of a linear system."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..checks import reals
from ..errors import ModelError


@dataclasses.dataclass(frozen=True)
class Mode:
    """A mode of a linear system: the motion $d(t) = Re(shape e^(eigenvalue t))$.

    Attributes:
        eigenvalue: in 1/s; of a complex pair, the one with Im > 0.
        shape: the eigenvector by name of state, scaled so that its largest entry is 1.
        participation: participation factors by name of state: |left eigenvector times shape|, entry by entry, scaled to
            a sum of 1. They do not depend on the units of the states.
    """

    eigenvalue: complex
    shape: dict[str, complex]
    participation: dict[str, float]

    @property
    def frequency(self) -> float:
        """The undamped natural frequency |eigenvalue|, rad/s."""
        return abs(self.eigenvalue)

    @property
    def damping(self) -> float:
        """The damping ratio -Re / |eigenvalue|; negative for a growing mode, NaN for a zero eigenvalue."""
        return -self.eigenvalue.real / self.frequency if self.frequency else math.nan

    @property
    def period(self) -> float:
        """The period of the oscillation, s; inf for a mode without oscillation."""
        return 2.0 * math.pi / self.eigenvalue.imag if self.eigenvalue.imag else math.inf

    @property
    def time_constant(self) -> float:
        """The time constant -1 / Re(eigenvalue), s: the time of a decay to 1/e; negative for a growing mode, inf for a
        constant one.
        """
        return -1.0 / self.eigenvalue.real if self.eigenvalue.real else math.inf

    def __str__(self) -> str:
        largest = sorted(self.participation.items(), key=lambda item: -item[1])[:3]
        of = ", ".join(f"{name} {100 * share:.0f} %" for name, share in largest)
        kind = f"{self.frequency:.4g} rad/s, damping {self.damping:.3g}" if self.eigenvalue.imag else "no oscillation"
        return f"{self.eigenvalue:.4g}: {kind}, time constant {self.time_constant:.4g} s; {of}"


def modes(A: Any, states: Sequence[str]) -> list[Mode]:
    """The modes of d' = A d, fastest first. Raises ModelError unless A is a single matrix of finite numbers."""
    matrix = reals("modes: A", A, ModelError)
    if matrix.shape != (len(states), len(states)) or not np.isfinite(matrix).all():
        raise ModelError(f"modes expects a single matrix of finite numbers, got shape {matrix.shape}")
    values, right = np.linalg.eig(matrix)
    left = np.linalg.pinv(right)  # rows; where eigenvectors coincide there is no inverse
    result = []
    for k in np.argsort(-np.abs(values), kind="stable"):
        if values[k].imag < 0.0:
            continue
        shape = right[:, k] / right[np.argmax(np.abs(right[:, k])), k]
        shares = np.abs(left[k] * right[:, k])
        shares = shares / shares.sum()
        result.append(Mode(complex(values[k]), dict(zip(states, shape.tolist())), dict(zip(states, shares.tolist()))))
    return result
