"""A tile as a compiled function of batches that JAX can call, and whether it does what its program says."""

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
from .handler import API, write_host_handler, write_places
from .kernel_body import Tile
from .machine_code import MachineCode, Processor, compiled, load, written_by

#: "As many threads as there are".
_ALL = 2**31

#: How many places for kernels are made together.
_PLACES_AT_ONCE = 64

#: Seconds for which code stays after its last kernel: XLA may be in the middle of a call that nobody waits for.
_REST = 30.0


class Lease(Protocol):
    """What kernels of one target hold of their code.

    Attributes:
        checked: whether it was seen to be right, by this process or another one.
        addresses: of `handler`, which XLA calls, and of other functions.
    """

    @property
    def checked(self) -> bool: ...

    @property
    def code(self) -> Any:
        """What keeps the functions in memory; it has their `addresses`."""

    def keep(self) -> None:
        """It was seen to be right: other processes need not compile it."""


class HostLease:
    """Of machine code of a processor.

    What comes from the cache was seen to be right, under the same versions of all that runs it.
    """

    def __init__(self, target: str, text: str, module: Module, names: Sequence[str]) -> None:
        self._key = digest(target, version(), *jax_versions())
        written = cache.kept(self._key)
        self._unchecked = None
        if written is None:
            written = self._unchecked = compiled(text, module.processor, module.long, bool(module.packed))
        self.code = load(written, module.library, module.processor, names, module.addresses)

    @property
    def checked(self) -> bool:
        return self._unchecked is None

    def keep(self) -> None:
        if self._unchecked is not None:
            cache.keep(self._key, self._unchecked)
            self._unchecked = None


#: The kernels that are in use, by the name of their target; and code that is not, with the time since when.
_CODE: weakref.WeakValueDictionary[str, Lease] = weakref.WeakValueDictionary()
_RESTING: list[tuple[float, ctypes.c_void_p, Any]] = []

#: The address of the place where the handler of a target finds its kernel. XLA keeps targets as long as the process
#: lives, so what it keeps are small handlers that look there.
_PLACES: dict[str, int] = {}
_FREE: list[tuple[int, int]] = []
_HANDLERS: list[MachineCode] = []

#: XLA takes a name once: threads that make the same kernel wait for the first.
_LOCK = threading.Lock()


class Kernel(ABC):
    """A tile as a function of batches that JAX can call.

    Attributes:
        target: what JAX calls it by.
        platform: of JAX, on which it runs.
        lease: holds its code.
        checked_rows: how many rows a check computes.
    """

    platform: str
    checked_rows: int

    def __init__(self, tile: Tile, target: str) -> None:
        self.tile, self.target = tile, target
        self._read = [tile.arguments[k] for k in tile.read]
        self._written = [tile.results[k] for k in tile.written]
        #: Of what is read what results stand in the place of.
        self._in_place = {tile.read.index(k): tile.written.index(own) for own, k in tile.in_place.items()}
        with _LOCK:
            _free()
            found = _CODE.get(target)
            if found is None:
                found = self._leased()
                _register(target, found, self.platform)
        self.lease: Any = found

    @abstractmethod
    def _leased(self) -> Lease:
        """The code, compiled or from the cache."""

    @abstractmethod
    def run(self, arguments: Sequence[NDArray[Any]], length: int = 0) -> list[NDArray[Any]]:
        """The results that are not empty, for arguments that the kernel reads, (rows, entries) each; without JAX."""

    def _arrays(self, arguments: Sequence[NDArray[Any]], length: int) -> tuple[int, list[NDArray[Any]]]:
        """The number of rows; the arguments, and the results: zeros, or what they stand in place of."""
        rows = max(map(len, arguments), default=1)
        given = [np.ascontiguousarray(a, t.dtype) for a, t in zip(arguments, self._read, strict=True)]
        results = [np.zeros((rows, math.prod(a.of_length(length))), a.dtype) for a in self._written]
        for k, own in self._in_place.items():
            results[own][:] = given[k]
        return rows, [*given, *results]

    def __call__(self, rows: int, *arguments: jax.Array, length: int = 0) -> list[jax.Array]:
        """The results for rows of arguments, each (rows, *shape), or (1, *shape) where all share one; traceable.

        Args:
            length: of the first axis of long arguments and results.
        """
        given = [jnp.reshape(arguments[k], (len(arguments[k]), -1)) for k in self.tile.read]
        types = [jax.ShapeDtypeStruct((rows, math.prod(a.of_length(length))), a.dtype) for a in self._written]
        for k, own in self._in_place.items():
            given[k] = jnp.broadcast_to(given[k], types[own].shape)
        major_first = (1, 0) if self.tile.by_columns else (0, 1)
        call = jax.ffi.ffi_call(
            self.target,
            types,
            input_output_aliases=self._in_place,
            input_layouts=[major_first] * len(given),
            output_layouts=[major_first] * len(types),
        )
        found = dict(zip(self.tile.written, call(*given), strict=True))
        shapes = [(rows, *a.of_length(length)) for a in self.tile.results]
        return [
            jnp.reshape(found[k], shape) if k in found else jnp.zeros(shape, a.dtype)
            for k, (a, shape) in enumerate(zip(self.tile.results, shapes, strict=True))
        ]


class HostKernel(Kernel):
    """A kernel in machine code of a processor, for at most so many threads; all if None.

    Raises:
        ImportError: llvmlite is not installed.
        BuildError: no machine code came of it.
    """

    platform = "cpu"

    def __init__(self, tile: Tile, processor: Processor, threads: int | None = None) -> None:
        self.checked_rows = tile.lanes + 1
        self._module = Module(processor)
        tile.write(self._module)
        write_host_handler(self._module, tile, threads or _ALL)
        self._text = self._module.text()
        super().__init__(tile, named(self._text, processor))
        del self._module, self._text

    def _leased(self) -> Lease:
        return HostLease(self.target, self._text, self._module, ("run", "handler"))

    @property
    def symbol(self) -> tuple[str, int]:
        """What other code calls `run` by, and where it is."""
        return f"{self.target}.run", self.lease.code.addresses["run"]

    def run(self, arguments: Sequence[NDArray[Any]], length: int = 0) -> list[NDArray[Any]]:
        rows, arrays = self._arrays(arguments, length)
        strides = [a.shape[1] if len(a) == rows else 0 for a in arrays]
        table = (ctypes.c_int64 * (2 * len(arrays)))(*(a.ctypes.data for a in arrays), *strides)
        if rows:
            call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(
                self.lease.code.addresses["run"]
            )
            call(ctypes.addressof(table), 0, rows)
        return arrays[len(arguments) :]


def _register(target: str, lease: Lease, platform: str) -> None:
    """Make the code what XLA calls by the name of a target, for as long as it is there."""
    address, fresh = lease.code.addresses["handler"], target not in _PLACES
    if fresh:
        if not _FREE:
            module = Module(Processor.host())
            names = write_places(module, _PLACES_AT_ONCE)
            text = module.text()
            handlers = HostLease(named(text, module.processor), text, module, [*names, "places"])
            handlers.keep()
            _HANDLERS.append(handlers.code)
            first = handlers.code.addresses["places"]
            _FREE.extend((first + 8 * k, handlers.code.addresses[name]) for k, name in enumerate(names))
        _PLACES[target], handler = _FREE.pop()
    place = ctypes.c_void_p.from_address(_PLACES[target])
    place.value = address
    if fresh:
        capsule = jax.ffi.pycapsule(ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(handler))
        jax.ffi.register_ffi_target(target, capsule, platform={"cpu": "cpu", "cuda": "CUDA"}[platform])
    _CODE[target] = lease
    weakref.finalize(lease, _rest, place, lease.code)


def _rest(place: ctypes.c_void_p, code: Any) -> None:
    """Its last kernel is gone."""
    _RESTING.append((time.monotonic(), place, code))


def _free() -> None:
    """Let code go that has rested for long enough; the same kernel may have been made anew since."""
    while _RESTING and time.monotonic() - _RESTING[0][0] > _REST:
        _, place, code = _RESTING.pop(0)
        if place.value == code.addresses["handler"]:
            place.value = None


def named(text: str, processor: Processor) -> str:
    """A target: it says what it does and for which processor, so that it is the same in every process."""
    return f"twistax_{digest(text, written_by(processor), str(API))[:32]}"


def digest(*parts: str) -> str:
    """A short name of texts."""
    return hashlib.sha256(chr(0).join(parts).encode()).hexdigest()
