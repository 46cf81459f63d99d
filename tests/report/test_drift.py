"""The report on long flights measures what it says, here on short ones."""

import numpy as np
import pytest

from twistax.report import drift


@pytest.fixture(scope="module")
def courses() -> dict[tuple[str, str], drift.Course]:
    return {(course.motion, course.stored): course for course in drift.courses((100, 1_000, 10_000))}


def test_quaternions_stay_and_matrices_drift(courses: dict[tuple[str, str], drift.Course]) -> None:
    for motion in ("constant twist", "free body"):
        assert courses[motion, "quaternion"].defect.max() < 2e-15
        assert 5e-15 < courses[motion, "matrix"].defect[-1] < 5e-12
    assert drift.slope((100, 1_000, 10_000), courses["constant twist", "matrix"].defect) > 0.5


def test_momentum_and_energy_are_looked_at(courses: dict[tuple[str, str], drift.Course]) -> None:
    """Both ways of storing fly the same body with the same method, whose errors grow with the time flown."""
    one, other = courses["free body", "quaternion"], courses["free body", "matrix"]
    assert 1e-9 < one.linear[-1] < 1e-3
    assert 1e-12 < one.energy[-1] < 1e-5
    assert one.energy[-1] > 10.0 * one.energy[0]
    for name in ("linear", "angular", "energy"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-3, atol=1e-10)


def test_the_slope_is_the_power() -> None:
    assert drift.slope([10, 100, 1000], [2e-9, 2e-8, 2e-7]) == pytest.approx(1.0)
    assert drift.slope([10, 100, 1000], [0.0, 0.0, 0.0]) == pytest.approx(0.0, abs=1e-12)
