"""Sums of very many small numbers: what rounding takes away is kept beside them, and added the next time."""

from __future__ import annotations

import jax.numpy as jnp

from ...groups.components import Components

__all__ = ["Sum", "begun", "increased", "value"]

#: Values, and what of their last increments is not in them, as many each.
Sum = Components


def begun(values: Components) -> Sum:
    """A sum that starts at these values."""
    return (*values, *(jnp.zeros_like(value) for value in values))


def value(total: Sum) -> Components:
    """The values of a sum."""
    return total[: len(total) // 2]


def increased(total: Sum, increments: Components) -> Sum:
    """The sum with increments added. Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section
    VIII.5 (compensated summation).
    """
    values, lost = value(total), total[len(total) // 2 :]
    wanted = tuple(d + e for d, e in zip(increments, lost, strict=True))
    new = tuple(x + d for x, d in zip(values, wanted, strict=True))
    return (*new, *(d - (y - x) for d, y, x in zip(wanted, new, values, strict=True)))
