"""Tables of numbers: which interval a point lies in, and what a lookup costs in scalars."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.expr.tables import BSpline, Linear
from twistax.expr.tables.kinds import GridAxis
from twistax.scalar.reader import emitted_form, scalarize

RNG = np.random.default_rng(3)


x = tx.State("x", (3,))


def values(*lengths: int) -> np.ndarray:
    return np.random.default_rng(len(lengths)).normal(size=lengths)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("count", [2, 3, 4, 5, 16, 1000])
def test_intervals_are_found_exactly(count: int, dtype: Any) -> None:
    """At breakpoints too: even ones, ones off by almost a quarter of a step, and any."""
    step = 2.0 / (count - 1)
    even = np.linspace(-1.0, 1.0, count) + 0.03  # none is zero: numbers beside it are dropped by XLA
    shifted = even + np.concatenate([[0.0], RNG.uniform(-0.24, 0.24, count - 2) * step, [0.0]])
    for points in (even, shifted, np.sort(RNG.uniform(-1.0, 1.0, count))):
        own = points.astype(dtype)
        at = np.concatenate([own, np.nextafter(own, dtype(9)), np.nextafter(own, dtype(-9)), RNG.uniform(-2, 2, 99)])
        at = np.concatenate([at.astype(dtype), np.array([np.inf, -np.inf, np.nan], dtype)])
        expected = np.clip(np.searchsorted(own, at[:-1], side="right") - 1, 0, count - 2)
        found = jax.jit(GridAxis(points).interval)(at)
        np.testing.assert_array_equal(found[:-1], expected)
        assert found[-1] == 0


def operations(kind: Any, points: np.ndarray, axes: int) -> int:
    expr = tx.Interp([x[k] for k in range(axes)], axes=[points] * axes, values=values(*[len(points)] * axes), kind=kind)
    value = tx.lower(expr)
    program = emitted_form(scalarize(lambda x: [value(0.0, {"x": x})], jax.ShapeDtypeStruct((3,), float)))
    assert not program.calls
    return program.operations


@pytest.mark.parametrize("kind", [Linear(), BSpline()], ids=repr)
def test_the_cost_grows_with_the_axes_and_not_with_the_points(kind: Any) -> None:
    few, many = (operations(kind, np.linspace(0.0, 1.0, n), 2) for n in (8, 200))
    assert abs(many - few) <= 2
    uneven = [operations(kind, np.linspace(0.0, 1.0, n) ** 2, 1) for n in (6, 2002)]
    assert uneven[1] - uneven[0] <= 4 * 9  # a load, a comparison, a sum and a choice for each halving
