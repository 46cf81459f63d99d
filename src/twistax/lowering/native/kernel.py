"""A tile as a compiled function of batches that JAX can call."""

from __future__ import annotations

import ctypes
import hashlib
import threading
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from .code import Module
from .driver import write_driver
from .handler import API, write_handler
from .machine_code import load
from .processor import Processor
from .rows import Array
from .tile import Signature, Tile

__all__ = ["Kernel"]

#: "As many threads as there are".
_ALL = 2**31

#: The kernels that XLA knows, by the name of their target.
_REGISTERED: dict[str, dict[str, int]] = {}

#: XLA takes a name once: threads that make the same kernel wait for the first.
_LOCK = threading.Lock()


class Kernel:
    """A tile in machine code.

    Args:
        tile: what computes some rows.
        processor: the one to write for.
        threads: the most to use; all if None.
    Raises:
        ImportError: llvmlite is not installed.
        BuildError: no machine code came of it.
    """

    def __init__(self, tile: Tile, processor: Processor, threads: int | None = None) -> None:
        self.tile = tile
        self.signature: Signature = tile.signature
        module = Module(processor)
        tile.write(module)
        write_driver(module, self.signature.arrays, self.signature.names, tile.lanes, tile.chunk)
        arguments, results = list(self.signature.arguments.values()), list(self.signature.results.values())
        write_handler(module, arguments, results, threads or _ALL)
        text = module.text()
        #: Says what it does and for which processor, so that it is the same in every process.
        self.target = _name(text, processor)
        with _LOCK:
            if self.target not in _REGISTERED:
                found = load(text, module, ("run", "handler"))
                handler = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(found["handler"])
                jax.ffi.register_ffi_target(self.target, jax.ffi.pycapsule(handler), platform="cpu")
                _REGISTERED[self.target] = found
        self._run = _REGISTERED[self.target]["run"]

    def __call__(self, rows: int, *arguments: jax.Array) -> list[jax.Array]:
        """The results for rows of arguments, (rows, *shape) each; traceable."""
        given = [jnp.reshape(arguments[k], (rows, array.size)) for k, array in self.signature.arguments.items()]
        types = [jax.ShapeDtypeStruct((rows, array.size), array.dtype) for array in self.signature.results.values()]
        found = dict(zip(self.signature.results, jax.ffi.ffi_call(self.target, types)(*given), strict=True))
        return [
            jnp.reshape(found[k], (rows, *shape)) if k in found else jnp.zeros((rows, *shape), dtype)
            for k, (shape, dtype) in enumerate(self.tile.results)
        ]

    def run(self, arguments: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        """The results that are not empty, for arguments that the kernel reads, (rows, entries) each; without JAX."""
        rows = len(arguments[0]) if arguments else 1
        given = [np.ascontiguousarray(a, t.dtype) for a, t in zip(arguments, self._read, strict=True)]
        results = [np.empty((rows, array.size), array.dtype) for array in self.signature.results.values()]
        table = (ctypes.c_void_p * (len(given) + len(results)))(*(a.ctypes.data for a in (*given, *results)))
        if rows:
            call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(self._run)
            call(ctypes.addressof(table), 0, rows)
        return results

    @property
    def _read(self) -> list[Array]:
        return list(self.signature.arguments.values())


def _name(text: str, processor: Processor) -> str:
    import llvmlite

    parts = (text, processor.name, processor.features, llvmlite.__version__, str(API))
    return f"twistax_{hashlib.sha256(chr(0).join(parts).encode()).hexdigest()[:32]}"
