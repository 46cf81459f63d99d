"""Kernels for CUDA devices on a machine without one: their formulas, their PTX, and the handler that starts them."""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from native_programs import program_of, run

import twistax as tx
from twistax.mechanics import Chain, chain_models, forward_dynamics
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.targets.cuda import columns, ptx
from twistax.scalar.targets.llvm import backend, handler
from twistax.scalar.targets.llvm.code import Module
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import KernelBody
from twistax.scalar.targets.llvm.lanes import Array
from twistax.scalar.targets.llvm.machine_code import Processor, compiled, load
from twistax.scalar.targets.llvm.self_test import check_kernel
from twistax.scalar.targets.llvm.straight.body import Straight

#: This processor, with the formulas of devices: functions of single precision in single precision.
NARROW = dataclasses.replace(Processor.host(), triple="formulas of devices", fma=True)
TYPES = (np.float32, np.float64)


# ---- formulas --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "points", "units"),
    [
        ("sin", np.linspace(-1e5, 1e5, 200_001), 2.0),
        ("cos", np.linspace(-1e5, 1e5, 200_001), 2.0),
        ("sin", np.linspace(-7.0, 7.0, 200_001), 2.0),
        ("cos", np.linspace(-7.0, 7.0, 200_001), 2.0),
        ("sin", np.geomspace(1e-30, 1e30, 20_001), 2.0),
        ("exp", np.linspace(-104.0, 90.0, 200_001), 2.0),
        ("expm1", np.linspace(-20.0, 88.0, 200_001), 2.0),
        ("expm1", np.geomspace(1e-30, 1.0, 20_001), 2.0),
        ("tanh", np.linspace(-20.0, 20.0, 200_001), 3.0),
        ("tanh", np.geomspace(1e-30, 1.0, 20_001), 3.0),
        ("logistic", np.linspace(-80.0, 80.0, 20_001), 4.0),
    ],
)
def test_single_precision_in_single_precision(name: str, points: np.ndarray, units: float) -> None:
    x = points.astype(np.float32)
    with np.errstate(over="ignore", under="ignore"):
        wide = x.astype(np.float64)
        exact = 1.0 / (1.0 + np.exp(-wide)) if name == "logistic" else getattr(np, name)(wide)
        (found,) = run(program_of([OPERATIONS[name]], np.float32, 1), NARROW, x)
        rounded = exact.astype(np.float32)
        unit = np.maximum(np.spacing(np.abs(rounded)), np.finfo(np.float32).smallest_subnormal).astype(np.float64)
    finite = np.isfinite(rounded)
    np.testing.assert_array_equal(found[~finite], rounded[~finite])
    assert np.max(np.abs(found - exact)[finite] / unit[finite]) <= units


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "expm1", "tanh"])
def test_what_is_no_number_of_single_precision(name: str) -> None:
    x = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0], np.float32)
    with np.errstate(invalid="ignore"):
        expected = getattr(np, name)(x)
    (found,) = run(program_of([OPERATIONS[name]], np.float32, 1), NARROW, x)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.signbit(found[3:]), np.signbit(expected[3:]))


# ---- kinds of kernel bodies ------------------------------------------------------------------------------------------


def _arm(chain: Chain) -> tx.Dynamics:
    q, qd, tau = tx.State("q", shape=(7,)), tx.State("qd", shape=(7,)), tx.Control("tau", shape=(7,))
    rates = {q: qd, qd: forward_dynamics(chain, q, qd, tau)}
    return tx.compile(tx.System(rates=rates), backend=tx.Native())


def _body() -> tx.Dynamics:
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    M = np.diag([2.0, 2.0, 2.0, 1.0, 2.0, 3.0])
    rate = tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))
    return tx.compile(tx.System(rates={g: V, V: rate}), backend=tx.Native())


def _many(dtype: Any) -> dict[str, Any]:
    turning = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 6))
    return {"g": np.broadcast_to(np.eye(4), (3, 4, 4)).astype(dtype), "V": turning.astype(dtype)}


def _straight(dtype: Any) -> None:
    arm, x = _arm(chain_models.panda()), np.full((3, 7), 0.3, dtype)
    jax.vmap(lambda x: arm(0.0, {"q": x, "qd": x}, {"tau": x}))(x)


def _derivative(dtype: Any) -> None:
    arm, x = _arm(chain_models.panda()), np.full((3, 7), 0.3, dtype)
    jax.vmap(lambda x: arm.jacobian(0.0, {"q": x, "qd": x}, {"tau": x}))(x)


def _fixed_steps(dtype: Any) -> None:
    body = _body()
    jax.vmap(lambda x: tx.integrate(body, x, t1=1.0, dt=0.1).xs)(_many(dtype))


def _adaptive_steps(dtype: Any) -> None:
    body = _body()
    jax.vmap(lambda x: tx.integrate(body, x, t1=1.0, rtol=1e-4).xs)(_many(dtype))


def _saved_rows(dtype: Any) -> None:
    body = _body()
    given: list[dict[str, Any]] = [{"rtol": 1e-4}, {"dt": 0.1}]
    for steps in given:
        jax.vmap(lambda x, s=steps: tx.integrate(body, x, t1=1.0, save_at=np.linspace(0.0, 1.0, 5), **s).xs)(
            _many(dtype)
        )


def _scanned(dtype: Any) -> None:
    def walk(x: Any) -> Any:
        def step(x: Any, k: Any) -> Any:
            return x + 0.01 * jnp.tanh(jnp.sin(x) * jnp.exp(-x) + k), x

        return jax.lax.scan(step, x, jnp.linspace(0.0, 1.0, 400, dtype=dtype))

    jax.vmap(tx.fast(walk))(np.full((3, 3), 0.3, dtype))


def _searched(dtype: Any) -> None:
    def root(x: Any) -> Any:
        def better(x: Any) -> Any:
            return x - 0.5 * (jnp.log(x) - jnp.arctan2(x, 2.0 * x))

        return jax.lax.while_loop(lambda x: jnp.abs(jnp.log(x[0]) - 0.4636476) > 1e-3, better, x)

    jax.vmap(tx.fast(root))(np.linspace(1.0, 3.0, 9, dtype=dtype).reshape(3, 3))


KINDS: dict[str, Callable[[Any], None]] = {
    "straight": _straight,
    "derivative": _derivative,
    "fixed steps": _fixed_steps,
    "adaptive steps": _adaptive_steps,
    "saved rows": _saved_rows,
    "scan": _scanned,
    "while": _searched,
}


@functools.cache
def bodies_of(kind: str, dtype: Any) -> list[KernelBody]:
    """The kernel bodies of one lane of all kernels that are made."""
    found: list[KernelBody] = []
    own = backend.Host.kernel

    def kernel(self: Any, body: Any, form: Any, more: Any, single: bool, threads: Any) -> Any:
        found.append(body(form, 1, *more))
        return own(self, body, form, more, single, threads)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backend.Host, "kernel", kernel)
        KINDS[kind](dtype)
    assert found
    return found


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("kind", KINDS)
def test_the_language_of_devices_gives_what_numpy_gives(kind: str, dtype: Any) -> None:
    """The same instructions, compiled for this processor."""
    for body in bodies_of(kind, dtype):
        check_kernel(HostKernel(body, NARROW))


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("kind", KINDS)
def test_ptx_of_each_kind(kind: str, dtype: Any, tmp_path: Path) -> None:
    """It is assembled too where NVIDIA's assembler is installed; in single precision no value spills.

    A long program was compiled for this processor before: its order of instructions is an option of the process.
    """
    compiled("", Processor.host(), long=True)
    for body in _by_columns(bodies_of(kind, dtype)):
        module = Module(ptx.device((9, 0)))
        ptx.write_kernel(module, body)
        if module.library and ptx.libdevice() is None:
            pytest.skip("it calls functions of CUDA's libdevice.10.bc, which is not installed")
        text = ptx.assembled(module, module.text(), not isinstance(body, Straight))
        assert f".entry {ptx.ENTRY}(" in text
        if dtype == np.float32:  # but for the angles that are far, in functions of the library
            assert "fma.rn.f64" not in text[text.index(".entry") :]
        assembler = _assembler()
        if assembler is not None:
            file = tmp_path / "kernel.ptx"
            file.write_text(text)
            command = [assembler, "-v", "-arch=sm_90", str(file), "-o", str(tmp_path / "kernel.cubin")]
            ran = subprocess.run(command, capture_output=True, text=True)
            assert ran.returncode == 0, ran.stderr
            # Whole, the derivative spills 1,600 bytes.
            assert dtype == np.float64 or set(re.findall(r"(\d+) bytes spill stores", ran.stderr)) == {"0"}


def _by_columns(bodies: list[KernelBody]) -> list[KernelBody]:
    """With large programs in parts, as devices run them."""
    straight = [columns.parts(body.program) if isinstance(body, Straight) else None for body in bodies]
    parts = [[body] if made is None else [Straight(part, 1) for part in made] for body, made in zip(bodies, straight)]
    return [part for each in parts for part in each]


def _assembler() -> str | None:
    """NVIDIA's assembler of PTX, of a toolkit or of the package nvidia-cuda-nvcc."""
    library = ptx.libdevice()
    beside = [library.parents[2] / "bin" / "ptxas"] if library else []
    return next((str(path) for path in beside if path.is_file()), shutil.which("ptxas"))


# ---- the handler -----------------------------------------------------------------------------------------------------


class _Frame:
    """A call as XLA makes it, of buffers in memory. Structures are those of xla/ffi/api/c_api.h."""

    def __init__(self, arguments: list[np.ndarray], results: list[np.ndarray], stream: int) -> None:
        self.kept: list[Any] = [*arguments, *results]
        self.errors: list[str] = []
        self.stream = stream
        pointer = ctypes.c_void_p
        create = ctypes.CFUNCTYPE(pointer, ctypes.POINTER(ctypes.c_int64))(self._error)
        stream_of = ctypes.CFUNCTYPE(pointer, ctypes.POINTER(ctypes.c_int64))(self._stream)
        api = (ctypes.c_int64 * 40)()
        api[4] = 0 | (3 << 32)  # version 0.3
        api[6], api[10] = (ctypes.cast(f, pointer).value for f in (create, stream_of))
        frame = (ctypes.c_int64 * 32)()
        frame[2] = ctypes.addressof(api)
        frame[7], frame[9] = len(arguments), self._buffers(arguments)
        frame[12], frame[14] = len(results), self._buffers(results)
        self.kept += [create, stream_of, api, frame]
        self.address = ctypes.addressof(frame)

    def _buffers(self, arrays: list[np.ndarray]) -> int:
        kinds = {"float64": 12, "float32": 11, "int64": 5, "int32": 4, "bool": 1}
        table = (ctypes.c_int64 * max(len(arrays), 1))()
        for k, array in enumerate(arrays):
            dims = (ctypes.c_int64 * 2)(*array.shape)
            own = (ctypes.c_int64 * 6)(48, 0, kinds[array.dtype.name], array.ctypes.data, 2, ctypes.addressof(dims))
            table[k] = ctypes.addressof(own)
            self.kept += [dims, own]
        self.kept.append(table)
        return ctypes.addressof(table)

    def _error(self, arguments: Any) -> int:
        self.errors.append(ctypes.string_at(arguments[2]).decode())
        return 1

    def _stream(self, arguments: Any) -> int:
        arguments[3] = self.stream
        return 0


_LAUNCH = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *[ctypes.c_uint] * 7, *[ctypes.c_void_p] * 3)


@pytest.mark.parametrize("code", [0, 719])
@pytest.mark.parametrize("kind", ["scan", "saved rows"])
def test_a_handler_starts_a_thread_for_each_row(kind: str, code: int) -> None:
    """What stands for the driver reads the parameters as the device would."""
    body, rows = bodies_of(kind, np.float64)[-1], 130
    module = Module(Processor.host())
    handler.write_device_handler(module, body, 64)
    made = load(compiled(module.text(), module.processor), (), module.processor, ("handler", "kernel", "launch"))

    def of(arrays: list[Array], count: int) -> list[np.ndarray]:
        return [np.zeros((count, a.size * (5 if a.long else 1)), a.dtype) for a in arrays]

    arguments = of([body.arguments[k] for k in body.read], rows)
    arguments[0] = arguments[0][:1]  # all rows share it
    arrays = [*arguments, *of([body.results[k] for k in body.written], rows)]
    seen: list[Any] = []

    def launch(*given: Any) -> int:
        places = (ctypes.c_void_p * (2 * len(arrays) + 1)).from_address(given[9])
        seen.append((given[:9], [ctypes.c_int64.from_address(place).value for place in places]))
        return code

    kept = _LAUNCH(launch)
    ctypes.c_void_p.from_address(made.addresses["kernel"]).value = 4711
    ctypes.c_void_p.from_address(made.addresses["launch"]).value = ctypes.cast(kept, ctypes.c_void_p).value
    frame = _Frame(arguments, arrays[len(arguments) :], stream=815)
    answered = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(made.addresses["handler"])(frame.address)
    strides = [len(a) for a in arrays]  # of arrays by columns
    assert seen == [((4711, 3, 1, 1, 64, 1, 1, 0, 815), [*(a.ctypes.data for a in arrays), *strides, rows])]
    assert frame.errors == ([f"a kernel of twistax was not started: CUDA error {code}"] if code else [])
    assert bool(answered) == bool(code)


# ---- what decides ----------------------------------------------------------------------------------------------------


def test_programs_for_other_platforms_are_lowered_without_their_devices() -> None:
    assert not backend.TARGETS["cuda"].present
    body = _body()
    traced = jax.jit(jax.vmap(lambda x: body(0.0, x))).trace(_many(np.float64))
    assert "twistax_" not in traced.lower(lowering_platforms=("cuda",)).as_text()
