"""CUDA's driver through ctypes: devices, and code that is loaded for all of them.

Code belongs to no context: it is loaded once and runs in the context of the stream in which it is launched (CUDA Driver
API, Library Management). Contexts are the primary ones, which JAX and other libraries share; none is created or
changed.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import sys
import weakref
from collections.abc import Iterator, Sequence
from typing import Any

import jax
from numpy.typing import NDArray

from ..llvm.machine_code import BuildError

#: CUDA 12.0, the first with libraries that belong to no context.
_LEAST = 12000
#: Numbers of attributes: `CUdevice_attribute` and `CUfunction_attribute`.
_MAJOR, _MINOR, _LOCAL_BYTES, _REGISTERS = 75, 76, 3, 4

#: The functions that are called, with the types of their arguments: p pointer, i int, u unsigned int, z size.
_FUNCTIONS = {
    "cuInit": "u",
    "cuDriverGetVersion": "p",
    "cuDeviceGet": "pi",
    "cuDeviceGetAttribute": "pii",
    "cuDevicePrimaryCtxRetain": "pi",
    "cuCtxPushCurrent_v2": "p",
    "cuCtxPopCurrent_v2": "p",
    "cuCtxSynchronize": "",
    "cuMemAlloc_v2": "pz",
    "cuMemFree_v2": "p",
    "cuMemcpyHtoD_v2": "ppz",
    "cuMemcpyDtoH_v2": "ppz",
    "cuLibraryLoadData": "ppppuppu",
    "cuLibraryUnload": "p",
    "cuLibraryGetKernel": "ppp",
    "cuKernelGetAttribute": "pipi",
    "cuKernelGetFunction": "pp",
    "cuLaunchKernel": "puuuuuuuppp",
}
_TYPES = {"p": ctypes.c_void_p, "i": ctypes.c_int, "u": ctypes.c_uint, "z": ctypes.c_size_t}


class Driver:
    """The driver of this machine.

    Attributes:
        version: of CUDA, 1000 times the major one and 10 times the minor one.

    Raises:
        BuildError: there is none, or it is too old.
    """

    def __init__(self) -> None:
        name = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
        try:
            self._library = ctypes.CDLL(name)
        except OSError as error:
            raise BuildError(f"CUDA's driver {name} is not installed") from error
        version = ctypes.c_int()
        self._functions: dict[str, Any] = {}
        for name in ("cuInit", "cuDriverGetVersion"):
            self._declare(name)
        self("cuInit", 0)
        self("cuDriverGetVersion", ctypes.byref(version))
        self.version = version.value
        if self.version < _LEAST:
            raise BuildError(
                f"CUDA's driver supports CUDA {self.version // 1000}.{self.version % 1000 // 10}; 12.0 is needed"
            )
        for name in _FUNCTIONS:
            self._declare(name)

    def _declare(self, name: str) -> None:
        function = getattr(self._library, name, None)
        if function is None:
            raise BuildError(f"CUDA's driver has no {name}")
        function.argtypes, function.restype = [_TYPES[kind] for kind in _FUNCTIONS[name]], ctypes.c_int
        self._functions[name] = function

    def address(self, name: str) -> int:
        """Where a function is."""
        address = ctypes.cast(self._functions[name], ctypes.c_void_p).value
        assert address is not None
        return address

    def __call__(self, name: str, *arguments: Any) -> None:
        """Call a function.

        Raises:
            BuildError: it says that something is wrong.
        """
        code = self._functions[name](*arguments)
        if code:
            raise BuildError(f"{name}: CUDA error {code}")

    def attribute(self, name: str, *arguments: Any) -> int:
        """What a function says of an attribute."""
        value = ctypes.c_int()
        self(name, ctypes.byref(value), *arguments)
        return value.value

    @functools.cached_property
    def capability(self) -> tuple[int, int]:
        """The lowest compute capability of the devices that JAX has."""
        capabilities = []
        for ordinal in _ordinals():
            device = self.device(ordinal)
            kinds = (_MAJOR, _MINOR)
            capabilities.append(tuple(self.attribute("cuDeviceGetAttribute", kind, device) for kind in kinds))
        major, minor = min(capabilities)
        return major, minor

    def device(self, ordinal: int) -> int:
        device = ctypes.c_int()
        self("cuDeviceGet", ctypes.byref(device), ordinal)
        return device.value

    @functools.cache  # noqa: B019, there is one driver
    def _context(self, ordinal: int) -> ctypes.c_void_p:
        context = ctypes.c_void_p()
        self("cuDevicePrimaryCtxRetain", ctypes.byref(context), self.device(ordinal))
        return context

    @contextlib.contextmanager
    def current(self, ordinal: int) -> Iterator[None]:
        """The primary context of a device is that of this thread; afterwards it is the one from before."""
        self("cuCtxPushCurrent_v2", self._context(ordinal))
        try:
            yield
        finally:
            self("cuCtxPopCurrent_v2", ctypes.byref(ctypes.c_void_p()))


@functools.cache
def driver() -> Driver:
    """The driver. Raises BuildError if there is none of a sufficient version."""
    return Driver()


def _ordinals() -> list[int]:
    """The devices of JAX by the driver's numbers."""
    return [int(device.local_hardware_id or 0) for device in jax.local_devices(backend="cuda")]


class DeviceCode:
    """A kernel on all devices, for as long as this object lives.

    Attributes:
        handle: of the kernel, for the driver.
        registers, local: what a thread takes: registers, and bytes of memory for what does not fit into them.

    Raises:
        BuildError: the driver refuses the PTX.
    """

    def __init__(self, ptx: bytes, entry: str) -> None:
        cuda, ordinals, library, kernel = driver(), _ordinals(), ctypes.c_void_p(), ctypes.c_void_p()
        text = ctypes.create_string_buffer(ptx)
        cuda("cuLibraryLoadData", ctypes.byref(library), text, None, None, 0, None, None, 0)
        weakref.finalize(self, _unload, cuda, ordinals, library).atexit = False
        cuda("cuLibraryGetKernel", ctypes.byref(kernel), library, entry.encode())
        assert kernel.value is not None
        self.handle = kernel.value
        function = ctypes.c_void_p()
        for ordinal in ordinals:
            # Loaded now: not while XLA records a graph.
            with cuda.current(ordinal):
                cuda("cuKernelGetFunction", ctypes.byref(function), kernel)
        device = cuda.device(ordinals[0])
        self.registers = cuda.attribute("cuKernelGetAttribute", _REGISTERS, kernel, device)
        self.local = cuda.attribute("cuKernelGetAttribute", _LOCAL_BYTES, kernel, device)

    def run(self, arrays: Sequence[NDArray[Any]], strides: Sequence[int], rows: int, block: int) -> None:
        """Compute rows of arrays in memory, on the first device; each array is then as the device left it."""
        cuda = driver()
        with cuda.current(_ordinals()[0]), contextlib.ExitStack() as stack:
            places = []
            for array in arrays:
                place = ctypes.c_void_p()
                cuda("cuMemAlloc_v2", ctypes.byref(place), max(array.nbytes, 1))
                stack.callback(cuda, "cuMemFree_v2", place)
                if array.nbytes:
                    cuda("cuMemcpyHtoD_v2", place, array.ctypes.data, array.nbytes)
                places.append(place)
            values = [*places, *map(ctypes.c_int64, (*strides, rows))]
            pointers = (ctypes.c_void_p * len(values))(*(ctypes.addressof(value) for value in values))
            grid = (rows + block - 1) // block
            cuda("cuLaunchKernel", self.handle, grid, 1, 1, block, 1, 1, 0, None, pointers, None)
            cuda("cuCtxSynchronize")
            for array, place in zip(arrays, places, strict=True):
                if array.nbytes:
                    cuda("cuMemcpyDtoH_v2", array.ctypes.data, place, array.nbytes)


def _unload(cuda: Driver, ordinals: Sequence[int], library: ctypes.c_void_p) -> None:
    """Unload a library after all work on the devices."""
    with contextlib.suppress(BuildError):
        for ordinal in ordinals:
            with cuda.current(ordinal):
                cuda("cuCtxSynchronize")
        cuda("cuLibraryUnload", library)
