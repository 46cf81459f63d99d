"""Expressions as functions of their leaves' values, and the examples of all node classes."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

import twistax.mechanics
import twistax.trajectory  # noqa: F401  their nodes are examined too
from twistax.expr import Constant, Example, Expr, Inputs, all_nodes, evaluate_all


def function_of(*exprs: Expr) -> Callable[[Mapping[str, Any]], list[jax.Array]]:
    """The expressions as one function of {leaf name: array}."""

    def function(values: Mapping[str, Any]) -> list[jax.Array]:
        dtype = next((v.dtype for v in values.values()), jnp.zeros(()).dtype)
        inputs = Inputs(jnp.zeros((), dtype), {}, {}, {}, dtype)
        return evaluate_all(exprs, lambda leaf: leaf.read(inputs) if isinstance(leaf, Constant) else values[leaf.name])

    return function


def floats(values: Mapping[str, Any], dtype: Any = np.float64) -> dict[str, np.ndarray]:
    return {name: np.asarray(value, dtype) for name, value in values.items()}


def value_of(expr: Expr, **values: Any) -> np.ndarray:
    """The number an expression amounts to, evaluated operation by operation."""
    return np.asarray(function_of(expr)({k: jnp.asarray(v) for k, v in floats(values).items()})[0])


@functools.cache
def examples(node: type[Expr]) -> list[Example]:
    """The examples of a class, made once."""
    return node.example()


@dataclasses.dataclass(frozen=True)
class Case:
    """One example of one node class."""

    node: type[Expr]
    number: int

    def __str__(self) -> str:
        return f"{self.node.__name__}{self.number}"

    @property
    def example(self) -> Example:
        return examples(self.node)[self.number]

    def built_again(self) -> Expr:
        """The expression, of nodes that are no others'."""
        return self.node.example()[self.number].expr

    @property
    def values(self) -> dict[str, np.ndarray]:
        return floats(self.example.values)

    def flat(self) -> tuple[np.ndarray, Callable[[jax.Array], Any]]:
        """The values as one vector, and the way back."""
        vector, back = ravel_pytree(self.values)
        return np.asarray(vector, np.float64), back


NODES = all_nodes()
CASES = [Case(node, i) for node in NODES for i in range(len(examples(node)))]
