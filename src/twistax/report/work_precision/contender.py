"""What takes part: a method with a name, the settings it is run with, and its run of a scene as a program."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from ...scenes import Scene
from ..timing import Repeats

__all__ = [
    "FULL",
    "QUICK",
    "Contender",
    "Counts",
    "Effort",
    "Ladder",
    "Line",
    "Program",
    "Side",
    "equal_steps",
    "tolerances",
]

# ---- settings -------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Ladder:
    """Settings from coarse to fine, climbed until the error is small enough.

    Attributes:
        unit: what a setting is: "tolerance", rtol = atol, or "steps", their number.
        rungs: the settings.
        enough: the error at which to stop.
    """

    unit: str
    rungs: tuple[float, ...]
    enough: float = 0.0


def tolerances(coarsest: int, finest: int, per_decade: int) -> Ladder:
    """Evenly spaced in decades; the ends are exponents of ten."""
    count = (coarsest - finest) * per_decade + 1
    # Three digits, so that a setting reads the same in every table.
    return Ladder("tolerance", tuple(float(f"{10.0 ** (coarsest - i / per_decade):.2e}") for i in range(count)))


def equal_steps(first: int, factor: float, enough: float = 1e-10, most: int = 2**21) -> Ladder:
    """Each number of steps is `factor` times the one before."""
    rungs = [float(first)]
    while (more := float(round(rungs[-1] * factor))) <= most:
        rungs.append(more)
    return Ladder("steps", tuple(rungs), enough)


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
    tolerances: Ladder
    steps: Ladder
    longest: float
    repeats: Repeats


FULL = Effort("full", tolerances(-3, -13, 2), equal_steps(32, 4.0), 0.5, Repeats(31, 5, 0.2))
QUICK = Effort("quick", tolerances(-4, -12, 1), equal_steps(32, 4.0), 0.1, Repeats(9, 3, 0.05))

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
