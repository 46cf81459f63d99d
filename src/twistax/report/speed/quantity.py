"""What is worked out of a function: its value, its Jacobian, a gradient."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .case import Case

__all__ = ["GRADIENT", "JACOBIAN", "QUANTITIES", "VALUE", "Quantity"]

#: Three vectors to an array, traceable.
Function = Callable[[Any, Any, Any], Any]


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
        slopes = jax.jacfwd(function, argnums=(0, 1))
        return lambda a, b, c: jnp.concatenate(slopes(a, b, c), axis=1)


class _Gradient(Quantity):
    name, title = "gradient", "gradient of the sum of the results by the first two arguments"

    def shape(self, case: Case) -> tuple[int, ...]:
        return (case.columns,)

    def by_jax(self, function: Function) -> Function:
        slopes = jax.grad(lambda a, b, c: jnp.sum(function(a, b, c)), argnums=(0, 1))
        return lambda a, b, c: jnp.concatenate(slopes(a, b, c))


VALUE, JACOBIAN, GRADIENT = _Value(), _Jacobian(), _Gradient()
QUANTITIES: tuple[Quantity, ...] = (VALUE, JACOBIAN, GRADIENT)
