"""Expressions as functions of their leaves' values, and the examples of all node classes."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

import twistax.mechanics
import twistax.trajectory  # noqa: F401  their nodes are examined too
from twistax.expr import Expr, all_nodes
from twistax.testing.nodes import cases_of, function_of

__all__ = ["CASES", "NODES", "floats", "function_of", "value_of"]


def floats(values: Mapping[str, Any], dtype: Any = np.float64) -> dict[str, np.ndarray]:
    return {name: np.asarray(value, dtype) for name, value in values.items()}


def value_of(expr: Expr, **values: Any) -> np.ndarray:
    """The number an expression amounts to, evaluated operation by operation."""
    return np.asarray(function_of(expr)({k: jnp.asarray(v) for k, v in floats(values).items()})[0])


NODES = all_nodes()
#: A class without cases ends here, in LawError.
CASES = [case for node in NODES for case in cases_of(node)]
