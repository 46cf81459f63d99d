"""Inequalities at a node that the equalities there decide: they leave no room for slacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array


def spanned(
    equality: Array, inequality: Array, held: Array, slopes: Callable[..., Any], samples: Sequence[tuple[Any, ...]]
) -> Array:
    """(rows,) which inequalities have slopes in the span of those of the equalities and of what is held.

    Args:
        equality, inequality: (rows,) which they are, of those that exist.
        held: (k, unknowns) what does not move.
        slopes: of the rows, (rows, unknowns), at a sample; they count if they are so at all samples.
    """
    pinned = inequality.copy()
    if not (equality.any() or len(held)) or not pinned.any():
        return np.zeros_like(pinned)
    seen = np.zeros_like(pinned)
    for found in (np.asarray(slopes(*sample)) for sample in samples):
        # A random sample may lie where a row has no slopes; others tell about it.
        there = np.isfinite(found).all(axis=1)
        found = np.where(there[:, None], found, 0.0)
        base, rows = np.concatenate([held, found[equality]]).T, found.T
        left = rows - base @ np.linalg.lstsq(base, rows, rcond=None)[0]
        size = np.linalg.norm(rows, axis=0)
        pinned &= ~there | ((size > 0.0) & (np.linalg.norm(left, axis=0) <= 1e-9 * size))
        seen |= there
    return pinned & seen


def stirred(rng: np.random.Generator, values: Any) -> Any:
    """Arrays with every entry changed at random, by a third of its size at most; zeros no longer are."""

    def one(a: Any) -> Array:
        here = np.asarray(a, float)
        return np.asarray(here + rng.uniform(0.1, 0.3, here.shape) * np.where(here == 0.0, 1.0, here))

    return jax.tree.map(one, values)
