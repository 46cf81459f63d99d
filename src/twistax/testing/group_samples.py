"""Tangents that the laws of a group are tried at."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..groups import Group


@dataclasses.dataclass(frozen=True)
class Sample:
    """Three tangents, and whether the logarithm must give the first again."""

    label: str
    d: np.ndarray
    e: np.ndarray
    f: np.ndarray
    in_reach: bool

    @property
    def at(self) -> dict[str, Any]:
        """What messages say of it."""
        return {f"d ({self.label})": self.d, "e": self.e}


def turned(group: Group, d: np.ndarray, turn: float) -> np.ndarray:
    """The tangent with the entries that are no lengths made so long together."""
    natural = ~(group.sized | group.flat)
    length = np.linalg.norm(d[natural])
    return np.where(natural, d * (turn / length), d) if length > 0.0 else d
