"""Who takes part."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Sequence
from importlib import metadata

from .case import Case
from .quantity import Quantity
from .task import Task

__all__ = ["Contender"]


class Contender(ABC):
    """A way to have dynamics evaluated.

    Attributes:
        name: in tables.
        how: what is done, a sentence for the page.
        colour: in figures.
        packages: needed, as pip and as Python call them.
    """

    name: str
    how: str
    colour: str
    packages: Sequence[tuple[str, str]] = ()

    def absent(self) -> str | None:
        """Why it cannot take part on this machine; None if it can."""
        for package, module in self.packages:
            if importlib.util.find_spec(module) is None:
                return f"{package} is not installed"
        return None

    def versions(self) -> dict[str, str]:
        """Of what it needs, where it is there."""
        return {package: metadata.version(package) for package, _ in self.packages}

    @abstractmethod
    def task(self, case: Case, quantity: Quantity) -> Task:
        """Raises `Lacks` where it has none."""
