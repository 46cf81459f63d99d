"""Joint records: samples of positions, velocities, accelerations and forces, with checks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import listed, reals, short
from ...errors import InputError
from ...expr import State
from ...expr.lie.base import NEARLY
from ...groups.arrays import element_defect

Array = NDArray[np.float64]
#: The name of the joint forces.
FORCES = "tau"
#: Squares of larger numbers overflow if they are expressed in units smaller than the inverse of this number.
LARGEST = 1e50


@dataclasses.dataclass(frozen=True)
class JointRecords:
    """Samples of a motion.

    Attributes:
        samples: by state, (count, ...).
        tau: the joint forces (count, n).
    """

    samples: dict[str, Array]
    tau: Array

    @classmethod
    def of(cls, owner: str, records: Any, states: Sequence[State]) -> JointRecords:
        """Raises InputError for unknown or missing names, arrays of the wrong shape, numbers that are not finite, and
        empty records.
        """
        states = [state for state in states if state.shape != (0,)]
        names = [*(state.name for state in states), FORCES]
        if not isinstance(records, Mapping) or set(records) != set(names):
            raise InputError(
                f"{owner} expects records by name, of {listed(names)}, got "
                f"{listed(records) if isinstance(records, Mapping) else short(records)}{_derivatives(names, records)}"
            )
        n = next(state.shape[0] for state in states if state.name == "qdd")
        shapes = {**{state.name: state.shape for state in states}, FORCES: (n,)}
        arrays: dict[str, Array] = {}
        for name, shape in shapes.items():
            value = reals(f"{owner}: {name!r}", records[name], InputError).astype(np.float64)
            count = len(value) if value.ndim else 0
            if value.shape != (count, *shape) or not count:
                size = ", ".join(["samples", *map(str, shape)])
                raise InputError(f"{owner} expects records of {name!r} with shape ({size}), got {value.shape}")
            wrong = np.flatnonzero(~(np.abs(value.reshape(count, -1)) <= LARGEST).all(axis=1))
            if wrong.size:
                raise InputError(
                    f"{owner} expects finite records below {LARGEST:g}, got {short(value[wrong[0]])} for {name!r} at "
                    f"sample {int(wrong[0])}.\n  fix: remove the {wrong.size} samples with such values"
                )
            arrays[name] = value
        counts = {name: len(value) for name, value in arrays.items()}
        if len(set(counts.values())) > 1:
            raise InputError(f"{owner} expects the same number of samples in each record, got {counts}")
        for state in states:
            if not state.group.flat:
                _need_elements(owner, state.name, arrays[state.name])
        tau = arrays.pop(FORCES)
        return cls(arrays, tau)


def _need_elements(owner: str, name: str, values: Array) -> None:
    """Raise InputError for matrices that are not rotations or poses."""
    defects = np.array([element_defect(value) for value in values])
    if not defects.max() <= NEARLY:
        k = int(np.argmax(defects))
        raise InputError(
            f"{owner} expects rotations or poses as {name!r}, got\n{values[k]} at sample {k}\n"
            "  fix: tx.pose(...) builds one, tx.SE3.normalize(T) returns the pose nearest to a matrix"
        )


def _derivatives(names: Sequence[str], records: Any) -> str:
    """How to compute missing velocities and accelerations."""
    missing = [name for name in ("qd", "qdd") if name in names and isinstance(records, Mapping) and name not in records]
    fix = f".\n  fix: compute {listed(missing)} as scipy.signal.savgol_filter(q, 31, 5, deriv=1 or 2, delta=dt, axis=0)"
    return fix if missing else ""
