"""Rows without a slope are named."""

import pytest
from test_accuracy import to_rest

from twistax.trajectory import Status
from twistax.trajectory.strategy import judge


def test_a_row_without_slope_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judge, "_RUN_AWAY", 1e3)
    results = [to_rest("v", nodes).solve() for nodes in (11, 21, 41)]
    named = [result for result in results if result.status is Status.DEGENERATE]
    assert named
    assert not any(result.solved for result in results)
    for result in named:
        assert "'final: (v ** 2.) <= 0.' at node" in result.message
        assert result.message in result.explain()
