"""What kernels need to know of a processor."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...errors import ModelError

__all__ = ["Processor"]

#: The levels of x86-64 that are narrower than a processor may be: bits of a vector -> LLVM's name, and whether a b + c
#: is one instruction: SSE2, and AVX2.
_LEVELS = {128: ("x86-64", False), 256: ("x86-64-v3", True)}


@dataclasses.dataclass(frozen=True)
class Processor:
    """A processor as LLVM names it, and what its vectors can do.

    Attributes:
        name: for LLVM.
        features: for LLVM, as "+avx2,-avx512f"; empty where the name says all.
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
    def host(cls, bits: int | None = None) -> Processor:
        """The one that runs this, or one with narrower vectors, whose code this one runs too.

        Args:
            bits: of a vector: 128 is SSE2 on x86-64 and NEON on ARM, 256 is AVX2, 512 is AVX-512. The widest if None.
        Raises:
            ImportError: llvmlite is not installed.
            ModelError: this processor has no such vectors.
        """
        import llvmlite.binding as llvm

        features = llvm.get_host_cpu_features()
        widest = 512 if features.get("avx512f") else 256 if features.get("avx2") else 128
        if bits is None or bits == widest:
            fma = bool(features.get("fma")) or llvm.get_default_triple().startswith(("aarch64", "arm64"))
            return cls(llvm.get_host_cpu_name(), features.flatten(), widest, fma, widest == 512)
        if bits not in _LEVELS or bits > widest:
            raise ModelError(f"Processor.host expects bits of at most {widest}, and 128, 256 or 512, got {bits}")
        name, fma = _LEVELS[bits]
        return cls(name, "", bits, fma, False)

    @classmethod
    def widths(cls) -> list[int]:
        """The bits of all vectors that this processor has, narrow ones first."""
        return [bits for bits in (128, 256, 512) if bits <= cls.host().bits]
