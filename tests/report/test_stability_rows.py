"""Every check of the stability report is a test."""

import pytest

from twistax.report.checks import Check
from twistax.report.page import texts
from twistax.report.stability.page import SECTIONS

#: Sections that take long to compile, beside the rows that take long to run.
SLOW = ("stiff", "single", "jumps", "long")
CHECKS = [
    pytest.param(
        check,
        id=f"{section.name}: {check.what}, {check.by}",
        marks=[pytest.mark.slow] if check.slow or section.name in SLOW else [],
    )
    for section in SECTIONS
    for _, check in section
]


@pytest.mark.parametrize("check", CHECKS)
def test_the_row_is_what_was_asked_for(check: Check) -> None:
    row = check.run()
    assert row.holds, f"{row.came}; asked for: {row.bar}"


def test_every_row_explains_itself() -> None:
    for section in SECTIONS:
        assert texts("stability")["sections"][section.name]["about"].endswith(".")
        keys = [section.key(check) for _, check in section]
        assert len(set(keys)) == len(keys)
        assert all(why.endswith(".") for why, _ in section)
