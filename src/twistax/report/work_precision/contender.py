"""What takes part: a method with a name, the settings it is run with, and its run of a scene as a program."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from ...scenes import Scene
from ..timing import Repeats

__all__ = ["FULL", "QUICK", "Contender", "Counts", "Effort", "Ladder", "Line", "Program", "Side", "Steps", "Tolerances"]

# ---- settings -------------------------------------------------------------------------------------------------------


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
            error: what the run with `setting` ended with; NaN if it did not reach the end.
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
    factor: float
    enough: float = 1e-10
    most: int = 2**21
    unit = "steps"

    @property
    def first(self) -> float:
        return float(self.start)

    def after(self, setting: float, error: float) -> float | None:
        more = float(round(setting * self.factor))
        return None if error <= self.enough or more > self.most else more


@dataclasses.dataclass(frozen=True)
class Effort:
    """Settings to run, and how often each run is repeated.

    Attributes:
        name: for the page.
        tolerances: of methods that choose their steps.
        steps: of methods with equal steps.
        longest: a method is not run finer once one of its runs takes longer, s.
        repeats: of every run of a scene, in turn.
    """

    name: str
    tolerances: Tolerances
    steps: Steps
    longest: float
    repeats: Repeats


FULL = Effort("full", Tolerances(-3, -13, 2), Steps(32, 4.0), 0.5, Repeats(31, 5, 0.2))
QUICK = Effort("quick", Tolerances(-4, -12, 1), Steps(32, 4.0), 0.1, Repeats(9, 3, 0.05))

# ---- contenders -----------------------------------------------------------------------------------------------------


class Counts(NamedTuple):
    """What a run did; numbers or arrays of shape ().

    Attributes:
        accepted, rejected: steps.
        evaluations: of the right-hand side.
        good: whether the end was reached.
    """

    accepted: Any
    rejected: Any
    evaluations: Any
    good: Any


@dataclasses.dataclass(frozen=True, eq=False)
class Program:
    """One scene by one method, as a function of the start and the setting.

    Attributes:
        start: a pytree of arrays.
        solve: (start, setting) -> (end, Counts), traceable.
        state: the end as the scene names its states; not timed.
        one_for_all: whether a setting is data of one compiled program; if not, each is compiled.
    """

    start: Any
    solve: Callable[[Any, Any], tuple[Any, Counts]]
    state: Callable[[Any], Any]
    one_for_all: bool


@dataclasses.dataclass(frozen=True)
class Side:
    """Who runs the method, and how.

    Attributes:
        name: a word for tables.
        what: how, in a few words.
        ready: whether it can be had by calling what its library offers.
    """

    name: str
    what: str
    ready: bool = True


@dataclasses.dataclass(frozen=True)
class Line:
    """One line in the figures. Several contenders may share one: its best points count.

    Attributes:
        title: how tables call it.
        code: how a program writes it.
        side: who runs it.
        style: colour, dash and marker, as matplotlib names them.
        drawn: whether it is drawn, or is in the tables alone.
    """

    title: str
    code: str
    side: Side
    style: tuple[str, str, str]
    drawn: bool = True


class Contender(ABC):
    """A method with a name on the command line. A new one is one more in the list in `contenders.py`."""

    name: str
    line: Line

    @abstractmethod
    def ladder(self, effort: Effort) -> Ladder:
        """The settings it is run with."""

    @abstractmethod
    def build(self, scene: Scene) -> Program:
        """Its run of a scene. Raises TwistaxError where it cannot do it."""
