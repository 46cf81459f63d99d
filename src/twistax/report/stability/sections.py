"""All sections, in the order of the page."""

from __future__ import annotations

from ..checks import Section
from .angles import ANGLES, PRECISION
from .events import EVENTS
from .extremes import EXTREMES
from .failures import FAILURES, INPUTS
from .jumps import JUMPS
from .long_runs import LONG_RUNS
from .stiff import STIFF
from .turning import TURNING

__all__ = ["SECTIONS"]

SECTIONS: tuple[Section, ...] = (
    *(STIFF, TURNING, ANGLES, EXTREMES, LONG_RUNS, PRECISION, EVENTS, JUMPS, INPUTS, FAILURES),
)
