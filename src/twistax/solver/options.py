"""Options of the core, read from the list that its C sources are made of."""

from __future__ import annotations

import ctypes
import dataclasses
from typing import Any

from .sources import options

_OPTIONS = options()

#: Where each option comes from: an equation of the paper, or the option of IPOPT with the same meaning.
SOURCES: dict[str, str] = {name: source for name, _, source in _OPTIONS}


class OptionsStructure(ctypes.Structure):
    """`twx_options` of core.h."""

    _fields_ = [(name, ctypes.c_double) for name, _, _ in _OPTIONS]


def _as_structure(self: Any) -> OptionsStructure:
    return OptionsStructure(*(float(value) for value in dataclasses.astuple(self)))


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
