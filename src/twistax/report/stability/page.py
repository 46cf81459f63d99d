"""`python -m twistax report --stability`: all sections, in the order of the page."""

from __future__ import annotations

import functools

from ..report import Checked
from .angles import ANGLES, PRECISION
from .bodies import EXTREMES, LONG_RUNS
from .events import EVENTS, JUMPS
from .failures import FAILURES, INPUTS
from .steps import STIFF, TURNING

SECTIONS = (STIFF, TURNING, ANGLES, EXTREMES, LONG_RUNS, PRECISION, EVENTS, JUMPS, INPUTS, FAILURES)
report = functools.partial(Checked, "stability", SECTIONS)
