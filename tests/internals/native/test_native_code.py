"""Machine code: kernels that are wrong or refused, targets and memory."""

from __future__ import annotations

import platform
import struct
import sys
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax import progress
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm import kernel as kernel_module
from twistax.scalar.targets.llvm import machine_code, self_test
from twistax.scalar.targets.llvm.code import Module
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import Processor
from twistax.scalar.targets.llvm.straight.body import Straight

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")


s = tx.State("s", (3,))


SMALL = tx.System(rates={s: tx.Sin(s) * s}, outputs={"length": tx.linalg.Norm(s)})


AT = {"s": np.array([0.4, -0.5, 0.6])}


RATES, SLOPES = np.sin(AT["s"]) * AT["s"], np.diag(np.sin(AT["s"]) + np.cos(AT["s"]) * AT["s"])


@pytest.fixture(autouse=True)
def first_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """No message was given yet."""
    monkeypatch.setattr(progress, "_SAID", set())


def test_a_wrong_kernel_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Products that are sums: the first call finds out, XLA runs instead."""
    monkeypatch.setitem(vars(OPERATIONS["mul"]), "llvm", OPERATIONS["add"].llvm)
    dynamics = tx.compile(SMALL, backend=tx.Native(least=0))
    with pytest.warns(RuntimeWarning, match="its results differ from those of NumPy") as messages:
        rates = dynamics(0.0, AT)["s"]
    assert len(messages) == 1
    np.testing.assert_allclose(rates, RATES, rtol=1e-14)
    np.testing.assert_allclose(dynamics.jacobian(0.0, AT)["x"], SLOPES, rtol=1e-14)


def test_a_handler_called_otherwise_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if XLA's interface had changed."""
    monkeypatch.setattr(self_test, "_CALLED", set())
    monkeypatch.setattr(HostKernel, "__call__", lambda self, rows, *a, **_: [jnp.zeros((rows, 3))])
    with pytest.warns(RuntimeWarning, match="differ where JAX calls it"):
        rates = tx.compile(SMALL, backend=tx.Native(least=0, threads=5))(0.0, AT)["s"]
    np.testing.assert_allclose(rates, RATES, rtol=1e-14)


def test_the_first_kernel_may_be_a_constant(monkeypatch: pytest.MonkeyPatch) -> None:
    """It reads nothing, though the system has a state."""
    monkeypatch.setattr(self_test, "_CALLED", set())
    rates = tx.compile(tx.System(rates={s: tx.Constant(np.arange(3.0))}), backend=tx.Native(least=0))(0.0, AT)["s"]
    np.testing.assert_array_equal(rates, np.arange(3.0))


def test_llvm_that_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Module, "text", lambda self: "this is no program")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(2):  # not once alone, where a filter makes it an error
            with pytest.raises(RuntimeWarning, match="LLVM rejects it"):
                tx.compile(SMALL, backend=tx.Native(least=0))(0.0, AT)
    with pytest.warns(RuntimeWarning, match="LLVM rejects it"):
        rates = tx.compile(SMALL, backend=tx.Native(least=0))(0.0, AT)["s"]
    np.testing.assert_allclose(rates, RATES, rtol=1e-14)


def test_a_library_without_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    """LLVM would end the process."""
    monkeypatch.setattr(machine_code.ctypes, "CDLL", lambda name: object())
    with pytest.warns(RuntimeWarning, match="the C library has no"):
        rates = tx.compile(SMALL, backend=tx.Native(least=0, threads=7))(0.0, AT)["s"]
    np.testing.assert_allclose(rates, RATES, rtol=1e-14)


def _kernel() -> HostKernel:
    shape = jax.ShapeDtypeStruct((3,), float)
    processor = Processor.host()
    form = native_form(scalarize(lambda x, y: [x * y, x.sum()], shape, shape))
    return HostKernel(Straight(form, processor.lanes(form.graph.dtype)), processor)


@pytest.mark.parametrize(
    ("shapes", "results", "message"),
    [
        ([(4, 3), (4, 3)], [((4, 3), np.float32), ((4, 1), np.float64)], "result 0"),
        ([(4, 3), (4, 2)], [((4, 3), np.float64), ((4, 1), np.float64)], "argument 1"),
        ([(4, 3), (5, 3)], [((4, 3), np.float64), ((4, 1), np.float64)], "argument 1"),
        ([(4, 3), (2, 2, 3)], [((4, 3), np.float64), ((4, 1), np.float64)], "argument 1"),
        ([(4, 3)], [((4, 3), np.float64), ((4, 1), np.float64)], "takes 2 arguments"),
        ([(4, 3), (4, 3)], [((4, 3), np.float64)], "gives 2 results"),
    ],
)
def test_wrong_types_and_shapes_are_refused(shapes: Any, results: Any, message: str) -> None:
    kernel = _kernel()
    call = jax.ffi.ffi_call(kernel.target, [jax.ShapeDtypeStruct(*r) for r in results])
    with pytest.raises(jax.errors.JaxRuntimeError, match=message):
        jax.block_until_ready(jax.jit(call)(*(np.zeros(s) for s in shapes)))


def test_the_same_program_has_the_same_target() -> None:
    assert _kernel().target == _kernel().target
    assert _kernel().target.startswith("twistax_")


@pytest.mark.skipif(
    platform.machine() != "x86_64" or sys.platform != "linux", reason="reads what LLVM writes for Linux on x86-64"
)
def test_code_and_constants_may_lie_far_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reference of 32 bits between them would end the process where memory is scattered."""
    texts: list[str] = []
    name = kernel_module.named
    monkeypatch.setattr(kernel_module, "named", lambda text, processor: texts.append(text) or name(text, processor))
    _kernel()
    written = machine_code.compiled(texts[0], Processor.host())
    assert not _NEAR & set(_relocations(written))


#: Of the types of x86-64 relocations those of 32 bits between sections: PC32, PLT32, 32, 32S.
_NEAR = {2, 4, 10, 11}


def _relocations(written: bytes) -> list[int]:
    """The types of all relocations of the code in an ELF file of 64 bits."""
    table, size, count = (*struct.unpack_from("<Q", written, 40), *struct.unpack_from("<HH", written, 58))
    found = []
    for k in range(count):
        _, kind, _, _, offset, length, _, target, _, entry = struct.unpack_from(
            "<IIQQQQIIQQ", written, table + k * size
        )
        flags = struct.unpack_from("<Q", written, table + target * size + 8)[0] if target < count else 0
        if kind == 4 and flags & 4:  # addends, for a section that is executed
            found += [
                struct.unpack_from("<Q", written, offset + i + 8)[0] & 0xFFFFFFFF for i in range(0, length, entry)
            ]
    return found
