"""The powered descent against an evaluation of Newton and Euler written by hand, in the world frame."""

import numpy as np
import pytest

import twistax as tx
from compilations import compilations
from twistax.scenes import powered_descent as scene


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


@pytest.fixture(scope="module")
def dynamics() -> tx.Dynamics:
    return tx.compile(scene.system())


def test_rates_are_newton_and_euler(dynamics: tx.Dynamics) -> None:
    rng = np.random.default_rng(3)
    J = np.diag([4e6, 4e6, 1e5])
    for _ in range(5):
        R, p = rotation(rng.normal(size=3), rng.uniform(0.0, 3.0)), 100.0 * rng.normal(size=3)
        v, w = 50.0 * rng.normal(size=3), rng.normal(size=3)
        m, T = rng.uniform(22e3, 30e3), 3e5 * rng.normal(size=3)
        x = {"g": tx.pose(position=p, rotation=R), "V": np.concatenate([R.T @ v, w]), "m": m}
        rate = dynamics(0.0, x, {"T": T})
        # Newton in the world frame; the body components of v also turn with the body.
        acceleration = R @ T / m - np.array([0.0, 0.0, 9.81])
        body_acceleration = R.T @ acceleration - np.cross(w, R.T @ v)
        # Euler about the centre of mass: the engine pushes 14 m below it.
        turning = np.linalg.solve(J, np.cross([0.0, 0.0, -14.0], T) - np.cross(w, J @ w))
        np.testing.assert_allclose(rate["g"], x["V"], rtol=1e-14)
        np.testing.assert_allclose(rate["V"], np.concatenate([body_acceleration, turning]), rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(rate["m"], -np.linalg.norm(T) / (282.0 * 9.81), rtol=1e-14)


def test_outputs_and_limits_say_what_they_mean(dynamics: tx.Dynamics) -> None:
    R = rotation(np.array([1.0, 2.0, 0.0]), 0.7)
    T = 4e5 * np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    w = np.array([0.3, -0.4, 1.2])
    x = {"g": tx.pose(position=[30.0, 40.0, 20.0], rotation=R), "V": np.array([1.0, 2.0, 3.0, *w]), "m": 25e3}
    found = dynamics.outputs(0.0, x, {"T": T})
    expected = {
        "thrust": 4e5,
        "gimbal": 0.1,
        "tilt": 0.7,
        "rate": 1.3,
        "cone": 20.0 * np.tan(np.deg2rad(70)) - 50.0,
        "mass": 25e3,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize(
    ("broken", "change"),
    [
        ("most thrust", {"T": [0.0, 0.0, 801e3]}),
        ("least thrust", {"T": [0.0, 0.0, 319e3]}),
        ("gimbal", {"T": [4e5 * np.sin(0.18), 0.0, 4e5 * np.cos(0.18)]}),
        ("tilt", {"angle": np.deg2rad(81.0)}),
        ("rate", {"V": [0.0, 0.0, 0.0, 0.0, 1.06, 0.0]}),
        ("inside the cone", {"p": [28.0, 0.0, 10.0]}),
        ("dry mass", {"m": 21_999.0}),
    ],
)
def test_each_limit_breaks_alone(dynamics: tx.Dynamics, broken: str, change: dict) -> None:
    inside = {"T": [0.0, 0.0, 4e5], "angle": np.deg2rad(79.0), "V": np.zeros(6), "p": [27.0, 0.0, 10.0], "m": 22_001.0}
    at = inside | change
    x = {
        "g": tx.pose(position=at["p"], rotation=rotation(np.array([1.0, 0.0, 0.0]), at["angle"])),
        "V": at["V"],
        "m": at["m"],
    }
    x, u = {name: np.asarray(value, float) for name, value in x.items()}, {"T": np.asarray(at["T"])}
    outputs = dynamics.outputs(0.0, x, u)
    exceeded = [limit.name for limit in scene.limits() if limit.margin(outputs[limit.output]) < 0.0]
    assert exceeded == [broken]
    residuals = dict(
        zip(dynamics.functions.constraint_names["inequality"], dynamics.constraints(0.0, x, u)["inequality"])
    )
    assert [name for name, value in residuals.items() if value > 0.0] == [broken] * (broken != "dry mass")


def test_the_start_is_the_one_described(dynamics: tx.Dynamics) -> None:
    x = scene.initial(scene.Start(), scene.Lander())
    R = rotation(np.array([0.2, 1.0, 0.0]), np.deg2rad(-60.0))
    np.testing.assert_allclose(x["g"], tx.pose(position=[400.0, 150.0, 900.0], rotation=R), atol=1e-12)
    np.testing.assert_allclose(R @ x["V"][:3], [-60.0, -20.0, -100.0], rtol=1e-12)
    # It turns towards upright: a moment later the tilt is smaller by the rate.
    turned = dynamics.retract(x, 1e-3 * np.concatenate([np.zeros(3), x["V"][3:], np.zeros(7)]))
    before, after = (float(dynamics.outputs(0.0, at, {"T": np.ones(3)})["tilt"]) for at in (x, turned))
    assert (before - after) / 1e-3 == pytest.approx(np.deg2rad(4.6), rel=1e-6)


def test_another_start_compiles_nothing() -> None:
    """The guesses, too."""
    vehicle = scene.Lander()
    scene.guess(scene.Start(), vehicle, 7, 13.0)
    with compilations() as more:
        poses = scene.guess(scene.Start(tilt=0.4), vehicle, 7, 11.0)["g"]
    assert not more
    np.testing.assert_allclose(poses[0, :3, :3], rotation(scene.Start().axis, 0.4), atol=1e-14)
    np.testing.assert_allclose(poses[:, :3, 3], np.linspace(1.0, 0.0, 7)[:, None] * scene.Start().position, rtol=1e-14)
