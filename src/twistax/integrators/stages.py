"""The stages of an explicit Runge-Kutta method: one loop for every tableau, on any pytree of slopes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import jax

from .tableau import ButcherTableau

__all__ = ["combine", "stage_slopes"]


def stage_slopes(
    tableau: ButcherTableau, slope: Callable[[jax.Array, Any], Any], first: Callable[[jax.Array], Any], t: Any, h: Any
) -> list[Any]:
    """k_1 ... k_s with k_i = slope(t + c_i h, h sum_j a_ij k_j).

    Args:
        slope: the slope at a time and an increment.
        first: the slope at a time where the increment is zero.
    """
    slopes: list[Any] = []
    for row, node in zip(tableau.a.tolist(), tableau.c.tolist(), strict=True):
        time = t + node * h if node else t
        slopes.append(slope(time, combine(row, slopes, h)) if any(row) else first(time))
    return slopes


def combine(weights: Iterable[float], slopes: list[Any], h: Any) -> Any:
    """h sum_i weights[i] slopes[i], zeros skipped."""
    used = [(weight, slope) for weight, slope in zip(weights, slopes) if weight]

    def total(*leaves: Any) -> Any:
        terms = [leaf if weight == 1.0 else weight * leaf for (weight, _), leaf in zip(used, leaves, strict=True)]
        return h * sum(terms[1:], terms[0])

    return jax.tree.map(total, *(slope for _, slope in used))
