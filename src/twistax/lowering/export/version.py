"""The version of this package, told in what it writes."""

from __future__ import annotations

import sys

__all__ = ["version"]


def version() -> str:
    """As `twistax.__version__`; that module stands above this one, and is there whenever this one runs."""
    return str(sys.modules[__name__.partition(".")[0]].__version__)
