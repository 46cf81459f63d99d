"""A kernel body as a kernel of CUDA devices that JAX can call."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....jax_inside import jax_versions
from ... import kernel_cache as cache
from ...kernel_cache import version
from ..llvm.code import Module
from ..llvm.handler import write_device_handler
from ..llvm.kernel import CodeHandle, HostCodeHandle, Kernel, digest, is_in_use, named
from ..llvm.kernel_body import KernelBody
from ..llvm.machine_code import Processor
from ..llvm.straight.body import Straight
from .driver import DeviceCode, driver
from .ptx import ENTRY, assembled, device, write_kernel

#: Threads in a block.
BLOCK = 64


class _Code:
    """The kernel on the devices, and the handler that starts it."""

    def __init__(self, handler: HostCodeHandle, ptx: bytes) -> None:
        self.device, self._handler = DeviceCode(ptx, ENTRY), handler.code
        self.addresses = self._handler.addresses
        for name, value in (("kernel", self.device.handle), ("launch", driver().address("cuLaunchKernel"))):
            ctypes.c_void_p.from_address(self.addresses[name]).value = value


class _DeviceCodeHandle:
    """The code of a kernel of CUDA devices. Code from the cache has passed the self-test with the same driver."""

    def __init__(self, target: str, module: Module, text: str, body: KernelBody) -> None:
        cuda = driver()
        self._key = digest(target, version(), *jax_versions(), str(cuda.version), str(cuda.capability))
        ptx = cache.kept(self._key)
        self._unchecked = None
        if ptx is None:
            ptx = self._unchecked = assembled(module, text, not isinstance(body, Straight)).encode()
        processor = Processor.host()
        around = Module(processor)
        write_device_handler(around, body, BLOCK)
        written = around.text()
        handler = HostCodeHandle(named(written, processor), written, around, ("handler", "kernel", "launch"))
        handler.keep()
        self.code = _Code(handler, ptx)

    @property
    def checked(self) -> bool:
        return self._unchecked is None

    def keep(self) -> None:
        if self._unchecked is not None:
            cache.keep(self._key, self._unchecked)
            self._unchecked = None


class CudaKernel(Kernel):
    """A kernel for the devices of this process.

    Raises:
        ImportError: llvmlite is not installed.
        BuildError: no code came of it, or CUDA's driver is not there.
    """

    platform, layout = "cuda", (1, 0)

    def __init__(self, body: KernelBody) -> None:
        self.checked_rows = BLOCK + 1
        module = Module(device(driver().capability))
        write_kernel(module, body)
        text = module.text()
        target = named(f"{text}; {BLOCK}", module.processor)
        # Outside of the lock of all kernels, so that the driver assembles several at once.
        self._made = None if is_in_use(target) else _DeviceCodeHandle(target, module, text, body)
        self._parts = module, text, body
        super().__init__(body, target)
        del self._parts, self._made

    def _make_handle(self) -> CodeHandle:
        return self._made or _DeviceCodeHandle(self.target, *self._parts)

    def run(self, arguments: Sequence[NDArray[Any]], length: int = 0) -> list[NDArray[Any]]:
        rows, arrays = self._arrays(arguments, length)
        arrays = [np.asfortranarray(a) for a in arrays]
        if rows:
            self.handle.code.device.run(arrays, list(map(len, arrays)), rows, BLOCK)
        return arrays[len(arguments) :]
