"""A kernel body as a compiled function of batches that JAX can call."""

from __future__ import annotations

import ctypes
import hashlib
import math
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ....jax_inside import jax_versions
from ... import kernel_cache as cache
from ...kernel_cache import version
from .code import Module
from .handler import API, write_host_handler, write_slots
from .kernel_body import KernelBody
from .machine_code import MachineCode, Processor, compiled, load, written_by

#: "As many threads as there are".
_ALL = 2**31

#: The number of handler slots in a module.
_SLOTS_AT_ONCE = 64

#: Seconds before retired code is freed: an asynchronous call of XLA may still run it.
_RETIREMENT = 30.0


class CodeHandle(Protocol):
    """The code that all kernels of one target share."""

    @property
    def checked(self) -> bool:
        """Whether it passed the self-test, in this process or another one."""

    @property
    def code(self) -> Any:
        """The functions in memory, with their `addresses`: of `handler`, which XLA calls, and of others."""

    def keep(self) -> None:
        """Keep the code in the cache after it passed the self-test, so that other processes need not compile it."""


class HostCodeHandle:
    """The machine code that all kernels of one target share.

    Code from the cache has passed the self-test, under the same versions of twistax, JAX and llvmlite.
    """

    def __init__(self, target: str, text: str, module: Module, names: Sequence[str]) -> None:
        self._key = digest(target, version(), *jax_versions())
        written = cache.kept(self._key)
        self._unchecked = None
        if written is None:
            written = self._unchecked = compiled(text, module.processor, module.long, bool(module.packed))
        self.code = load(written, module.library, module.processor, names, module.addresses, module.groups)
        self.code.called = module.called

    @property
    def checked(self) -> bool:
        return self._unchecked is None

    def keep(self) -> None:
        if self._unchecked is not None:
            cache.keep(self._key, self._unchecked)
            self._unchecked = None


#: The code of kernels in use, by the name of their target; and retired code, with the time of its retirement.
_CODE: weakref.WeakValueDictionary[str, CodeHandle] = weakref.WeakValueDictionary()
_RETIRED: list[tuple[float, ctypes.c_void_p, Any]] = []

#: By target, the address of the handler slot with the address of its kernel. XLA keeps targets as long as the process
#: lives, so they are small handlers that read their slot.
_SLOTS: dict[str, int] = {}
_FREE: list[tuple[int, int]] = []
_HANDLERS: list[MachineCode] = []

#: XLA registers a name once: other threads that make the same kernel wait.
_LOCK = threading.Lock()


class Kernel(ABC):
    """A kernel body as a function of batches that JAX can call.

    Attributes:
        target: the name by which JAX calls it.
        platform: the platform of JAX on which it runs.
        layout: the axes of its arrays (rows, entries), the one of the longest stride first.
        handle: its code.
        checked_rows: the rows that the self-test computes.
    """

    platform: str
    layout: tuple[int, int]
    checked_rows: int

    def __init__(self, body: KernelBody, target: str) -> None:
        self.body, self.target = body, target
        self._read = [body.arguments[k] for k in body.read]
        self._written = [body.results[k] for k in body.written]
        #: The operands that results overwrite.
        self._in_place = {body.read.index(k): body.written.index(result) for result, k in body.in_place.items()}
        with _LOCK:
            _free()
            handle = _CODE.get(target)
            if handle is None:
                handle = self._make_handle()
                _register(target, handle, self.platform)
        self.handle: Any = handle

    @abstractmethod
    def _make_handle(self) -> CodeHandle:
        """The code, compiled or from the cache."""

    @abstractmethod
    def run(self, arguments: Sequence[NDArray[Any]], length: int = 0) -> list[NDArray[Any]]:
        """The results that are not empty, for arguments that the kernel reads, (rows, entries) each; without JAX."""

    def _arrays(self, arguments: Sequence[NDArray[Any]], length: int) -> tuple[int, list[NDArray[Any]]]:
        """The number of rows; the arguments, and the results: zeros, or what they stand in place of."""
        rows = max(map(len, arguments), default=1)
        operands = [np.ascontiguousarray(a, t.dtype) for a, t in zip(arguments, self._read, strict=True)]
        results = [np.zeros((rows, math.prod(a.of_length(length))), a.dtype) for a in self._written]
        for k, result in self._in_place.items():
            results[result][:] = operands[k]
        return rows, [*operands, *results]

    def __call__(self, rows: int, *arguments: jax.Array, length: int = 0) -> list[jax.Array]:
        """The results for rows of arguments, each (rows, *shape), or (1, *shape) where all share one; traceable.

        Args:
            length: of the first axis of long arguments and results.
        """
        operands = [jnp.reshape(arguments[k], (len(arguments[k]), -1)) for k in self.body.read]
        types = [jax.ShapeDtypeStruct((rows, math.prod(a.of_length(length))), a.dtype) for a in self._written]
        for k, result in self._in_place.items():
            operands[k] = jnp.broadcast_to(operands[k], types[result].shape)
        call = jax.ffi.ffi_call(
            self.target,
            types,
            input_output_aliases=self._in_place,
            # A row that all share lies alike in both, and XLA copies what is a constant where it is another than its.
            input_layouts=[self.layout if len(a) > 1 else (0, 1) for a in operands],
            output_layouts=[self.layout] * len(types),
        )
        results = dict(zip(self.body.written, call(*operands), strict=True))
        shapes = [(rows, *a.of_length(length)) for a in self.body.results]
        return [
            jnp.reshape(results[k], shape) if k in results else jnp.zeros(shape, a.dtype)
            for k, (a, shape) in enumerate(zip(self.body.results, shapes, strict=True))
        ]


class HostKernel(Kernel):
    """A kernel in machine code of a processor, for at most this number of threads; None means all.

    Raises:
        ImportError: llvmlite is not installed.
        BuildError: no machine code came of it.
    """

    platform, layout = "cpu", (0, 1)

    def __init__(self, body: KernelBody, processor: Processor, threads: int | None = None) -> None:
        self.checked_rows = body.lanes + 1
        self._module = Module(processor)
        body.write(self._module)
        write_host_handler(self._module, body, threads or _ALL)
        self._text = self._module.text()
        super().__init__(body, named(self._text, processor))
        del self._module, self._text

    def _make_handle(self) -> CodeHandle:
        return HostCodeHandle(self.target, self._text, self._module, ("run", "handler"))

    @property
    def symbol(self) -> tuple[str, int]:
        """The name and the address of `run`, for other code."""
        return f"{self.target}.run", self.handle.code.addresses["run"]

    def run(self, arguments: Sequence[NDArray[Any]], length: int = 0) -> list[NDArray[Any]]:
        rows, arrays = self._arrays(arguments, length)
        strides = [a.shape[1] if len(a) == rows else 0 for a in arrays]
        table = (ctypes.c_int64 * (2 * len(arrays)))(*(a.ctypes.data for a in arrays), *strides)
        if rows:
            call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(
                self.handle.code.addresses["run"]
            )
            call(ctypes.addressof(table), 0, rows)
        return arrays[len(arguments) :]


def _register(target: str, handle: CodeHandle, platform: str) -> None:
    """Let XLA call the code by the name of its target, until the code is retired."""
    address, fresh = handle.code.addresses["handler"], target not in _SLOTS
    if fresh:
        if not _FREE:
            module = Module(Processor.host())
            names = write_slots(module, _SLOTS_AT_ONCE)
            text = module.text()
            handlers = HostCodeHandle(named(text, module.processor), text, module, [*names, "places"])
            handlers.keep()
            _HANDLERS.append(handlers.code)
            first = handlers.code.addresses["places"]
            _FREE.extend((first + 8 * k, handlers.code.addresses[name]) for k, name in enumerate(names))
        _SLOTS[target], handler = _FREE.pop()
    place = ctypes.c_void_p.from_address(_SLOTS[target])
    place.value = address
    if fresh:
        capsule = jax.ffi.pycapsule(ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(handler))
        jax.ffi.register_ffi_target(target, capsule, platform={"cpu": "cpu", "cuda": "CUDA"}[platform])
    _CODE[target] = handle
    weakref.finalize(handle, _retire, place, handle.code)


def _retire(place: ctypes.c_void_p, code: Any) -> None:
    """Retire code whose last kernel is gone."""
    _RETIRED.append((time.monotonic(), place, code))


def _free() -> None:
    """Free code that has been retired for long enough, unless the same kernel has been made again."""
    while _RETIRED and time.monotonic() - _RETIRED[0][0] > _RETIREMENT:
        _, place, code = _RETIRED.pop(0)
        if place.value == code.addresses["handler"]:
            place.value = None


def is_in_use(target: str) -> bool:
    """Whether a kernel with the name of a target is in use."""
    return target in _CODE


def named(text: str, processor: Processor) -> str:
    """The name of a target, derived from its code and its processor, so that it is the same in every process."""
    return f"twistax_{digest(text, written_by(processor), str(API))[:32]}"


def digest(*parts: str) -> str:
    """A short name of texts."""
    return hashlib.sha256(chr(0).join(parts).encode()).hexdigest()
