"""The maps against values with fifty digits, and those values against sums that share no formula with them."""

import dataclasses

import mpmath
import numpy as np
import pytest

from twistax.groups import se3
from twistax.report import accuracy_of_maps
from twistax.report.accuracy_of_maps import BAR, Exact, measure, twists


def rows_above_the_bar(rows):
    return [dataclasses.astuple(row) for row in rows if not row.holds]


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_few_units_in_the_last_place(precision):
    rows = measure(120, [precision])
    assert len(rows) == 10
    assert not rows_above_the_bar(rows)


@pytest.mark.slow
def test_a_few_units_in_the_last_place_sweep():
    assert not rows_above_the_bar(measure(4000))


def test_the_measure_sees_an_error(monkeypatch):
    """Ten units too much in one coefficient must not pass."""
    spoiled = dataclasses.replace(
        accuracy_of_maps.MAPS[0], function=lambda xi: se3.exp(xi * np.where(np.arange(6) < 3, 1.0, 1.0 + 5e-15))
    )
    monkeypatch.setattr(accuracy_of_maps, "MAPS", (spoiled,))
    rotation, position = measure(60, ["float64"])
    assert rotation.worst > BAR
    assert rotation.block == "rotation"
    assert position.block == "position"


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
        exact = Exact(xi)
        hat = mpmath.matrix(4, 4)
        hat[:3, :3], hat[:3, 3] = mpmath.matrix(exact.W), mpmath.matrix(exact.v)
        ad = mpmath.matrix(6, 6)
        ad[:3, :3], ad[3:, 3:], ad[:3, 3:] = (mpmath.matrix(exact.W), mpmath.matrix(exact.W), mpmath.matrix(exact.V))
        pose = _sum(hat, lambda k: 1 / mpmath.factorial(k))
        jacobian = _sum(ad, lambda k: 1 / mpmath.factorial(k + 1))
        inverse = jacobian**-1
        for got, expected in (
            (exact.rotation, pose[:3, :3]),
            ([[entry] for entry in exact.position], pose[:3, 3]),
            (exact.jacobian, jacobian[:3, :3]),
            (exact.coupling, jacobian[:3, 3:]),
            (exact.jacobian_inv, inverse[:3, :3]),
            (exact.coupling_inv, inverse[:3, 3:]),
        ):
            assert mpmath.norm(mpmath.matrix(got) - expected) < mpmath.mpf(10) ** -48


def test_the_command_prints_the_table(monkeypatch, capsys):
    few = measure(6, ["float64"])
    monkeypatch.setattr(accuracy_of_maps, "measure", lambda: few)
    assert accuracy_of_maps.main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(few)
    monkeypatch.setattr(accuracy_of_maps, "measure", lambda: [dataclasses.replace(few[0], worst=BAR + 1.0)])
    assert accuracy_of_maps.main() == 1
    assert "ABOVE" in capsys.readouterr().out
