"""Distances as kernels: searches for the nearest features, and the formulas for these."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import jax
import jax.numpy as jnp

from ...scalar.backends import XLA
from ...scalar.kernel_function import KernelFunction
from ...scalar.targets.llvm.backend import Native
from ...scalar.targets.llvm.machine_code import installed

R = TypeVar("R")

#: The distance () for a pose (4, 4).
Distance: TypeAlias = Callable[[Any], jax.Array]


def searched(search: Callable[[jax.Array], R], formula: Callable[[jax.Array, R], jax.Array]) -> Distance:
    """The distance () as a function of a pose T (4, 4): a formula of T and of the features that a search finds.

    Both are kernels, for arrays of NumPy or JAX. The features count as constants, so that derivatives are those of the
    formula. Both functions are pure; `while` loops in the search end for all arguments.
    """
    backend = Native() if installed() else XLA()
    features = KernelFunction(search, backend, of_matrices=True, constant=True)
    value = KernelFunction(formula, backend)

    def distance(T: Any) -> jax.Array:
        T = jnp.asarray(T)
        return value(T, features(T))

    return distance
