"""What is worked out of a function: its value, its Jacobian, a gradient."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from .case import Case

__all__ = ["GRADIENT", "JACOBIAN", "QUANTITIES", "VALUE", "Quantity"]

#: Three vectors to arrays, traceable; one after the other along the last axis they are the result.
Function = Callable[[Any, Any, Any], list[Any]]


class Quantity(ABC):
    """Attributes: name, for tables; title, for the page."""

    name: str
    title: str

    @abstractmethod
    def shape(self, case: Case) -> tuple[int, ...]:
        """Of the result."""

    @abstractmethod
    def by_jax(self, function: Function) -> Function:
        """Of a JAX function, by JAX's own derivatives."""

    def __repr__(self) -> str:
        return self.name


class _Value(Quantity):
    name, title = "value", "value"

    def shape(self, case: Case) -> tuple[int, ...]:
        return (case.results,)

    def by_jax(self, function: Function) -> Function:
        return function


class _Jacobian(Quantity):
    name, title = "jacobian", "Jacobian by the first two arguments"

    def shape(self, case: Case) -> tuple[int, ...]:
        return (case.results, case.columns)

    def by_jax(self, function: Function) -> Function:
        slopes = jax.jacfwd(lambda a, b, c: joined(function(a, b, c)), argnums=(0, 1))
        return lambda a, b, c: list(slopes(a, b, c))


class _Gradient(Quantity):
    name, title = "gradient", "gradient of the sum of the results by the first two arguments"

    def shape(self, case: Case) -> tuple[int, ...]:
        return (case.columns,)

    def by_jax(self, function: Function) -> Function:
        slopes = jax.grad(lambda a, b, c: sum(map(jnp.sum, function(a, b, c))), argnums=(0, 1))
        return lambda a, b, c: list(slopes(a, b, c))


def joined(parts: Sequence[Any]) -> Any:
    """A result from its parts."""
    return jnp.concatenate(list(parts), axis=-1) if len(parts) > 1 else parts[0]


VALUE, JACOBIAN, GRADIENT = _Value(), _Jacobian(), _Gradient()
QUANTITIES: tuple[Quantity, ...] = (VALUE, JACOBIAN, GRADIENT)
