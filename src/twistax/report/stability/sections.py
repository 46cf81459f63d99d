"""All sections, in the order of the page."""

from __future__ import annotations

from .events import EVENTS
from .extremes import EXTREMES
from .failures import FAILURES
from .inputs import INPUTS
from .jumps import JUMPS
from .long_runs import LONG_RUNS
from .maps import ANGLES
from .precision import PRECISION
from .row import Section
from .stiff import STIFF
from .turning import TURNING

__all__ = ["SECTIONS"]

SECTIONS: tuple[Section, ...] = (
    STIFF,
    TURNING,
    ANGLES,
    EXTREMES,
    LONG_RUNS,
    PRECISION,
    EVENTS,
    JUMPS,
    INPUTS,
    FAILURES,
)
