"""What kernels need to know of a processor."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

__all__ = ["Processor"]


@dataclasses.dataclass(frozen=True)
class Processor:
    """A processor as LLVM names it, and what its vectors can do.

    Attributes:
        name: for LLVM.
        features: for LLVM, as "+avx2,-avx512f".
        bits: of a vector.
        fma: whether a b + c is one instruction with one rounding.
        masks: whether parts of vectors are read and written at no cost.
    """

    name: str
    features: str
    bits: int
    fma: bool
    masks: bool

    def lanes(self, dtype: np.dtype[Any]) -> int:
        """How many numbers of a floating-point type go into a vector."""
        return self.bits // (8 * dtype.itemsize)

    @classmethod
    def host(cls) -> Processor:
        """The one that runs this.

        Raises:
            ImportError: llvmlite is not installed.
        """
        import llvmlite.binding as llvm

        features = llvm.get_host_cpu_features()
        bits = 512 if features.get("avx512f") else 256 if features.get("avx2") else 128
        fma = bool(features.get("fma")) or llvm.get_default_triple().startswith(("aarch64", "arm64"))
        return cls(llvm.get_host_cpu_name(), features.flatten(), bits, fma, bool(features.get("avx512f")))
