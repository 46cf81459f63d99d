"""Every row of the stability report is a test."""

import pytest

from twistax.report.stability.row import Row
from twistax.report.stability.sections import SECTIONS

ROWS = [
    pytest.param(
        row,
        id=f"{section.name}: {row.case}, {row.method}",
        marks=[pytest.mark.slow] if row.slow else [],
    )
    for section in SECTIONS
    for row in section.rows
]


@pytest.mark.parametrize("row", ROWS)
def test_the_row_is_as_expected(row: Row) -> None:
    found = row.observe()
    assert row.expected.met(found), f"{found.text}; should: {row.expected.text}"


def test_every_row_explains_itself() -> None:
    seen = set()
    for section in SECTIONS:
        assert section.about.endswith(".")
        for row in section.rows:
            assert row.why.endswith(".")
            assert (section.name, row.case, row.method) not in seen
            seen.add((section.name, row.case, row.method))
