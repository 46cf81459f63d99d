"""`python -m twistax report --stability`: all sections, in the order of the page."""

from __future__ import annotations

import argparse

from ..checked import Checked
from ..checks import Section
from .angles import ANGLES, PRECISION
from .events import EVENTS
from .extremes import EXTREMES
from .failures import FAILURES, INPUTS
from .jumps import JUMPS
from .long_runs import LONG_RUNS
from .stiff import STIFF
from .turning import TURNING

__all__ = ["SECTIONS", "report"]

SECTIONS: tuple[Section, ...] = (
    *(STIFF, TURNING, ANGLES, EXTREMES, LONG_RUNS, PRECISION, EVENTS, JUMPS, INPUTS, FAILURES),
)


def report(arguments: argparse.Namespace) -> Checked:
    """The report that the options ask for."""
    return Checked(
        arguments,
        SECTIONS,
        name="stability",
        title="At the edges: what holds, what ends, and how it says so",
        about="Each row takes one case to an edge and says what came: an error, a drift, or a failure by name; what "
        "was asked for; and why, in a sentence. Every row is a test of the suite as well.",
        note="`ends:` names a `tx.Result` and when; an error is its first line. Errors of attitudes are angles in rad, "
        "of the rest distances over their size, or over 1 where that is larger (`Scene.error`).",
    )
