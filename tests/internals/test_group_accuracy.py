"""The maps against values with fifty digits, and those values against sums that share no formula with them."""

import dataclasses

import mpmath
import numpy as np
import pytest

from twistax.groups import se3
from twistax.report.stability import lie_maps
from twistax.report.stability.lie_maps import BAR, MAPS, twists, worst_units


def measured(each, dtype, cases):
    return worst_units(each, twists(cases, each.largest, dtype, below=each.of_poses))


@pytest.mark.parametrize("each", MAPS, ids=lambda each: each.name)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_few_units_in_the_last_place(dtype, each):
    worst = measured(each, dtype, 120)
    assert tuple(worst) == tuple(each.blocks)
    assert max(worst.values()) <= BAR


@pytest.mark.slow
@pytest.mark.parametrize("each", MAPS, ids=lambda each: each.name)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_few_units_in_the_last_place_sweep(dtype, each):
    assert max(measured(each, dtype, 4000).values()) <= BAR


def test_the_measure_sees_an_error():
    """Ten units too much in one coefficient must not pass."""
    spoiled = dataclasses.replace(
        MAPS[0], function=lambda xi: se3.exp(xi * np.where(np.arange(6) < 3, 1.0, 1.0 + 5e-15))
    )
    assert measured(spoiled, np.float64, 60)["rotation"] > BAR


def test_the_cases_cover_what_they_promise():
    for dtype, largest in ((np.float64, 20.0), (np.float32, np.pi)):
        xis = twists(300, largest, dtype, below=True)
        angles = np.linalg.norm(xis[:, 3:].astype(float), axis=1)
        sizes = np.linalg.norm(xis[:, :3].astype(float), axis=1)
        assert angles.min() == 0.0
        assert 0.99 * largest < angles.max() < largest
        assert sizes.min() < 1e-7
        assert sizes.max() > 1e5


def _sum(X, weight):
    """sum_k X^k weight(k), entry by entry with many digits."""
    total, power = mpmath.zeros(X.rows), mpmath.eye(X.rows)
    for k in range(90):
        total += power * weight(k)
        power = power * X
    return total


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 0.999, 1.001, 5.9])
def test_the_exact_values_are_right(angle):
    rng = np.random.default_rng(3)
    axis = rng.normal(size=3)
    xi = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    with mpmath.workdps(60):
        exact = lie_maps.exact(xi)
        hat = mpmath.matrix(4, 4)
        hat[:3, :3], hat[:3, 3] = exact.W, exact.v
        ad = mpmath.matrix(6, 6)
        ad[:3, :3], ad[3:, 3:], ad[:3, 3:] = exact.W, exact.W, exact.V
        pose = _sum(hat, lambda k: 1 / mpmath.factorial(k))
        jacobian = _sum(ad, lambda k: 1 / mpmath.factorial(k + 1))
        inverse = jacobian**-1
        for got, expected in (
            (exact.rotation, pose[:3, :3]),
            (exact.position, pose[:3, 3]),
            (exact.jacobian, jacobian[:3, :3]),
            (exact.coupling, jacobian[:3, 3:]),
            (exact.jacobian_inv, inverse[:3, :3]),
            (exact.coupling_inv, inverse[:3, 3:]),
        ):
            assert mpmath.norm(got - expected) < mpmath.mpf(10) ** -48
