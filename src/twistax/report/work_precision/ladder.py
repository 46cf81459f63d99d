"""The settings a method is run with, from coarse to fine."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod

__all__ = ["Ladder", "Steps", "Tolerances"]


class Ladder(ABC):
    """Climbed rung by rung: the next setting may depend on the error of the one before."""

    #: What a setting is, for tables.
    unit: str

    @property
    @abstractmethod
    def first(self) -> float:
        """The coarsest setting."""

    @abstractmethod
    def after(self, setting: float, error: float) -> float | None:
        """The next finer setting, or None at the top.

        Args:
            error: what the flight with `setting` ended with; not a number if it did not end.
        """


@dataclasses.dataclass(frozen=True)
class Tolerances(Ladder):
    """rtol = atol, evenly spaced in decades.

    Attributes:
        coarsest, finest: exponents of ten.
        per_decade: settings in a decade.
    """

    coarsest: int
    finest: int
    per_decade: int
    unit = "tolerance"

    @property
    def first(self) -> float:
        return self._rung(0)

    def after(self, setting: float, error: float) -> float | None:
        number = round((self.coarsest - math.log10(setting)) * self.per_decade) + 1
        return self._rung(number) if number <= (self.coarsest - self.finest) * self.per_decade else None

    def _rung(self, number: int) -> float:
        # Three digits, so that a setting reads the same in every table.
        return float(f"{10.0 ** (self.coarsest - number / self.per_decade):.2e}")


@dataclasses.dataclass(frozen=True)
class Steps(Ladder):
    """Numbers of equal steps, each `factor` times the one before, until the error is small enough.

    Attributes:
        start: the first number.
        factor: > 1.
        enough: the error at which to stop.
        most: the largest number.
    """

    start: int
    factor: int
    enough: float = 1e-10
    most: int = 2**21
    unit = "steps"

    @property
    def first(self) -> float:
        return float(self.start)

    def after(self, setting: float, error: float) -> float | None:
        more = setting * self.factor
        return None if error <= self.enough or more > self.most else more
