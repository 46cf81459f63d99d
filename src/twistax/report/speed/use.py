"""How dynamics are used: called once, in a loop, for many points."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod

from .task import Program, Task

__all__ = ["LOOP", "SINGLE", "USES", "Batch", "Loop", "Single", "Use"]


class Use(ABC):
    """What a task is asked for."""

    @property
    @abstractmethod
    def name(self) -> str:
        """For tables and the page."""

    @abstractmethod
    def of(self, task: Task) -> Program: ...


@dataclasses.dataclass(frozen=True)
class Single(Use):
    """A call from Python."""

    name = "single call"

    def of(self, task: Task) -> Program:
        return task.single()


@dataclasses.dataclass(frozen=True)
class Loop(Use):
    """In a compiled loop."""

    steps: int = 1000
    name = "in a loop"

    def of(self, task: Task) -> Program:
        return task.loop(self.steps)


@dataclasses.dataclass(frozen=True)
class Batch(Use):
    """For many points at once."""

    count: int

    @property
    def name(self) -> str:
        return f"batch of {self.count:,}"

    def of(self, task: Task) -> Program:
        return task.batch(self.count)


SINGLE, LOOP = Single(), Loop()
USES: tuple[Use, ...] = (SINGLE, LOOP, Batch(64), Batch(4096), Batch(65536))
