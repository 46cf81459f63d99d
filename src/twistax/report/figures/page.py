"""`python -m twistax report --figures`: all sections, in the order of docs/measured.md."""

from __future__ import annotations

import functools

from ..report import Checked
from .costs import COSTS, LANDINGS
from .derivatives import GRADIENTS, LINEARISATION
from .identities import IDENTITIES
from .keeping import KEEPING, LONG
from .maps import LAST_PLACES
from .races import RACES
from .scalars import KERNELS, OPERATIONS
from .steps import BESIDE, BRIDGE, STEPS
from .stiffness import STIFFNESS

SECTIONS = (
    *(IDENTITIES, KEEPING, LAST_PLACES, LINEARISATION, STIFFNESS, LONG, RACES, BRIDGE),
    *(COSTS, STEPS, BESIDE, GRADIENTS, OPERATIONS, KERNELS, LANDINGS),
)
report = functools.partial(Checked, "figures", SECTIONS)
