"""Exciting motions: within the limits, better than random ones, and with the deviation that `identify` finds."""

from pathlib import Path

import jax
import numpy as np
import pytest

import twistax as tx
from twistax import mechanics
from twistax.errors import InputError, ModelError
from twistax.mechanics import Drive, Link, Mechanism, SpatialInertia, joints

EXAMPLES = Path(__file__).parents[2] / "examples"
NOISE = 0.2


def arm(**limits: float) -> Mechanism:
    drive = Drive(**{"lower": -1.0, "upper": 1.5, "speed": 4.0, "effort": 40.0} | limits)
    body = SpatialInertia(mass=2.0, center_of_mass=(0.2, 0.05, 0.0), inertia=np.diag([0.01, 0.05, 0.04]))
    hinges = [joints.Revolute(name, (0.0, 1.0, 0.0)) for name in ("shoulder", "elbow")]
    return mechanics.Chain([Link(hinge, body, tx.pose(position=[0.3, 0.0, 0.0]), drive=drive) for hinge in hinges])


def with_torques(mechanism: Mechanism, coefficients: np.ndarray, period: float, count: int) -> dict[str, np.ndarray]:
    records = mechanics.fourier_motion(coefficients, period, np.arange(count) * (period / count))
    torques = tx.fast(tx.lower(mechanics.inverse_dynamics(mechanism, qdd=tx.State("qdd", (mechanism.dofs,)))))
    return records | {"tau": np.asarray(jax.vmap(lambda x: torques(0.0, x))(records))}


def test_rates_of_a_series() -> None:
    C, step = np.random.default_rng(0).normal(size=(3, 7)), 1e-5
    at = np.array([0.3, 1.1])
    before, here, after = (mechanics.fourier_motion(C, 2.5, at + k * step) for k in (-1, 0, 1))
    for value, rate in (("q", "qd"), ("qd", "qdd")):
        np.testing.assert_allclose((after[value] - before[value]) / (2.0 * step), here[rate], atol=1e-7)
    np.testing.assert_allclose(mechanics.fourier_motion(C, 2.5, at + 2.5)["q"], here["q"], atol=1e-12)
    for wrong in ((C[:, :4], 2.5, at), (C, 0.0, at), (C, 2.5, 0.3), (C * np.nan, 2.5, at)):
        with pytest.raises(InputError, match="fourier_motion"):
            mechanics.fourier_motion(*wrong)


@pytest.mark.thorough
def test_it_is_within_limits_and_as_good_as_it_says() -> None:
    robot, period, mass, length = arm(), 2.0, 2.0, 0.3
    problem = tx.trajectory.exciting_problem(robot, period=period, harmonics=3, noise=NOISE, size=(mass, length))
    result = problem.solve(max_iterations=50, strategies=(), between=1e-4)
    assert result.cost < problem.params["logarithm of the deviation"] - 0.05
    motion = with_torques(robot, result.params["coefficients"], period, 900)  # also between nodes
    for value, low, high in (("q", -1.0, 1.5), ("qd", -4.0, 4.0), ("tau", -40.0, 40.0)):
        assert low - 1e-3 <= motion[value].min()
        assert motion[value].max() <= high + (1e-2 if value == "tau" else 1e-3)
    motion = {name: record[::30] for name, record in motion.items()}
    np.testing.assert_allclose(motion["qd"][0], 0.0, atol=1e-5)
    np.testing.assert_allclose(motion["qdd"][0], 0.0, atol=1e-4)
    # The covariance of `identify`, in parts of the sizes of its parameters.
    found = mechanics.identify(robot, motion, noise=NOISE, size=(mass, length), tolerance=1e6)
    powers = {"mass": 0, "mx": 1, "my": 1, "mz": 1}
    sizes = [mass * length ** powers.get(name.split(" ")[0].split(".")[1], 2) for name in found.names]
    deviation = np.sqrt(30.0 * np.mean((found.standard_deviations / sizes) ** 2))
    assert np.exp(result.cost) == pytest.approx(deviation, rel=1e-3)


def test_bad_input() -> None:
    ball = Link(joints.Spherical("ball"), SpatialInertia(mass=1.0, inertia=np.eye(3)), np.eye(4))
    passive = Mechanism(arm().links, driven=["elbow"])
    for mechanism, options, match in (
        (arm(speed=None, effort=None), {}, "position or speed for 'shoulder', 'elbow'"),
        (arm(speed=None, upper=None), {}, "no limit of position or speed"),
        (Mechanism([ball]), {}, r"lock\({joint: position}\)"),
        (passive, {}, "a motor for each joint, got none for 'shoulder'"),
        (arm(), {"period": -1.0}, "period"),
        (arm(), {"harmonics": 1}, "harmonics"),
        (arm(), {"nodes": 5}, "nodes"),
        (arm(), {"links": ["hand"]}, "hand"),
        (arm(), {"drives": ["gear"]}, "drives among"),
    ):
        with pytest.raises(ModelError, match=match):
            tx.trajectory.exciting_problem(mechanism, **{"period": 2.0, **options})
    with pytest.raises(InputError, match="noise"):
        tx.trajectory.exciting_problem(arm(), period=2.0, noise=-1.0)


@pytest.mark.slow
def test_a_second_robot_is_identified_better_than_from_a_random_motion() -> None:
    """An arm of seven joints from a URDF file with 1 % noise: standard deviations over 200 seeds are the bound."""
    panda, period, count = mechanics.load(EXAMPLES / "panda.urdf"), 10.0, 300
    start = tx.trajectory.exciting_problem(panda, period=period).params["coefficients"]
    sigma = 0.01 * np.abs(with_torques(panda, start, period, count)["tau"]).max(axis=0)
    problem = tx.trajectory.exciting_problem(panda, period=period, noise=sigma)
    excited = problem.solve(max_iterations=80, strategies=())
    best = with_torques(panda, excited.params["coefficients"], period, count)
    random = with_torques(panda, problem.params["coefficients"], period, count)  # the best of 20 random ones
    bounds = [mechanics.identify(panda, records, noise=sigma) for records in (best, random)]
    assert len(bounds[0].names) >= len(bounds[1].names)
    wide = [mechanics.identify(panda, records, noise=sigma, tolerance=1e6) for records in (best, random)]
    ratio = wide[0].standard_deviations / wide[1].standard_deviations
    print(
        f"determined {[len(one.names) for one in bounds]}; deviations over the random ones {ratio.min()} {ratio.max()}"
    )
    assert np.exp(np.mean(np.log(ratio))) < 0.8
    noises = [np.random.default_rng(seed).normal(size=best["tau"].shape) for seed in range(200)]
    runs = [mechanics.identify(panda, best | {"tau": best["tau"] + sigma * noise}, noise=sigma) for noise in noises]
    spread = np.std([run.values for run in runs], axis=0, ddof=1) / bounds[0].standard_deviations
    print(f"over the bound: {spread.min()} to {spread.max()}")
    assert 0.85 <= spread.min() <= spread.max() <= 1.15
