"""Export of compiled systems: C99, CasADi, files."""

import dataclasses
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class CFiles:
    """The paths of generated C code.

    Attributes:
        header, source: the files that a program includes and links.
        test: a program that compares the code with reference values, and returns 0 if they agree.
    """

    header: Path
    source: Path
    test: Path
