"""The harness of all reports: measurements, what is asked of them, how they are timed and kept, and pages."""

from .expected import (
    Absent,
    EarlyEnd,
    Expected,
    at_most,
    between,
    either,
    ends,
    judged,
    needed,
    refused,
    simulated,
)
from .measurement import Measurement, Section, explained, slow
from .page import PageFigure, Table, as_svg, panels, render, renew, table_of, texts
from .report import Report, SectionReport, draw
from .rows import DONE, Row, duration, first_line, now, number, plain
from .store import ABSENT, KERNELS, Origin, Store, save_csv
from .timing import (
    Race,
    Repeats,
    Tell,
    Timed,
    agree,
    batch,
    compiled,
    difference,
    empty_call_seconds,
    in_turn,
    keep,
    printed,
    quiet,
    repeated,
    seconds_of,
    within,
)

__all__ = [
    "ABSENT", "DONE", "KERNELS", "Absent", "EarlyEnd", "Expected", "Measurement", "Origin", "PageFigure", "Race",
    "Repeats", "Report", "Row", "Section", "SectionReport", "Store", "Table", "Tell", "Timed", "agree", "as_svg",
    "at_most", "batch", "between", "compiled", "difference", "draw", "duration", "either", "empty_call_seconds", "ends",
    "explained", "first_line", "in_turn", "judged", "keep", "needed", "now", "number", "panels", "plain", "printed",
    "quiet", "refused", "render", "renew", "repeated", "save_csv", "seconds_of", "simulated", "slow", "table_of",
    "texts", "within",
]  # fmt: skip
