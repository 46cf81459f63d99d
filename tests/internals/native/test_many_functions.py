"""Programs with many sines, exponentials and the like call them: the same bits, and text that grows little."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import at_every_width

from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm import kernel_body
from twistax.scalar.targets.llvm.code import Module
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import Processor
from twistax.scalar.targets.llvm.straight.body import Straight


def functions(x: jax.Array) -> list[jax.Array]:
    """Each of them on twelve numbers."""
    turned = jnp.sin(x) - jnp.cos(3.0 * x)
    return [turned, jnp.exp(x), jnp.expm1(x), jnp.tanh(x), jax.nn.sigmoid(x), jnp.sin(jnp.exp(-x)) * turned]


#: Near, far beyond the range of polynomials, at the ends of the range of numbers, and none.
SPECIAL = [0.0, -0.0, 1e-300, -1e-7, 0.3, -40.0, 710.0, -745.0, 1e12, -3e20, np.inf, np.nan]


@at_every_width
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_called_and_written_functions_agree_to_the_bit(
    processor: Processor, dtype: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    form = native_form(scalarize(functions, jax.ShapeDtypeStruct((12,), dtype)))
    with np.errstate(over="ignore"):
        rows = np.stack([np.roll(np.asarray(SPECIAL), k) for k in range(11)]).astype(dtype)
    results = []
    for most in (0, 10**9):
        monkeypatch.setattr(kernel_body, "_MOST_INLINED", most)
        results.append(HostKernel(Straight(form, processor.lanes(form.graph.dtype)), processor).run([rows]))
    for called, written in zip(*results, strict=True):
        np.testing.assert_array_equal(called, written)
        np.testing.assert_array_equal(np.signbit(called), np.signbit(written))
    with np.errstate(over="ignore", under="ignore"):
        np.testing.assert_allclose(results[0][1], np.exp(rows), rtol=4 * np.finfo(dtype).eps)


def _lines(count: int) -> Callable[[jax.Array], list[jax.Array]]:
    def function(x: jax.Array) -> list[jax.Array]:
        for k in range(count):
            x = x + 0.01 * jnp.sin((1.0 + k) * x) * jnp.tanh(x)
        return [x]

    return function


def test_text_grows_by_few_lines_for_a_function() -> None:
    """Written at its place a sine takes some sixty."""
    lengths = []
    for count in (20, 40):
        form = native_form(scalarize(_lines(count), jax.ShapeDtypeStruct((12,), np.float64)))
        module = Module(Processor.host())
        Straight(form, module.processor.lanes(np.dtype(np.float64))).write(module)
        lengths.append(module.text().count("\n"))
    assert lengths[1] - lengths[0] < 15 * 20 * 12
