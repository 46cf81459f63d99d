"""Options of the core, read from the list that its C sources are made of."""

from __future__ import annotations

import ctypes
import dataclasses
from typing import Any

from ..errors import TrajectoryError
from .sources import options

_OPTIONS = options()

#: Where each option comes from: an equation of the paper, or the option of IPOPT with the same meaning.
SOURCES: dict[str, str] = {name: source for name, _, source in _OPTIONS}


#: Those that are whole numbers in C.
_COUNTS = {"iterations", "corrections", "watchdog_trigger", "watchdog_steps", "filter_resets", "filter_reset_trigger"}
_COUNTS |= {"refinements", "restoration_iterations"}


class OptionsStructure(ctypes.Structure):
    """`twx_options` of core.h."""

    _fields_ = [(name, ctypes.c_double) for name, _, _ in _OPTIONS]


def _as_structure(self: Any) -> OptionsStructure:
    values = [float(value) for value in dataclasses.astuple(self)]
    for (name, _, _), value in zip(_OPTIONS, values, strict=True):
        if not value >= 0.0 or (name in _COUNTS and not value < 2.0**31):
            raise TrajectoryError(f"Options: {name} expects a number of 0 or more, counts below 2^31, got {value}")
    return OptionsStructure(*values)


#: Options of the interior point, all floats; see `SOURCES`. `Options(tolerance=1e-6)` changes one.
Options = dataclasses.make_dataclass(
    "Options",
    [(name, float, dataclasses.field(default=default)) for name, default, _ in _OPTIONS],
    namespace={
        "as_structure": _as_structure,
        "__doc__": "Options of the interior point; `SOURCES` names their sources.",
    },
    frozen=True,
    kw_only=True,
)
