"""Compiled systems for other programs: C99, CasADi, files."""

import dataclasses
from pathlib import Path


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
