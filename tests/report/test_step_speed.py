"""The report on the cost of a step measures what it says."""

from twistax.integrators import RKMK
from twistax.report import step_speed
from twistax.tableaus import HEUN


def test_both_loops_fly_the_same() -> None:
    row = step_speed.measure(RKMK(HEUN), step_speed.body(), 200)
    assert row.difference < 1e-13
    assert row.small > 0.0
    assert row.plain > 0.0
    assert row.compile_seconds > 0.0


def test_every_chart_is_measured() -> None:
    assert len({method.chart for method in step_speed.methods()}) >= 4
