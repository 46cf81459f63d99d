"""The targets of kernels: what makes a kernel of a kernel body on each platform of JAX."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from ....jax_inside import backends
from ...program import ScalarProgram
from .cuda_kernel import CudaKernel
from .kernel import HostKernel, Kernel
from .kernel_body import KernelBody
from .machine_code import Processor


class Target(ABC):
    """A platform."""

    @property
    @abstractmethod
    def present(self) -> bool:
        """Whether this process has devices of it. Programs may be lowered for others: those run as XLA has them."""

    @abstractmethod
    def kernel(
        self, kind: type[KernelBody], form: ScalarProgram, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        """The kernel of a kernel body.

        Args:
            kind: the body, made of a program in its native form, the lanes, and more.
            single: whether it is for one member.
            threads: of the processor, at most; None: all.
        Raises:
            ImportError: llvmlite is not installed.
            BuildError: no code came of it.
        """


class Host(Target):
    """This processor: as many members side by side as a vector has lanes."""

    present = True

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

    def kernel(
        self, kind: type[KernelBody], form: ScalarProgram, more: tuple[Any, ...], single: bool, threads: int | None
    ) -> Kernel:
        return CudaKernel(kind(form, 1, *more))


#: By the names that JAX has for platforms.
TARGETS: Mapping[str, Target] = {"cpu": Host(), "cuda": Cuda()}
