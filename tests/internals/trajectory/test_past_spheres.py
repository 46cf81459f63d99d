"""A search that is lost behind spheres."""

import pytest

import twistax as tx
from twistax.report.sections import flights


def test_a_run_past_spheres_that_got_lost_finds_its_way() -> None:
    """One of 64: from its start it comes to rest 135 rad from where its dynamics lead."""
    result = flights.quadrotor(20).solve(
        initial={"g": tx.pose(position=[0.09034702181816101, 0.02820368856191635, -0.22304977476596832])}
    )
    assert result.solved
    assert result.cost == pytest.approx(1.46904, rel=1e-5)
