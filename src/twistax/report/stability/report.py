"""`python -m twistax report --stability`."""

from __future__ import annotations

import argparse

from ..checked import Checked
from .sections import SECTIONS

__all__ = ["Stability"]


class Stability(Checked):
    name, title = "stability", "At the edges: what holds, what ends, and how it says so"
    about = (
        "Each row takes one case to an edge and says what came: an error, a drift, or the name of the failure; what "
        "was asked for; and why, in a sentence. Every row is a test of the suite as well."
    )
    notes = (
        "`ends:` names a `tx.Result` and when; an error is its first line. Errors of attitudes are angles in rad, of "
        "the rest distances over their size, or over 1 where that is larger (`Scene.error`).",
    )

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments, SECTIONS)
