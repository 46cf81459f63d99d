"""A kernel body as a compiled function of batches that JAX can call, and its self-test."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import math
import threading
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ....jax_inside import jax_versions
from ... import kernel_cache as cache
from ...kernel_cache import version
from .code import Module, addressed
from .kernel_body import BatchFunction, KernelBody
from .lanes import Array
from .machine_code import BuildError, MachineCode, Processor, compiled, load, written_by

#: "As many threads as there are".
_ALL = 2**31

#: How many places for kernels are made together.
_SLOTS_AT_ONCE = 64

#: Seconds for which code stays after its last kernel is gone: an asynchronous call of XLA may still run it.
_RETIREMENT = 30.0


class _CodeHandle:
    """The machine code that kernels of one target share.

    What comes from the cache was seen to be right, under the same versions of all that runs it.
    """

    def __init__(self, target: str, text: str, module: Module, names: Sequence[str]) -> None:
        self._key = _digest(target, version(), *jax_versions())
        written = cache.kept(self._key)
        self._unchecked = None
        if written is None:
            written = self._unchecked = compiled(text, module.processor, module.long, bool(module.packed))
        self.code = load(written, module.library, module.processor, names, module.addresses)

    @property
    def checked(self) -> bool:
        return self._unchecked is None

    def keep(self) -> None:
        """Keep the code in the cache after it passed the self-test, so that other processes need not compile it."""
        if self._unchecked is not None:
            cache.keep(self._key, self._unchecked)
            self._unchecked = None


#: The kernels that are in use, by the name of their target; and code that is not, with the time since when.
_CODE: weakref.WeakValueDictionary[str, _CodeHandle] = weakref.WeakValueDictionary()
_RETIRED: list[tuple[float, ctypes.c_void_p, MachineCode]] = []

#: The address of the place where the handler of a target finds its kernel. XLA keeps targets as long as the process
#: lives, so what it keeps are small handlers that look there.
_SLOTS: dict[str, int] = {}
_FREE: list[tuple[int, int]] = []
_HANDLERS: list[MachineCode] = []

#: XLA registers a name once: threads that make the same kernel wait for the first.
_LOCK = threading.Lock()


class Kernel:
    """A kernel body in machine code of a processor, for at most so many threads; all if None.

    Raises:
        ImportError: llvmlite is not installed.
        BuildError: no machine code came of it.
    """

    def __init__(self, body: BatchFunction, processor: Processor, threads: int | None = None) -> None:
        self.body = body
        self._read = [body.arguments[k] for k in body.read]
        self._written = [body.results[k] for k in body.written]
        #: The operands that results overwrite.
        self._in_place = {body.read.index(k): body.written.index(result) for result, k in body.in_place.items()}
        module = Module(processor)
        body.write(module)
        _write_handler(module, body, threads or _ALL)
        text = module.text()
        #: Says what it does and for which processor, so that it is the same in every process.
        self.target = _name(text, processor)
        with _LOCK:
            _free()
            handle = _CODE.get(self.target)
            if handle is None:
                handle = _CodeHandle(self.target, text, module, ("run", "handler"))
                _register(self.target, handle, processor)
        self.handle = handle

    @property
    def symbol(self) -> tuple[str, int]:
        """The name and the address of `run`, for other code."""
        return f"{self.target}.run", self.handle.code.addresses["run"]

    def __call__(self, rows: int, *arguments: jax.Array, length: int = 0) -> list[jax.Array]:
        """The results for rows of arguments, each (rows, *shape), or (1, *shape) where all share one; traceable.

        Args:
            length: of the first axis of long arguments and results.
        """
        operands = [jnp.reshape(arguments[k], (len(arguments[k]), -1)) for k in self.body.read]
        types = [jax.ShapeDtypeStruct((rows, math.prod(a.of_length(length))), a.dtype) for a in self._written]
        for k, result in self._in_place.items():
            operands[k] = jnp.broadcast_to(operands[k], types[result].shape)
        call = jax.ffi.ffi_call(self.target, types, input_output_aliases=self._in_place)
        results = dict(zip(self.body.written, call(*operands), strict=True))
        shapes = [(rows, *a.of_length(length)) for a in self.body.results]
        return [
            jnp.reshape(results[k], shape) if k in results else jnp.zeros(shape, a.dtype)
            for k, (a, shape) in enumerate(zip(self.body.results, shapes, strict=True))
        ]

    def run(self, arguments: Sequence[NDArray[Any]], length: int = 0) -> list[NDArray[Any]]:
        """The results that are not empty, for arguments that the kernel reads, (rows, entries) each; without JAX."""
        rows = max(map(len, arguments), default=1)
        operands = [np.ascontiguousarray(a, t.dtype) for a, t in zip(arguments, self._read, strict=True)]
        results = [np.zeros((rows, math.prod(a.of_length(length))), a.dtype) for a in self._written]
        for k, result in self._in_place.items():
            results[result][:] = operands[k]
        arrays = [*operands, *results]
        strides = [a.shape[1] if len(a) == rows else 0 for a in arrays]
        table = (ctypes.c_int64 * (2 * len(arrays)))(*(a.ctypes.data for a in arrays), *strides)
        if rows:
            call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(
                self.handle.code.addresses["run"]
            )
            call(ctypes.addressof(table), 0, rows)
        return results


def _register(target: str, handle: _CodeHandle, processor: Processor) -> None:
    """Let XLA call the code by the name of its target, until the code is retired."""
    address, fresh = handle.code.addresses["handler"], target not in _SLOTS
    if fresh:
        if not _FREE:
            module = Module(processor)
            names = _write_slots(module, _SLOTS_AT_ONCE)
            text = module.text()
            handlers = _CodeHandle(_name(text, processor), text, module, [*names, "places"])
            handlers.keep()
            _HANDLERS.append(handlers.code)
            first = handlers.code.addresses["places"]
            _FREE.extend((first + 8 * k, handlers.code.addresses[name]) for k, name in enumerate(names))
        _SLOTS[target], handler = _FREE.pop()
    place = ctypes.c_void_p.from_address(_SLOTS[target])
    place.value = address
    if fresh:
        capsule = jax.ffi.pycapsule(ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(handler))
        jax.ffi.register_ffi_target(target, capsule, platform="cpu")
    _CODE[target] = handle
    weakref.finalize(handle, _retire, place, handle.code)


def _retire(place: ctypes.c_void_p, code: MachineCode) -> None:
    """Retire code whose last kernel is gone."""
    _RETIRED.append((time.monotonic(), place, code))


def _free() -> None:
    """Free code that has been retired for long enough, unless the same kernel has been made again."""
    while _RETIRED and time.monotonic() - _RETIRED[0][0] > _RETIREMENT:
        _, place, code = _RETIRED.pop(0)
        if place.value == code.addresses["handler"]:
            place.value = None


def _name(text: str, processor: Processor) -> str:
    return f"twistax_{_digest(text, written_by(processor), str(_API))[:32]}"


def _digest(*parts: str) -> str:
    return hashlib.sha256(chr(0).join(parts).encode()).hexdigest()


# ---- the function that XLA calls, `kernel.ll`: what differs from kernel to kernel is filled in here ------------------

#: The version of the interface. XLA refuses a handler that is made for a version it does not know.
_API = (0, 3)

#: XLA's numbers of the types, `XLA_FFI_DataType`.
_DATA_TYPES = {"double": 12, "float": 11, "i64": 5, "i32": 4, "i1": 1}

#: What is called of LLVM and of the C library.
_DECLARED = {
    "declare ptr @malloc(i64)",
    "declare void @free(ptr)",
    "declare i32 @sched_yield()",
    "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)",
    "declare i64 @llvm.umin.i64(i64, i64)",
}

_BUFFER = """%right.{k} = call i1 @taken(ptr %{family}s, i64 {place}, i1 {shared}, i32 {type},
 i64 %rows, i64 {size}, ptr %table, i64 {k})
br i1 %right.{k}, label %check.{next}, label %wrong.{k}"""

#: The entries of a long array: how many there are at each place, times the length, which is the first argument.
_LONG = """%count.at.{k} = load ptr, ptr %table
%count.{k} = load i32, ptr %count.at.{k}
%length.{k} = sext i32 %count.{k} to i64
%size.{k} = mul i64 %length.{k}, {size}"""

_ERROR = """{label}:
%error.{label} = call ptr @failed(ptr %api, ptr @message.{label})
ret ptr %error.{label}"""

_POINTER = """%p{k} = getelementptr ptr, ptr %table, i64 {k}
%{name} = load ptr, ptr %p{k}
%s{k} = getelementptr ptr, ptr %table, i64 {stride}
%{name}.stride = load i64, ptr %s{k}"""

_MOVED = """%{name}.place = mul i64 %row, %{name}.stride
%{name}.row = getelementptr {stored}, ptr %{name}, i64 %{name}.place"""


@functools.cache
def _template() -> Template:
    return Template(Path(__file__).with_name("kernel.ll").read_text())


def _write_handler(module: Module, body: BatchFunction, threads: int) -> None:
    """Adds `run(table, first, end)`, some rows of the arrays in a table, and `handler(frame)`, all, by many threads."""
    arrays, read, results = body.arrays, len(body.read), len(body.written)
    major, minor = _API
    messages = {
        "wrong.version": f"a kernel of twistax is made for version {major}.{minor} of XLA's foreign-function interface",
        "wrong.count": f"a kernel of twistax takes {read} arguments and gives {results} results",
    }
    buffers = []
    for k, array in enumerate(arrays.values()):
        family, place = ("argument", k) if k < read else ("result", k - read)
        fields = {"k": k, "family": family, "place": place, "type": _DATA_TYPES[array.kind], "next": k + 1}
        size, words = (f"%size.{k}", f"length * {array.size}") if array.long else (str(array.size), str(array.size))
        buffers += [f"check.{k}:", *([_LONG.format(k=k, size=array.size)] if array.long else [])]
        buffers.append(_BUFFER.format(**fields, size=size, shared="true" if k < read else "false"))
        expected = f"{np.dtype(array.dtype).name} of shape (rows, {words})"
        messages[f"wrong.{k}"] = f"a kernel of twistax expects {expected} as {family} {place}"
    constants = [
        f'@message.{label} = private constant [{len(message) + 1} x i8] c"{message}\\00"'
        for label, message in messages.items()
    ]
    text = _template().substitute(
        messages="\n".join(constants),
        pointers="\n".join(_POINTER.format(k=k, name=name, stride=k + len(arrays)) for k, name in enumerate(arrays)),
        moved="\n".join(_MOVED.format(name=name, stored=a.stored) for name, a in arrays.items()),
        rows="".join(f", ptr %{name}.row, i64 %{name}.stride" for name in arrays),
        lanes=body.lanes,
        chunk=body.chunk,
        table=16 * len(arrays),
        job=32 + 16 * len(arrays),
        major=major,
        minor=minor,
        arguments=read,
        results=results,
        count=len(arrays),
        entries=2 * len(arrays),
        buffers="\n".join(buffers),
        threads=threads,
        errors="\n".join(_ERROR.format(label=label) for label in messages),
    )
    module.declarations |= _DECLARED
    module.library |= {"malloc", "free", "sched_yield"}
    module.functions["handler"] = addressed(text)


_PLACE = """define ptr @place.{k}(ptr %frame) #0 {{
%at = getelementptr ptr, ptr @places, i64 {k}
%kernel = load ptr, ptr %at
%gone = icmp eq ptr %kernel, null
br i1 %gone, label %none, label %there
there:
%found = tail call ptr %kernel(ptr %frame)
ret ptr %found
none:
%api = load ptr, ptr %frame + 16
%error = call ptr @failed(ptr %api, ptr @message)
ret ptr %error
}}"""


def _write_slots(module: Module, count: int) -> list[str]:
    """Add handlers that call the kernels whose addresses stand in the variable `places`; return their names."""
    message = "a kernel of twistax is called, and what it was compiled for is gone"
    failed = _template().template.partition("define internal ptr @failed")
    module.functions["places"] = "\n".join(
        [
            f"@places = global [{count} x ptr] zeroinitializer",
            f'@message = private constant [{len(message) + 1} x i8] c"{message}\\00"',
            addressed("".join(failed[1:]).partition("}")[0] + "}"),
            *(addressed(_PLACE.format(k=k)) for k in range(count)),
        ]
    )
    return [f"place.{k}" for k in range(count)]


# ---- the self-test, once for each kernel -----------------------------------------------------------------------------

#: Relative to the largest entry of a result: what is wrong differs by far more than rounding.
_TOLERANCE = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 1e-3}

#: Arguments are of size one: of a result smaller than this nothing but rounding may be left, as of a compensated sum.
_LEAST = 1e-3

#: Whether a call through JAX was right in this process.
_CALLED = False


def check_kernel(kernel: Kernel, body: KernelBody) -> None:
    """Compare a kernel with NumPy on random rows, one more than a vector has lanes; the first time in a process also
    through JAX.

    Once for each kernel: what was seen to be right is kept, also for other processes.

    Raises:
        BuildError: they differ.
    """
    if kernel.handle.checked:
        return
    random = np.random.default_rng(0)
    # What reads no arguments gives one row by itself.
    rows = body.lanes + 1 if body.read else 1
    arguments = body.exercised([_drawn(random, (rows, math.prod(a.of_length(body.tried))), a) for a in body.arguments])
    expected, nearby = body.plain(arguments), [body.plain([_moved(a) for a in arguments])]
    results = kernel.run([arguments[k] for k in body.read], body.tried)

    def agrees() -> bool:
        pairs = zip(body.written, results, strict=True)
        return all(_agree(values, expected[k], [near[k] for near in nearby]) for k, values in pairs)

    if not agrees():
        # Of nearly singular constants the arguments, moved once, may say nothing: each operation is moved.
        nearby += [body.plain(arguments, functools.partial(_rounded, random)) for _ in range(4)]
        if not agrees():
            raise BuildError("its results differ from those of NumPy")
    global _CALLED
    if not _CALLED:
        with jax.ensure_compile_time_eval(), jax.default_device(jax.local_devices(backend="cpu")[0]):
            shapes = ((rows, *a.of_length(body.tried)) for a in body.arguments)
            shaped = [a.reshape(shape) for a, shape in zip(arguments, shapes, strict=True)]
            called = jax.jit(lambda *values: kernel(rows, *values, length=body.tried))(*shaped)
        for k, result in zip(body.written, results, strict=True):
            by_jax = np.asarray(called[k]).reshape(result.shape)
            if not np.array_equal(by_jax, result, equal_nan=result.dtype.kind == "f"):
                raise BuildError("its results differ where JAX calls it")
        _CALLED = True
    kernel.handle.keep()


def _drawn(random: np.random.Generator, size: tuple[int, int], array: Array) -> NDArray[Any]:
    drawn = random.normal(size=size) if array.dtype.kind == "f" else random.integers(0, 2, size)
    return drawn.astype(array.dtype)


def _moved(values: NDArray[Any]) -> NDArray[Any]:
    """The next larger floating-point numbers: the change of the results shows the effect of rounding."""
    return np.nextafter(values, np.inf, dtype=values.dtype) if values.dtype.kind == "f" else values


def _rounded(random: np.random.Generator, values: NDArray[Any]) -> NDArray[Any]:
    """The next larger or smaller floating-point numbers, at random."""
    if values.dtype.kind != "f":
        return values
    return np.nextafter(values, random.choice([-np.inf, np.inf], values.shape), dtype=values.dtype)


def _agree(values: NDArray[Any], expected: NDArray[Any], nearby: Sequence[NDArray[Any]]) -> bool:
    if values.dtype.kind != "f":
        # A comparison of nearly equal numbers may fall either way.
        return bool(np.mean(values == expected) >= 0.5)
    finite = np.isfinite(expected) & np.all(np.isfinite(nearby), axis=0)
    if not finite.any():
        return True
    size = np.max(np.abs(expected[finite]), initial=_LEAST) * _TOLERANCE[values.dtype]
    moved = np.max([np.abs(near[finite] - expected[finite]) for near in nearby], axis=0)
    values, expected = values[finite], expected[finite]
    with np.errstate(invalid="ignore"):  # what is infinite where it should not be does not agree
        return bool(np.mean(np.abs(values - expected) <= size + 1e3 * moved) >= 0.9)
