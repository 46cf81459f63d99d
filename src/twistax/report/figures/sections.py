"""`python -m twistax report --figures`: all sections, in the order of docs/measured.md."""

from __future__ import annotations

import argparse

from ..checked import Checked
from ..checks import Section
from .costs import COSTS, LANDINGS
from .derivatives import GRADIENTS, LINEARISATION
from .identities import SECTION as IDENTITIES
from .keeping import KEEPING, LONG
from .maps import SECTION as MAPS
from .races import SECTION as RACES
from .scalars import KERNELS, OPERATIONS
from .steps import BESIDE, BRIDGE, STEPS
from .stiffness import SECTION as STIFFNESS

__all__ = ["SECTIONS", "report"]

SECTIONS: tuple[Section, ...] = (
    *(IDENTITIES, KEEPING, MAPS, LINEARISATION, STIFFNESS, LONG, RACES, BRIDGE),
    *(COSTS, STEPS, BESIDE, GRADIENTS, OPERATIONS, KERNELS, LANDINGS),
)


def report(arguments: argparse.Namespace) -> Checked:
    """The report that the options ask for."""
    return Checked(
        arguments,
        SECTIONS,
        name="figures",
        title="Figures",
        about="What docs/measured.md says beside the other reports, each figure with its bar if one was set.",
        note="Competitors are called in turn, each call waited for; a time is their median, compiling apart. "
        "Results are compared before any times are. Times depend on the machine; trust the ratios more.",
        tells_all=True,
    )
