"""Kernels on a CUDA device that is made up: the driver's functions on this processor, a thread after the other."""

from __future__ import annotations

import ctypes
import re
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.cuda import columns
from twistax.scalar.targets.cuda import driver as cuda
from twistax.scalar.targets.cuda import kernel as cuda_kernel
from twistax.scalar.targets.cuda.kernel import CudaKernel
from twistax.scalar.targets.llvm import backend, kernel, self_test
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import BuildError, MachineCode, Processor, compiled, load
from twistax.scalar.targets.llvm.straight.body import Straight

#: What a thread asks of the device: its place, which is a variable here.
_INDEX = re.compile(r"call i32 @llvm\.nvvm\.read\.ptx\.sreg\.(\w+)\.x\(\)")
_DECLARED = re.compile(r"declare i32 @llvm\.nvvm\.\S+\n")
_INDICES = ("ctaid", "ntid", "tid")


class _Device(cuda.Driver):
    """The functions of the driver that kernels need. Memory of the device is memory.

    Attributes:
        codes: what was loaded and is still there.
        current_contexts: those that were pushed.
        failing: the name of a function that fails.
    """

    def __init__(self) -> None:
        self.version, self.failing = 13000, ""
        self.codes: dict[int, MachineCode] = {}
        self.memory: dict[int, Any] = {}
        self.current_contexts: list[Any] = []
        self.synchronised = 0

    def address(self, name: str) -> int:
        return 4711

    def __call__(self, name: str, *arguments: Any) -> None:
        if name == self.failing:
            raise BuildError(f"{name}: CUDA error 1")
        getattr(self, name)(*arguments)

    def cuDeviceGet(self, found: Any, ordinal: int) -> None:
        found._obj.value = ordinal

    def cuDeviceGetAttribute(self, found: Any, attribute: int, device: int) -> None:
        found._obj.value = {75: 8, 76: 6}[attribute]

    def cuDevicePrimaryCtxRetain(self, found: Any, device: int) -> None:
        found._obj.value = 1000 + device

    def cuCtxPushCurrent_v2(self, context: Any) -> None:
        self.current_contexts.append(context.value)

    def cuCtxPopCurrent_v2(self, found: Any) -> None:
        found._obj.value = self.current_contexts.pop()

    def cuCtxSynchronize(self) -> None:
        assert self.current_contexts
        self.synchronised += 1

    def cuLibraryLoadData(self, found: Any, text: Any, *_: Any) -> None:
        written = text.value.decode()
        written = _DECLARED.sub("", _INDEX.sub(r"load i32, ptr @\1", written)).replace("ptx_kernel ", "")
        written = "\n".join([*(f"@{name} = global i32 0" for name in _INDICES), written])
        names, processor = ("kernel", *_INDICES), Processor.host()
        code = load(compiled(written, processor), ("sinf", "cosf", "sin", "cos"), processor, names)
        found._obj.value = code.addresses["kernel"]
        self.codes[found._obj.value] = code

    def cuLibraryUnload(self, library: Any) -> None:
        del self.codes[library.value]

    def cuLibraryGetKernel(self, found: Any, library: Any, name: bytes) -> None:
        assert name == b"kernel"
        found._obj.value = library.value

    def cuKernelGetFunction(self, found: Any, handle: Any) -> None:
        assert self.current_contexts
        assert handle.value in self.codes

    def cuKernelGetAttribute(self, found: Any, attribute: int, handle: Any, device: int) -> None:
        found._obj.value = {3: 16, 4: 40}[attribute]

    def cuMemAlloc_v2(self, found: Any, size: int) -> None:
        memory = ctypes.create_string_buffer(size)
        found._obj.value = ctypes.addressof(memory)
        self.memory[found._obj.value] = memory

    def cuMemFree_v2(self, place: Any) -> None:
        del self.memory[place.value]

    def cuMemcpyHtoD_v2(self, place: Any, there: int, size: int) -> None:
        ctypes.memmove(place.value, there, size)

    def cuMemcpyDtoH_v2(self, there: int, place: Any, size: int) -> None:
        ctypes.memmove(there, place.value, size)

    def cuLaunchKernel(self, handle: int, grid: int, *rest: Any) -> None:
        (_, _, block, _, _, shared, stream, parameters, _), code = rest, self.codes[handle]
        assert (shared, stream) == (0, None)
        variables = [ctypes.c_int.from_address(code.addresses[name]) for name in _INDICES]
        values = [ctypes.c_int64.from_address(place).value for place in parameters]
        function = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * len(values))(handle)
        for k in range(grid):
            for thread in range(block):
                for variable, value in zip(variables, (k, block, thread), strict=True):
                    variable.value = value
                function(*values)


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> _Device:
    found = _Device()
    for module in (cuda, cuda_kernel):
        monkeypatch.setattr(module, "driver", lambda: found)
    monkeypatch.setattr(cuda, "_ordinals", lambda: [0, 1])
    monkeypatch.setattr(cuda_kernel, "assembled", lambda module, text, loops: text)
    monkeypatch.setattr(self_test, "_CALLED", {"cpu", "cuda"})
    return found


def _made(factor: float, dtype: Any = float) -> CudaKernel:
    shapes = jax.ShapeDtypeStruct((3,), dtype), jax.ShapeDtypeStruct((), dtype)
    form = native_form(scalarize(lambda x, a: [jax.numpy.sin(x) * a + factor, a > 0], *shapes))
    return CudaKernel(Straight(form, 1))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_kernel_computes_each_row(dtype: Any, device: _Device) -> None:
    own = _made(0.25, dtype)
    self_test.check_kernel(own)
    rows = 130
    x = np.random.default_rng(0).normal(size=(rows, 3)).astype(dtype)
    a = np.linspace(-1.0, 1.0, rows, dtype=dtype)[:, None]
    values, positive = own.run([x, a])
    near = {"rtol": 1e-14, "atol": 1e-15} if dtype == np.float64 else {"rtol": 5e-7, "atol": 2e-7}
    np.testing.assert_allclose(values, np.sin(x) * a + dtype(0.25), **near)
    np.testing.assert_array_equal(positive, a > 0)
    shared, _ = own.run([x, a[:1]])
    np.testing.assert_allclose(shared, np.sin(x) * a[0] + dtype(0.25), **near)
    code = own.handle.code.device
    assert (code.registers, code.local) == (40, 16)
    assert not device.memory
    assert not device.current_contexts


def test_code_is_unloaded_once_its_contexts_have_finished(device: _Device, monkeypatch: pytest.MonkeyPatch) -> None:
    own = _made(1.5)
    assert len(device.codes) == 1
    before = device.synchronised
    monkeypatch.setattr(kernel, "_RETIREMENT", -1.0)
    del own
    kernel._free()
    assert not device.codes
    assert device.synchronised == before + 2  # of both devices


@pytest.mark.parametrize("name", ["cuLibraryLoadData", "cuMemAlloc_v2", "cuLaunchKernel", "cuMemcpyDtoH_v2"])
def test_what_fails_leaves_nothing_behind(name: str, device: _Device) -> None:
    device.failing = name
    with pytest.raises(BuildError, match=f"{name}: CUDA error 1"):
        self_test.check_kernel(_made(2.5))
    assert not device.memory
    assert not device.current_contexts


def test_columns_of_a_large_program_are_kernels_each(device: _Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(columns, "MOST_OPERATIONS", 20)
    shapes = [jax.ShapeDtypeStruct((5,), np.dtype(float))]
    program = native_form(scalarize(lambda x: [jax.numpy.outer(x + 1.0, jax.numpy.exp(x)), 3.0 * x], *shapes))
    made = columns.parts(program)
    assert len(made) > 1
    assert all(part.operations <= 20 for part in made)
    x = np.random.default_rng(0).normal(size=(70, 5))

    def kernel(part: Any) -> Any:
        body = Straight(part, 1)

        def run(rows: int, *arguments: Any) -> list[Any]:
            results = dict(zip(body.written, CudaKernel(body).run([arguments[k] for k in body.read]), strict=True))
            return [
                results[k].reshape(rows, *a.shape) if k in results else np.zeros((rows, *a.shape))
                for k, a in enumerate(body.results)
            ]

        return run

    outer, tripled = columns.joined([kernel(part) for part in made])(70, x)
    np.testing.assert_allclose(outer, (x[:, :, None] + 1.0) * np.exp(x)[:, None, :], rtol=1e-14)
    np.testing.assert_allclose(tripled, 3.0 * x, rtol=1e-15)
    monkeypatch.setattr(columns, "MOST_REPEATED", 0.5)
    assert columns.parts(program) == [program]


def test_a_kernel_that_is_wrong_is_not_used(device: _Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_kernel, "assembled", lambda module, text, loops: text.replace("fcmp ogt", "fcmp olt"))
    with pytest.raises(BuildError, match="differ from those of NumPy"):
        self_test.check_kernel(_made(3.5))


def test_explain_tells_of_devices(device: _Device, monkeypatch: pytest.MonkeyPatch) -> None:
    x = tx.State("x", shape=(3,))
    arguments, names = np.ones((3, 3)), {"cpu": None}
    monkeypatch.setattr(backend, "backends", lambda: names)
    monkeypatch.setattr(backend, "driver", lambda: device)
    monkeypatch.setattr(backend, "libdevice", lambda: None)
    pendulum = tx.System(rates={x: -tx.Sin(x)})
    assert "CUDA" not in tx.compile(pendulum, backend=tx.Native()).explain().backend
    names["cuda"] = None
    note = "in threads on CUDA devices of capability 8.6, but by XLA where they call the C library"
    assert note in tx.compile(pendulum, backend=tx.Native()).explain().backend
    assert note in tx.fast(lambda a: a @ a).explain(arguments)
    monkeypatch.setattr(backend, "driver", cuda.Driver)
    assert "as XLA has them on CUDA devices: CUDA's driver" in tx.fast(lambda a: a @ a).explain(arguments)


def test_a_machine_without_a_driver() -> None:
    with pytest.raises(BuildError, match=r"CUDA's driver .* is not installed"):
        cuda.driver()
