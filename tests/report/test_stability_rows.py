"""Every check of the stability report is a test."""

import pytest

from twistax.report.checks import Check, Found
from twistax.report.stability.sections import SECTIONS

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
    found = Found.of(check.measure)
    assert check.expected.met(found), f"{found.number:.2g}, {found.note}; asked for: {check.expected.text}"


def test_every_row_explains_itself() -> None:
    for section in SECTIONS:
        assert section.about.endswith(".")
        keys = [section.key(check) for _, check in section]
        assert len(set(keys)) == len(keys)
        assert all(why.endswith(".") for why, _ in section)
