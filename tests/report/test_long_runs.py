"""The report on long runs measures what it says, here on short ones."""

import numpy as np
import pytest

import twistax as tx
from twistax.report import long_runs
from twistax.scenes import SCENES

STEPS = 2_000


@pytest.fixture(scope="module")
def motions() -> dict[str, long_runs.Motion]:
    return {motion.name: motion for motion in long_runs.motions()}


def test_momenta_of_the_exact_motion_stay(motions: dict[str, long_runs.Motion]) -> None:
    kept = motions["free, offset center of mass"].kept["momentum"]
    states = [SCENES["offset-tumble"].truth(t) for t in np.linspace(0.0, 10.0, 11)]
    xs = {name: np.stack([state[name] for state in states]) for name in ("g", "V")}
    values, size = kept(xs)
    assert np.abs(values - values[0]).max() < 1e-12
    assert size.min() > 3.0
    for i in range(6):
        off = xs["V"] + 1e-6 * np.outer(np.arange(11.0), np.eye(6)[i])
        values, _ = kept(xs | {"V": off})
        assert np.abs(values - values[0]).max() > 1e-6


@pytest.mark.slow
def test_a_top_keeps_its_vertical_momentum_alone(motions: dict[str, long_runs.Motion]) -> None:
    """The horizontal ones change: what is measured is no constant. Another method loses it."""
    motion = motions["heavy top, three moments"]
    method = tx.Splitting(tx.compositions.SUZUKI4, motion.bodies)
    row = long_runs.flown(motion, method, STEPS)
    assert row.changes["vertical momentum"] < 1e-13
    assert 1e-14 < row.changes["energy"] < 1e-8
    lost = long_runs.flown(motion, tx.RKMK(tx.tableaus.RK4), STEPS).changes
    assert lost["vertical momentum"] > 1e-9
    assert lost["energy"] > 1e-9
    end = tx.integrate(motion.dynamics, motion.start, t1=20.0, steps=STEPS, method=method).xs
    moved = end["R"][-1] @ (np.array([1.0, 1.3, 0.5]) * end["w"][-1])
    start = motion.start["R"] @ (np.array([1.0, 1.3, 0.5]) * motion.start["w"])
    assert np.abs(np.asarray(moved)[:2] - start[:2]).max() > 0.1


def test_every_bar_is_judged(motions: dict[str, long_runs.Motion]) -> None:
    names = {name for motion in motions.values() for name in motion.kept}
    assert names | {"time"} == set(long_runs.BARS)
    assert all(motion.judged == (tx.compositions.KAHAN_LI6,) for motion in motions.values())
