"""The report on conservation measures what it says."""

import pytest

from twistax.report import conservation


@pytest.mark.slow
def test_drifts_shrink_with_the_order_and_the_group_is_kept() -> None:
    rows = {(row.method, row.dt): row for row in conservation.drifts((50, 100), seconds=0.5)}
    for method, factor in (("Euler", 2.0), ("Heun", 4.0), ("RK4", 16.0)):
        coarse, fine = rows[method, 0.02], rows[method, 0.01]
        assert 0.6 * factor < coarse.linear / fine.linear < 1.6 * factor
        assert coarse.defect < 1e-14
    assert rows["RK4", 0.01].linear < 1e-6
