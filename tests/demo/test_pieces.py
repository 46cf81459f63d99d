"""The demo's parts alone: derivative check, figure, table, words for failures, progress line."""

import csv
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import twistax as tx
from twistax.demo import derivatives, tumbling
from twistax.demo.figure import save_figure, save_table
from twistax.demo.landing import describe_failure, describe_limits
from twistax.scenes import powered_descent as scene
from twistax.scenes.touchdown import Descent, Miss, reaches


@pytest.fixture(scope="module")
def descent() -> Descent:
    """A made-up descent along a straight line, upright, at 500 kN."""
    ts = np.linspace(0.0, 10.0, 101)
    share = 1.0 - ts / 10.0
    g = np.tile(np.eye(4), (101, 1, 1))
    g[:, :3, 3] = share[:, None] * np.array([100.0, 50.0, 800.0])
    V = np.tile([-10.0, -5.0, -80.0, 0.0, 0.0, 0.0], (101, 1))
    mass, T = 30e3 - 200.0 * ts, np.tile([0.0, 0.0, 500e3], (101, 1))
    cone = np.tan(np.deg2rad(70.0)) * g[:, 2, 3] - np.hypot(g[:, 0, 3], g[:, 1, 3])
    outputs = {"thrust": T[:, 2], "gimbal": 0 * ts, "tilt": 0 * ts, "rate": 0 * ts, "cone": cone, "mass": mass}
    return Descent(ts, {"g": g, "V": V, "m": mass}, {"T": T}, outputs)


def spinning() -> tx.Dynamics:
    R, w, F = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Control("F", shape=(3,))
    J = np.array([1.0, 2.0, 3.0])
    system = tx.System(
        rates={R: w, w: (F - tx.linalg.Cross(w, J * w)) / J}, constraints=[tx.linalg.Norm(w) <= R[2, 2] + 3.0]
    )
    return tx.compile(system)


def test_the_derivative_check_passes_what_is_right_and_sees_what_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    R = np.stack([np.asarray(tx.lie.so3.exp(xi)) for xi in rng.normal(size=(3, 3))])
    xs, us = {"R": R, "w": rng.normal(size=(3, 3))}, {"F": rng.normal(size=(3, 3))}
    assert derivatives.check_derivatives(spinning(), xs, us, 0.1).holds

    right = tx.trajectory.discretize

    def wrong(*args, **kwargs):
        found = right(*args, **kwargs)
        return type(found)(found.x1, found.A * (1.0 + 1e-6), found.B, found.h_derivative, found.t_derivative)

    monkeypatch.setattr(tx.trajectory, "discretize", wrong)
    check = derivatives.check_derivatives(spinning(), xs, us, 0.1)
    assert check.rates < derivatives.BAR < check.interval
    assert not check.holds


def test_the_figure_is_written(descent: Descent, tmp_path: Path) -> None:
    path = tmp_path / "figure.png"
    nodes = Descent(
        *(
            {k: v[::10] for k, v in part.items()} if isinstance(part, dict) else part[::10]
            for part in (descent.ts, descent.xs, descent.us, descent.outputs)
        )
    )
    save_figure(path, "a title", descent, nodes, scene.limits(), scene.Lander())
    image = matplotlib.image.imread(path)
    assert image.shape[:2] == (700, 1200)
    # Something is drawn in the scene on the left and in the panels on the right.
    assert all(half[..., :3].std() > 0.05 for half in np.split(image, 2, axis=1))


def test_the_table_has_a_line_for_each_sample(descent: Descent, tmp_path: Path) -> None:
    save_table(tmp_path / "descent.csv", descent)
    with (tmp_path / "descent.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 101
    first = {name: float(value) for name, value in rows[0].items()}
    assert (first["x (m)"], first["y (m)"], first["height (m)"]) == (100.0, 50.0, 800.0)
    assert (first["velocity z (m/s)"], first["thrust (kN)"], first["mass (kg)"]) == (-80.0, 500.0, 30e3)
    assert [first[f"quaternion {i}"] for i in "wxyz"] == [1.0, 0.0, 0.0, 0.0]


def test_a_failure_is_named_in_units_people_use(descent: Descent) -> None:
    good = Miss(0.01, 0.001, 0.01)
    assert describe_failure({"RKMK4": good}, reaches(descent, scene.limits()), 10.0, (8.0, 20.0)) == []
    spoilt = dict(descent.outputs) | {"tilt": np.where(descent.ts == 4.0, np.deg2rad(85.0), 0.0)}
    found = reaches(Descent(descent.ts, descent.xs, descent.us, spoilt), scene.limits())
    said = "\n".join(describe_failure({"RKMK4": Miss(12.0, 3.0, 0.1)}, found, 25.0, (8.0, 20.0)))
    for words in ("12.00 m off the pad, at 3.00 m/s", "tilt: 85.00 deg at 4.00 s", "<= 80 deg", "25.00 s"):
        assert words in said
    assert "thrust" not in said
    assert any("-5.00 deg" in line for line in describe_limits(found))


def test_a_miss_that_is_not_a_number_never_counts() -> None:
    assert Miss(0.1, 0.1, 0.1).within(Miss(0.5, 0.1, 0.5))
    assert not Miss(np.nan, 0.0, 0.0).within(Miss(0.5, 0.1, 0.5))


def test_the_first_picture_is_of_a_box_that_turns_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It turns about its middle axis, keeps its momentum about the origin, and flips."""
    solution = tumbling.flown()
    rotation = np.asarray(solution.xs["g"])[:, :3, :3]
    squares = tumbling.SIDES**2
    inertia = tumbling.MASS / 12.0 * (squares.sum() - squares)
    assert inertia[1] == sorted(inertia)[1]
    momentum = np.einsum("nij,nj->ni", rotation, inertia * np.asarray(solution.xs["V"])[:, 3:])
    np.testing.assert_allclose(momentum, momentum[:1].repeat(len(momentum), 0), atol=1e-6)
    assert np.asarray(solution.xs["V"])[:, 4].min() < -2.9
    lines = tumbling.draw(tmp_path)
    assert (tmp_path / "body.png").stat().st_size > 10_000
    assert str(tmp_path / "body.png") in lines
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert any("pip install 'twistax[plot]'" in line for line in tumbling.draw(tmp_path))
