"""The elements of a table of a solution. Layouts derive from `Layout`, without loading integrators."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np


class Column(NamedTuple):
    """One column of a table.

    Attributes:
        name: its name.
        unit: its unit, "" if unknown.
        values: (n,), a number for each saved time.
    """

    name: str
    unit: str
    values: np.ndarray

    @property
    def header(self) -> str:
        """The name, and the unit in brackets."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Layout(ABC):
    """The choice and the order of the columns of a table of a solution."""

    @abstractmethod
    def columns(self, solution: Any) -> list[Column]:
        """The columns of a `Solution`, all of the same length."""
