"""What the report asks of a method, ours or another library's."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from ...scenes import Scene
from .effort import Effort
from .ladder import Ladder

__all__ = ["Contender", "Counts", "Line", "Program", "Side"]


class Counts(NamedTuple):
    """What a flight did; numbers or arrays of shape ().

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
    """One scene's flight by one method, as a function of the start and the setting.

    Attributes:
        start: a pytree of arrays.
        fly: (start, setting) -> (end, Counts), traceable.
        state: the end as the scene names its states; not timed.
        one_for_all: whether a setting is data of one compiled program; if not, each is compiled.
    """

    start: Any
    fly: Callable[[Any, Any], tuple[Any, Counts]]
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
    """A method with a name on the command line.

    A new method is one more of these in the list in `contenders.py`.
    """

    name: str
    line: Line

    @abstractmethod
    def ladder(self, effort: Effort) -> Ladder:
        """The settings it is run with."""

    @abstractmethod
    def build(self, scene: Scene) -> Program:
        """Its flight of a scene. Raises TwistaxError where it cannot fly it."""
