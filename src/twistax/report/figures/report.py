"""`python -m twistax report --figures`."""

from __future__ import annotations

import argparse

from ..checked import Checked
from .sections import SECTIONS

__all__ = ["Figures"]


class Figures(Checked):
    name, title = "figures", "Figures"
    about = (
        "What docs/measured.md says beside the other reports, each figure with its bar, where one was set beforehand."
    )
    notes = (
        "Competitors are called in turn, each call waited for; a time is the median of its calls, compiling apart. "
        "Results are compared before any times are. Times depend on the machine; trust the ratios more.",
    )
    tells_all = True

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments, SECTIONS)
