"""The targets of kernels: each makes a kernel from a kernel body for one platform of JAX."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from ....jax_inside import backends
from ...program import ScalarProgram
from ..cuda.driver import driver
from ..cuda.kernel import CudaKernel
from ..cuda.ptx import libdevice
from .kernel import HostKernel, Kernel
from .kernel_body import KernelBody
from .machine_code import BuildError, Processor


class Target(ABC):
    """A platform."""

    @property
    @abstractmethod
    def present(self) -> bool:
        """Whether this process has such devices. Programs that are lowered for other platforms run by XLA."""

    @property
    @abstractmethod
    def note(self) -> str:
        """How native programs run here, for `explain`; empty on the processor."""

    @abstractmethod
    def kernel(
        self, kind: type[KernelBody], form: ScalarProgram, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        """The kernel of a kernel body.

        Args:
            kind: the class of the body, which takes a program in native form, the lanes, and `more`.
            single: whether it is for one member.
            threads: of the processor, at most; None: all.
        Raises:
            ImportError: llvmlite is not installed.
            BuildError: it could not be compiled.
        """


class Host(Target):
    """This processor: as many members side by side as a vector has lanes."""

    present, note = True, ""

    def kernel(
        self, kind: type[KernelBody], form: ScalarProgram, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        processor = Processor.host()
        return HostKernel(kind(form, 1 if single else processor.lanes(form.graph.dtype), *more), processor, threads)


class Cuda(Target):
    """Devices of CUDA: a thread for each member."""

    @property
    def present(self) -> bool:
        return "cuda" in backends()

    @property
    def note(self) -> str:
        try:
            major, minor = driver().capability
        except BuildError as error:
            return f"as XLA has them on CUDA devices: {error}"
        rest = "" if libdevice() else ", but by XLA where they call the C library: libdevice.10.bc is not installed"
        return f"in threads on CUDA devices of capability {major}.{minor}{rest}"

    def kernel(
        self, kind: type[KernelBody], form: ScalarProgram, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        return CudaKernel(kind(form, 1, *more))


#: By the names that JAX has for platforms.
TARGETS: Mapping[str, Target] = {"cpu": Host(), "cuda": Cuda()}


def on_all_platforms() -> bool:
    """Whether kernels can be made for all platforms of this process."""
    return all(name in TARGETS for name in backends())


def notes() -> str:
    """How native programs run on the devices of this process."""
    return "".join(f"; {target.note}" for target in TARGETS.values() if target.present and target.note)
