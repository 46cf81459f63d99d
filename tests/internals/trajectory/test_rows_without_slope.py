"""Rows without a slope are named."""

import functools
from typing import Any

import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.trajectory import Problem, Status
from twistax.trajectory.strategy import judge


@functools.cache
def to_rest(condition: str, nodes: int) -> Problem:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    final: Any = {"v": [p == 1.0, v**2 <= 0.0], "p": [(p - 1.0) ** 2 <= 0.0, v == 0.0]}[condition]
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": final}
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=nodes, final_time=(0.1, 6.0), **ends, **HEUN)


def test_a_row_without_slope_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judge, "_RUN_AWAY", 1e3)
    results = [to_rest("v", nodes).solve() for nodes in (11, 21, 41)]
    named = [result for result in results if result.status is Status.DEGENERATE]
    assert named
    assert not any(result.solved for result in results)
    for result in named:
        assert "'final: (v ** 2.) <= 0.' at node" in result.message
        assert result.message in result.explain()
