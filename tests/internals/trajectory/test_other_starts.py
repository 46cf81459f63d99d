"""Other starts for times that are free, and for far ends."""

import functools
from typing import Any

import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.trajectory import Problem, Status
from twistax.trajectory.strategy import other_starts
from twistax.trajectory.transcription.border import Border, times_of
from twistax.trajectory.transcription.points import Given, Point


@functools.cache
def stopping() -> Problem:
    """A mass comes to rest at 0 in least time, |u| <= 1."""
    p, v, push = tx.State("p"), tx.State("v"), tx.Control("push", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: push}))
    ends: dict[str, Any] = {"initial": {p: 1.0, v: 0.7}, "final": {p: 0.0, v: 0.0}}
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=15, final_time=(0.1, 6.0), **ends, **HEUN)


def test_no_fixed_duration_helps_where_nothing_does(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, fixed = list[float](), other_starts.with_fixed_durations

    def seen(*args: Any) -> Any:
        for point, given in fixed(*args):
            tried.append(float(np.asarray(point.border)[0]))
            yield point, given

    monkeypatch.setattr(other_starts, "with_fixed_durations", seen)
    result = stopping().solve(initial={"p": 1.0, "v": 0.7}, final_time=(0.1, 1.5))
    assert result.status is Status.INFEASIBLE
    assert tried == pytest.approx([1.36, 0.8])


def test_units_of_time_do_not_matter_for_durations_that_are_fixed() -> None:
    for unit in (1e-9, 1.0):
        border = Border(("first", "second"), unit * np.array([[0.1, 60.0], [2.0, 2.0]]))
        start = Point({}, np.zeros((1, 0)), unit * np.array([3.0, 2.0]))
        found = list(other_starts.with_fixed_durations(border, start, Given({}, {}, border.limits)))
        times = [np.asarray(point.border) / unit for point, _ in found]
        np.testing.assert_allclose(times, [[9.0, 2.0], [27.0, 2.0], [3.0, 2.0]])
        limits = np.asarray(found[0][1].limits) / unit
        np.testing.assert_allclose(limits, [[8.91, 9.09], [2.0, 2.0]])
    border = Border(("only",), np.array([[2.0, 2.0]]))
    start, given = Point({}, np.zeros((1, 0)), np.array([2.0])), Given({}, {}, border.limits)
    assert not list(other_starts.with_fixed_durations(border, start, given))


def test_a_free_time_starts_between_its_limits_however_far_apart_they_are() -> None:
    for low in (1.0, 1e-6, 3e-7, 1e-200):
        assert times_of((low, 100.0 * low), None)[1] == pytest.approx(50.5 * low)
        assert times_of((low, 121.0 * low), None)[1] == pytest.approx(11.0 * low)
    assert times_of((0.5, 20_000.0), 3.0)[1] == 3.0
