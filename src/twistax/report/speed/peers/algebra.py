"""The matrices in which plain recursions are written: arrays of JAX, or what another package calculates with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

__all__ = ["Algebra", "JaxAlgebra"]


class Algebra(ABC):
    """Vectors, matrices and scalars with `+`, `-`, `*`, `@`, `.T` and slices, and what operators do not say."""

    @abstractmethod
    def constant(self, value: Any) -> Any:
        """Numbers."""

    @abstractmethod
    def sin(self, x: Any) -> Any: ...

    @abstractmethod
    def cos(self, x: Any) -> Any: ...

    @abstractmethod
    def matrix(self, rows: Sequence[Sequence[Any]]) -> Any:
        """Of scalars."""

    @abstractmethod
    def block(self, rows: Sequence[Sequence[Any]]) -> Any:
        """Of matrices."""

    @abstractmethod
    def vector(self, entries: Sequence[Any]) -> Any:
        """Of scalars."""

    @abstractmethod
    def joined(self, parts: Sequence[Any]) -> Any:
        """Of vectors."""

    @abstractmethod
    def dot(self, a: Any, b: Any) -> Any: ...

    @abstractmethod
    def outer(self, a: Any, b: Any) -> Any: ...

    def hat(self, w: Any) -> Any:
        """[w]x (3, 3)."""
        return self.matrix([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


class JaxAlgebra(Algebra):
    """jax.numpy in its ordinary style."""

    def constant(self, value: Any) -> Any:
        return jnp.asarray(np.asarray(value, float))

    def sin(self, x: Any) -> Any:
        return jnp.sin(x)

    def cos(self, x: Any) -> Any:
        return jnp.cos(x)

    def matrix(self, rows: Sequence[Sequence[Any]]) -> Any:
        return jnp.array([list(row) for row in rows])

    def block(self, rows: Sequence[Sequence[Any]]) -> Any:
        return jnp.block([list(row) for row in rows])

    def vector(self, entries: Sequence[Any]) -> Any:
        return jnp.stack(list(entries))

    def joined(self, parts: Sequence[Any]) -> Any:
        return jnp.concatenate(list(parts))

    def dot(self, a: Any, b: Any) -> Any:
        return a @ b

    def outer(self, a: Any, b: Any) -> Any:
        return jnp.outer(a, b)
