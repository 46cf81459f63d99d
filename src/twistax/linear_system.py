"""Linear systems with names: what a steady motion is to who designs a controller for it."""

from __future__ import annotations

import dataclasses
import importlib
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from .checks import listed
from .errors import InputError, ModelError

__all__ = ["LinearSystem", "Mode"]

Array = np.ndarray


@dataclasses.dataclass(frozen=True)
class Mode:
    """A motion of a linear system: an eigenvalue, or a pair of conjugate ones.

    Attributes:
        eigenvalue: the one with the imaginary part that is not negative, 1/s.
        shares: of each state in the eigenvector, the largest 1, by name.
    """

    eigenvalue: complex
    shares: dict[str, float]

    @property
    def frequency(self) -> float:
        """|lambda|, rad/s."""
        return abs(self.eigenvalue)

    @property
    def damping(self) -> float:
        """-Re(lambda) / |lambda|; 1 where it is zero."""
        return -self.eigenvalue.real / self.frequency if self.frequency else 1.0


@dataclasses.dataclass(frozen=True)
class LinearSystem:
    """d' = A d + B du, dy = C d + D du, with the names of rows and columns.

    Tangents of a pose are counted 0 to 2 along body axes, m, and 3 to 5 about them, rad.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def only(self, states: Iterable[str]) -> LinearSystem:
        """The system of some states, by name, with the others held: the longitudinal motion, for instance.

        Raises: InputError for an unknown name.
        """
        names = list(states)
        known("only: a state", names, self.states)
        rows = [self.states.index(name) for name in names]
        return dataclasses.replace(
            self, A=self.A[np.ix_(rows, rows)], B=self.B[rows], C=self.C[:, rows], states=tuple(names)
        )

    def modes(self) -> list[Mode]:
        """Its modes, the fastest first."""
        values, vectors = np.linalg.eig(self.A)
        found = []
        for value, vector in zip(values, vectors.T):
            if value.imag >= 0.0:
                shares = np.abs(vector) / np.max(np.abs(vector))
                found.append(Mode(complex(value), dict(zip(self.states, shares.tolist()))))
        return sorted(found, key=lambda mode: -mode.frequency)

    def to_control(self) -> Any:
        """A `control.StateSpace` of python-control, with the names; brackets and dots become underscores.

        Raises: ModelError where python-control is not installed.
        """
        try:
            control = importlib.import_module("control")
        except ImportError:
            raise ModelError("to_control needs python-control.\n  fix: pip install control") from None
        plain = {
            kind: [re.sub(r"\W+", "_", name).strip("_") for name in getattr(self, kind)]
            for kind in ("states", "inputs", "outputs")
        }
        return control.ss(self.A, self.B, self.C, self.D, **plain)


def entries(shapes: Mapping[str, tuple[int, ...]]) -> tuple[str, ...]:
    """Names of the entries of named arrays: "throttle", "V[2]", "M[0, 1]"."""
    return tuple(
        name + (f"[{', '.join(map(str, index))}]" if shape else "")
        for name, shape in shapes.items()
        for index in np.ndindex(*shape)
    )


def known(place: str, names: Iterable[str], known: Iterable[str]) -> None:
    allowed, seen = list(known), set()
    for name in names:
        if name not in allowed:
            raise InputError(f"{place} expects names among {listed(allowed, name)}; got {name!r}")
        if name in seen:
            raise InputError(f"{place} has {name!r} twice")
        seen.add(name)
