"""All sections, in the order of docs/measured.md."""

from __future__ import annotations

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

__all__ = ["SECTIONS"]

SECTIONS: tuple[Section, ...] = (
    *(IDENTITIES, KEEPING, MAPS, LINEARISATION, STIFFNESS, LONG, RACES, BRIDGE),
    *(COSTS, STEPS, BESIDE, GRADIENTS, OPERATIONS, KERNELS, LANDINGS),
)
