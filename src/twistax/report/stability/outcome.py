"""Rows as they turned out."""

from __future__ import annotations

import dataclasses
from typing import Any

from .row import Found, Row, Section

__all__ = ["Outcome"]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A row and what it did."""

    section: Section
    row: Row
    found: Found

    @property
    def verdict(self) -> str:
        """One word. Rows that need a package that is not installed are not run, and say so."""
        if isinstance(self.found.failure, ImportError):
            return "not run"
        return "as expected" if self.row.expected.met(self.found) else "UNEXPECTED"

    @property
    def good(self) -> bool:
        return self.verdict != "UNEXPECTED"

    def record(self) -> dict[str, Any]:
        """For CSV."""
        return {
            "section": self.section.name,
            "case": self.row.case,
            "method": self.row.method,
            "found": self.found.text,
            "expected": self.row.expected.text,
            "verdict": self.verdict,
            "why": self.row.why,
        }
