"""The sources of the quadratic program."""

import re

from twistax.solver import QP_SOURCES, QPOptions
from twistax.solver.sources import amalgamation


def test_sources_allocate_nothing_and_options_have_sources() -> None:
    """Symbols of the object file are looked at in test_core.py."""
    assert not re.search(r"\b(m|c|re)?(alloc|alloca|free)\s*\(", amalgamation())
    assert list(QP_SOURCES) == list(QPOptions.__dataclass_fields__)
    assert all(len(source) > 10 for source in QP_SOURCES.values())
