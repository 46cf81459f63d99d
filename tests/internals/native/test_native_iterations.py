"""Programs run on their own results in one kernel, at every width of vectors: each body iterates as long as it must."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import at_every_width

from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm.iterations import Iterations
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import Processor

COUNTER = jax.ShapeDtypeStruct((), int)


def kernel_of(step: Any, processor: Processor, dtype: Any, single: bool) -> HostKernel:
    """The kernel of a step with a matrix that stays and a state of three."""
    shapes = jax.ShapeDtypeStruct((3, 3), dtype), jax.ShapeDtypeStruct((3,), dtype)
    form = native_form(scalarize(step, COUNTER, *shapes))
    return HostKernel(Iterations(form, 1 if single else processor.lanes(np.dtype(dtype)), 1), processor)


def iterated(step: Any, first: int, stop: int, fixed: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, int]:
    """One body, by NumPy's own arithmetic."""
    k = first
    while k < stop:
        new, *more = step(np.int64(k), fixed, state)
        if not more and not np.isfinite(new).all():
            break
        state, k = np.asarray(new), k + 1
        if more and not more[0]:
            break
    return state, k


def growing(k: Any, a: Any, x: Any) -> list[Any]:
    """Turned and stretched; beyond the range of numbers after a while, for those that are large."""
    return [a @ x * (1.0 + x @ x)]


def shrinking(k: Any, a: Any, x: Any) -> list[Any]:
    """Ends by itself where it is small enough."""
    new = 0.5 * (a @ x)
    return [new, (new @ new) > 0.1]


@at_every_width
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("step", [growing, shrinking])
def test_each_body_as_by_itself(step: Any, dtype: Any, processor: Processor) -> None:
    """More bodies than lanes, and fewer in the last vector; some that take no iteration."""
    rng, count = np.random.default_rng(0), 2 * 16 + 5
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    fixed = (turned * rng.uniform(0.9, 1.1, (count, 1, 1))).astype(dtype)
    state = (rng.normal(size=(count, 3)) * rng.choice([0.1, 3.0, 100.0], (count, 1))).astype(dtype)
    first = rng.integers(-3, 3, count)
    stop = first + rng.integers(-1, 12, count)
    with np.errstate(all="ignore"):
        expected = [iterated(step, *each) for each in zip(first, stop, fixed, state, strict=True)]
    assert len({end - start for start, (_, end) in zip(first, expected, strict=True)}) > 4
    columns = [first[:, None], stop[:, None], fixed.reshape(count, 9), state]
    for single in (True, False):
        ends, counts = kernel_of(lambda *a: [jnp.asarray(r) for r in step(*a)], processor, dtype, single).run(columns)
        np.testing.assert_array_equal(counts[:, 0], [k for _, k in expected])
        same = {"rtol": 1e-3 if dtype == np.float32 else 1e-11}
        np.testing.assert_allclose(ends, np.stack([x for x, _ in expected]), **same)


def with_rows(k: Any, a: Any, x: Any) -> list[Any]:
    """Ends where it is small; comes one half further each time, and leaves for rows where it was and where it is."""
    new = 0.7 * (a @ x)
    return [new, (new @ new) > 0.05, 0.5 * (k + 1).astype(float), x, new]


def row(reach: Any, before: Any, after: Any, mark: Any) -> Any:
    return after + (mark - reach) * (after - before)


@at_every_width
def test_rows_are_filled_as_far_as_each_iteration_comes(processor: Processor) -> None:
    """Rows that were filled before, and those beyond the end, stay; many of one iteration, and none."""
    rng, count, length = np.random.default_rng(1), 2 * 16 + 5, 9
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    fixed = turned * rng.uniform(0.9, 1.1, (count, 1, 1))
    state, table = rng.normal(size=(count, 3)), rng.normal(size=(count, length, 3))
    first, number = rng.integers(0, 3, count), rng.integers(0, length + 1, count)
    stop = first + rng.integers(-1, 9, count)
    marks = np.sort(rng.integers(-2, 24, (count, length)) / 4.0, axis=1)
    expected, filled = table.copy(), number.copy()
    for body in range(count):
        k, x, more = first[body], state[body], True
        while more and k < stop[body]:
            before, (x, more, reach, *_) = x, with_rows(k, fixed[body], x)
            while filled[body] < length and marks[body, filled[body]] <= reach:
                expected[body, filled[body]] = row(reach, before, x, marks[body, filled[body]])
                filled[body] += 1
            k += 1
    assert (filled == length).any()
    assert (filled == number).any()

    vector, one = jax.ShapeDtypeStruct((3,), float), jax.ShapeDtypeStruct((), float)
    step = native_form(scalarize(with_rows, COUNTER, jax.ShapeDtypeStruct((3, 3), float), vector))
    of_row = native_form(scalarize(lambda *a: [row(*a)], one, vector, vector, one))
    heads = [np.full((1, 1), length), *(a[:, None] for a in (first, stop, number))]
    rest = [fixed.reshape(count, 9), state, marks, table.reshape(count, -1)]
    for lanes in (1, processor.lanes(np.dtype(float))):
        kernel = HostKernel(Iterations(step, lanes, 1, of_row), processor)
        _, _, numbers, rows = kernel.run([*heads, *rest], length)
        np.testing.assert_array_equal(numbers[:, 0], filled)
        np.testing.assert_allclose(rows.reshape(expected.shape), expected, rtol=1e-13)
