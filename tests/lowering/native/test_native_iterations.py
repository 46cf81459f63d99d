"""Programs run on their own results in one kernel, at every width of vectors: each body iterates as long as it must."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import at_every_width

from twistax.lowering.native.iterations import Iterations
from twistax.lowering.native.kernel import Kernel
from twistax.lowering.native.machine_code import Processor
from twistax.lowering.native.tile import native_form
from twistax.lowering.scalar.program import scalarize

COUNTER = jax.ShapeDtypeStruct((), int)


def kernel_of(step: Any, processor: Processor, dtype: Any, single: bool) -> Kernel:
    """The kernel of a step with a matrix that stays and a state of three."""
    shapes = jax.ShapeDtypeStruct((3, 3), dtype), jax.ShapeDtypeStruct((3,), dtype)
    form = native_form(scalarize(step, COUNTER, *shapes))
    return Kernel(Iterations(form, 1 if single else processor.lanes(np.dtype(dtype)), 1), processor)


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
