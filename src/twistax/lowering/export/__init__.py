"""Compiled systems for other programs: C99, CasADi, files."""

import dataclasses
import sys
from pathlib import Path


def version() -> str:
    """The version of this package, `twistax.__version__`; that module stands above, and is there when this runs."""
    return str(sys.modules[__name__.partition(".")[0]].__version__)


@dataclasses.dataclass(frozen=True)
class CFiles:
    """Where C code was written.

    Attributes:
        header, source: what a program includes and links.
        test: a program that compares both with reference values, and ends with 0 where they agree.
    """

    header: Path
    source: Path
    test: Path
