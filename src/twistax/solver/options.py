"""Options of the solvers, read from the lists that are also part of their C sources."""

from __future__ import annotations

import ctypes
import dataclasses
from typing import Any

from ..errors import TrajectoryError
from .sources import options


def _options_class(name: str, file: str, counts: set[str]) -> tuple[Any, dict[str, str]]:
    """A frozen dataclass of floats with the defaults of a `.def` file, and the source of each.

    Args:
        counts: options that are whole numbers in C.
    """
    listed = options(file)

    class OptionsStructure(ctypes.Structure):
        _fields_ = [(option, ctypes.c_double) for option, _, _ in listed]

    def as_structure(self: Any) -> OptionsStructure:
        values = [float(value) for value in vars(self).values()]
        for (option, _, _), value in zip(listed, values, strict=True):
            if not value >= 0.0 or (option in counts and not value < 2.0**31):
                raise TrajectoryError(f"{name}: {option} expects a number of 0 or more, counts below 2^31, got {value}")
        return OptionsStructure(*values)

    made = dataclasses.make_dataclass(
        name,
        [(option, float, dataclasses.field(default=default)) for option, default, _ in listed],
        namespace={
            "as_structure": as_structure,
            "__doc__": f"The options of `{file}`, all floats.",
        },
        frozen=True,
        kw_only=True,
    )
    return made, {option: source for option, _, source in listed}


#: Options of the interior point for problems in stages. `Options(tolerance=1e-6)` changes one. `SOURCES`: where each
#: comes from, an equation of the paper, or the option of IPOPT with the same meaning.
Options, SOURCES = _options_class(
    "Options",
    "options.def",
    {"iterations", "corrections", "watchdog_trigger", "watchdog_steps", "filter_resets", "filter_reset_trigger"}
    | {"refinements", "restoration_iterations", "acceptable_iterations"},
)

#: Options of the dense quadratic program, and where each comes from.
QPOptions, QP_SOURCES = _options_class(
    "QPOptions", "qp.def", {"iterations", "scaling_passes", "finish_changes", "warm_changes", "corrections"}
)
