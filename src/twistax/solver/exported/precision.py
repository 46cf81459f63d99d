"""What the type of numbers decides in an exported program: literals, thresholds, and words of its header."""

from __future__ import annotations

import ctypes
import dataclasses
from typing import Any

import numpy as np

from ...scalar.targets.c import CType

#: Of options of the interior point, by how many epsilons they are at least: less would measure rounding.
_ROUNDING = {
    "tolerance": 1024.0,
    "violation": 32.0,
    "complementarity": 16.0,
    "acceptable": 1e4,
    "curvature": 32.0,
    "barrier_least": 1.0,
    "inertia_smallest": 1.0,
    "equality_softness": 8.0,
    "pivot": 128.0,
    "refinement_error": 256.0,
    "bound_relaxation": 8.0,
}


@dataclasses.dataclass(frozen=True)
class CodePrecision:
    """The type of numbers of a program."""

    real: CType

    @property
    def is_single(self) -> bool:
        return self.real.dtype == np.float32

    @property
    def bytes(self) -> int:
        """Of a number."""
        return self.real.dtype.itemsize

    @property
    def words(self) -> dict[str, str]:
        """What the header of a program says of it: the type, its name, and the functions of libm of the solver."""
        functions = ", ".join(f"{name}{self.real.suffix}" for name in ("log", "log10", "pow", "sqrt"))
        return {"real": self.real.name, "precision": "single" if self.is_single else "double", "library": functions}

    def literal(self, value: float) -> str:
        return self.real.literal(value)

    def at_least(self, value: float, epsilons: float) -> float:
        """A threshold that is no less than a multiple of the type's epsilon."""
        return max(float(value), epsilons * float(np.finfo(self.real.dtype).eps))

    def options(self, structure: ctypes.Structure, size: float) -> dict[str, float]:
        """Options of the interior point for the type.

        Args:
            size: the largest variable in its unit; violations are differences of variables.
        """
        kinds: Any = type(structure)._fields_
        values = {name: getattr(structure, name) for name, _ in kinds}
        least = {**_ROUNDING, "violation": _ROUNDING["violation"] * max(1.0, size)}
        return values | {name: self.at_least(values[name], count) for name, count in least.items()}
