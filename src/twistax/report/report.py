"""What all reports have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from .origin import origin_of
from .progress import Tell
from .rows import Row
from .store import Store

__all__ = ["Report"]


class Report(ABC):
    """Measures part by part, and says what came of it.

    Attributes:
        name: of its files.
        template: of its page.
        title: of its page.
        one_thread: whether every call runs in the caller's thread (`jax_cpu_enable_async_dispatch` off), so that short
            programs are timed alike whether or not XLA counts them as cheap.
        parts: what is measured one after the other.
        store: of its rows, once opened.
    """

    name: str
    template: ClassVar[str]
    title: str
    one_thread: ClassVar[bool] = True
    parts: Sequence[str]
    store: Store

    #: What was run, and how often it was repeated.
    effort: Mapping[str, Any] = MappingProxyType({})

    def open(self, folder: Path) -> None:
        """Take up the rows that are there."""
        self.store = Store(folder / f"{self.name}.json", origin_of(self.effort, self.versions()))

    def versions(self) -> dict[str, str]:
        """Of packages that take part beside the usual ones."""
        return {}

    def opening(self) -> list[str]:
        """Lines to print before anything is measured."""
        return []

    @abstractmethod
    def measure(self, part: str, tell: Tell) -> None:
        """Put into the store what is not there yet."""

    def said(self, part: str) -> list[str]:
        """Lines to print once a part is measured."""
        return []

    @abstractmethod
    def rows(self) -> list[Row]:
        """What this run is about, in order."""

    @abstractmethod
    def bars(self) -> list[Row]:
        """The rows that documents may show: those that were judged, by groups."""

    def conclusion(self) -> list[str]:
        """Lines to print once everything is measured."""
        return [f"{r.what}, {r.by} {r.setting}: {r.came}, {r.bar}  {r.verdict}" for r in self.bars()]

    @abstractmethod
    def problems(self) -> list[str]:
        """What makes the run fail, a line each."""

    @abstractmethod
    def drawings(self) -> dict[str, Callable[[], bytes]]:
        """What draws the figures as SVG, by the name of the file; ImportError without matplotlib."""

    @abstractmethod
    def context(self) -> dict[str, Any]:
        """What the template needs beside what all have: title, name, command, origin, versions, pictures."""
