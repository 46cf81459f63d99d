"""Starts of times that are free."""

import pytest

from twistax.trajectory.transcription.border import times_of


def test_a_free_time_starts_between_its_limits_however_far_apart_they_are() -> None:
    for low in (1.0, 1e-6, 3e-7, 1e-200):
        assert times_of((low, 100.0 * low), None)[1] == pytest.approx(50.5 * low)
        assert times_of((low, 121.0 * low), None)[1] == pytest.approx(11.0 * low)
    assert times_of((0.5, 20_000.0), 3.0)[1] == 3.0
