"""What the derivatives of operations may do with nodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

__all__ = ["Algebra"]


class Algebra(ABC):
    """Arithmetic on nodes, which are numbers of their own: the place of a scalar in a graph.

    Attributes:
        zero, one: the nodes of these numbers.
        dtypes: the type of each node.
    """

    zero: int
    one: int
    dtypes: list[np.dtype[Any]]

    @abstractmethod
    def constant(self, value: Any, dtype: np.dtype[Any] | None = None) -> int:
        """The node of a number, of the program's type if none is given."""

    @abstractmethod
    def node(self, operation: Any, *arguments: int) -> int:
        """The node of an `Operation`."""

    @abstractmethod
    def add(self, a: int, b: int) -> int: ...

    @abstractmethod
    def sub(self, a: int, b: int) -> int: ...

    @abstractmethod
    def neg(self, a: int) -> int: ...

    @abstractmethod
    def mul(self, a: int, b: int) -> int: ...

    @abstractmethod
    def div(self, a: int, b: int) -> int: ...

    @abstractmethod
    def select(self, c: int, a: int, b: int) -> int:
        """a where c, else b."""

    @abstractmethod
    def scaled(self, factor: int, cotangent: int) -> int:
        """factor cotangent; zero where a branch that was not taken makes the cotangent zero, whatever the factor."""
