"""Tangents at which the laws of a group are tested."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..groups import Group


@dataclasses.dataclass(frozen=True)
class Sample:
    """Three tangents, and whether the logarithm must return the first one."""

    label: str
    d: np.ndarray
    e: np.ndarray
    f: np.ndarray
    in_reach: bool

    @property
    def at(self) -> dict[str, Any]:
        """Its text in messages."""
        return {f"d ({self.label})": self.d, "e": self.e}


def turned(group: Group, d: np.ndarray, turn: float) -> np.ndarray:
    """The tangent whose entries that are not lengths are scaled to this joint norm."""
    natural = ~(group.sized | group.flat)
    length = np.linalg.norm(d[natural])
    return np.where(natural, d * (turn / length), d) if length > 0.0 else d
