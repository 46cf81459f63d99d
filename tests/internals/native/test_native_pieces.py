"""Long programs in several functions give what they give as one, but for products and sums that are rounded once."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")

from native_programs import at_every_width

from twistax.scalar.primitives.interface import Limits
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm import machine_code
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import by_numpy, native_form
from twistax.scalar.targets.llvm.machine_code import Processor, compiled
from twistax.scalar.targets.llvm.straight import pieces
from twistax.scalar.targets.llvm.straight.body import Straight


def mixed(x: jax.Array, n: jax.Array) -> list[jax.Array]:
    """Sines of what others give, numbers of all types that pass on, results that are whole blocks and parts of them."""
    turned, large = jnp.sin(x) + jnp.cos(jnp.sin(x[::-1]) * x), x > 0.3
    for k in range(4):
        turned = jnp.where(large, turned * x[k] + turned[::-1], jnp.tanh(turned)) - 0.1 * n.astype(x.dtype)
    return [jnp.outer(turned, x)[:3], large, n * 3 + n[::-1], turned[:2], x, jnp.ones(3, x.dtype)]


@at_every_width
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_pieces_give_what_the_whole_gives(processor: Processor, dtype: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    shapes = [jax.ShapeDtypeStruct((7,), dtype), jax.ShapeDtypeStruct((7,), np.int32)]
    form, rng = native_form(scalarize(mixed, *shapes)), np.random.default_rng(0)
    rows = [rng.normal(size=(11, 7)).astype(dtype), rng.integers(-5, 5, (11, 7)).astype(np.int32)]
    found, lanes = [], processor.lanes(form.graph.dtype)
    # What passes on stands on the stack, or elsewhere; few values are held, or many.
    for length, stack, held in ((10**9, 0, 24), (9, 10**9, 12), (40, 0, 24), (40, 0, 2), (10**6, 0, 5)):
        monkeypatch.setattr(pieces, "STACK", stack)
        monkeypatch.setattr(Processor, "held", held)
        monkeypatch.setattr(Processor, "longest", length if length > 10**6 else 9)
        monkeypatch.setattr(pieces, "_LENGTH", length)
        kernel = HostKernel(Straight(form, lanes), processor)
        found.append(kernel.run([rows[k] for k in kernel.body.read]))
    for other in found[1:]:
        for whole, own in zip(found[0], other, strict=True):
            near = 50 * np.finfo(dtype).eps if whole.dtype.kind == "f" else 0.0
            np.testing.assert_allclose(own, whole, rtol=0.0, atol=near)


def test_llvm_has_a_few_pieces_in_memory_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    import llvmlite.binding as llvm

    parse, lengths = llvm.parse_assembly, list[int]()
    monkeypatch.setattr(Processor, "longest", 9)
    monkeypatch.setattr(pieces, "_LENGTH", 9)
    monkeypatch.setattr(llvm, "parse_assembly", lambda text, *more: (lengths.append(len(text)), parse(text, *more))[1])
    shapes = [jax.ShapeDtypeStruct((7,), np.float64), jax.ShapeDtypeStruct((7,), np.int32)]
    HostKernel(Straight(native_form(scalarize(mixed, *shapes)), 1), Processor.host())
    assert len(lengths) > 6
    assert max(lengths) < 0.5 * sum(lengths)


def test_other_functions_are_scheduled_after_a_long_one(monkeypatch: pytest.MonkeyPatch) -> None:
    import llvmlite.binding as llvm

    given, text = [], "define double @f(double %x) {\nret double %x\n}"
    monkeypatch.setattr(llvm, "set_option", lambda name, option: given.append(option))
    known = llvm.llvm_version_info[0] in machine_code._ORDERED
    compiled(text, Processor.host())
    assert given == ["-enable-misched=true"] * 2 * known
    compiled(text, Processor.host(), long=True)
    assert given[2:] == ["-enable-misched=false", "-enable-misched=true"] * known


@at_every_width
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_products_of_matrices_are_loops(
    processor: Processor, single: bool, dtype: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two patterns of columns, the factor a triangle, with numbers in the other one, and what is read in sums."""

    def product(A: jax.Array, B: jax.Array, s: jax.Array) -> list[jax.Array]:
        A, late = jnp.tril(A), np.arange(9)[:, None] > 2 * (np.arange(23) > 9)
        B = jnp.where(late, B * s, 0.0).at[3].set(2.0)
        C = A @ (A.T @ B)
        return [C - B, C[:3], jnp.sin(s) * C[0, 0], jnp.zeros((2, 9))]

    shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape in ((9, 9), (9, 23), ())]
    program = scalarize(product, *shapes, limits=Limits(products=100))
    form, unrolled = native_form(program, products=True), native_form(program)
    assert len(form.calls) == 3
    assert not unrolled.calls
    assert form.operations < 0.1 * unrolled.operations == 0.1 * scalarize(product, *shapes).operations
    rng = np.random.default_rng(0)
    rows = [rng.normal(size=(11, int(np.prod(s.shape)))).astype(dtype) for s in shapes]
    kernel = HostKernel(Straight(form, 1 if single else processor.lanes(np.dtype(dtype))), processor)
    arrays = kernel._arrays

    def full(arguments: list[np.ndarray], length: int) -> tuple[int, list[np.ndarray]]:
        """With ones in the results, so that zeros have to be written."""
        count, both = arrays(arguments, length)
        for result in both[len(arguments) :]:
            result.fill(1.0)
        return count, both

    monkeypatch.setattr(kernel, "_arrays", full)
    expected = by_numpy(unrolled, rows)
    for found in kernel.run([rows[k] for k in kernel.body.read]), by_numpy(form, rows):
        for values, wanted in zip(found, expected, strict=True):
            size = 50 * np.finfo(dtype).eps * max(1.0, np.abs(wanted).max())
            np.testing.assert_allclose(values, wanted, rtol=0.0, atol=size)
