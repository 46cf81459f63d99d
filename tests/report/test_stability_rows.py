"""Every check of the stability report is a test."""

import pytest

from twistax.report.harness.measurement import MeasuredCase, explained
from twistax.report.harness.page import texts
from twistax.report.registry import STABILITY

#: Sections that take long to compile beside tests that see the same errors, and rows that take long to run.
SLOW = ("stiff", "single", "jumps", "long", "statuses", "events", "masses", "loops")
CHECKS = [
    pytest.param(
        check,
        id=f"{name}: {check.what}, {check.by}",
        marks=[pytest.mark.slow] if check.slow or name in SLOW else [],
    )
    for name, section in STABILITY.items()
    for _, check in explained(section)
]


@pytest.mark.parametrize("check", CHECKS)
def test_the_row_is_what_was_asked_for(check: MeasuredCase) -> None:
    row = check.run()
    assert row.holds, f"{row.came}; asked for: {row.bar}"


def test_every_row_explains_itself() -> None:
    for name, section in STABILITY.items():
        assert texts("stability")["sections"][name]["about"].endswith(".")
        keys = [(check.what, check.by) for _, check in explained(section)]
        assert len(set(keys)) == len(keys)
        assert all(why.endswith(".") for why, _ in explained(section))
