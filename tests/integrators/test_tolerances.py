"""What a tolerance is: by state, by rotation and position, by scale; and what is refused."""

import functools

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.tableaus import TSIT5

METHOD = tx.RKMK(TSIT5)


@functools.cache
def two_clocks() -> tx.Dynamics:
    """Two oscillators, a fast one of size 1 and a slow one of size 1e4, which do not know of each other."""
    a, b = tx.State("a", shape=(2,)), tx.State("b", shape=(2,))
    return tx.compile(tx.System(rates={a: tx.Concat(7.0 * a[1], -7.0 * a[0]), b: tx.Concat(b[1], -b[0])}))


CLOCKS = {"a": np.array([1.0, 0.0]), "b": np.array([1e4, 0.0])}


def errors_of(t1: float = 5.0, **options: object) -> tuple[float, float, object]:
    """Errors of the two oscillators, whose truth is a turn, each over its size."""
    sol = tx.integrate(two_clocks(), CLOCKS, t1=t1, method=METHOD, **options)
    parts = [
        np.abs(np.asarray(sol.xs[name][0]) / size - [np.cos(rate * t1), -np.sin(rate * t1)]).max()
        for name, size, rate in (("a", 1.0, 7.0), ("b", 1e4, 1.0))
    ]
    return parts[0], parts[1], sol.stats


def test_each_state_has_its_own_tolerance() -> None:
    """Whichever state is asked for more decides the steps."""
    loose = errors_of(rtol=1e-14, atol={"a": 1e-3, "b": 10.0})
    tight_a = errors_of(rtol=1e-14, atol={"a": 1e-9, "b": 10.0})
    tight_b = errors_of(rtol=1e-14, atol={"a": 10.0, "b": 1e-7})
    assert tight_a[0] < 1e-4 * loose[0]
    assert tight_b[1] < 1e-3 * loose[1]
    assert tight_a[2].accepted > 2 * tight_b[2].accepted > 4 * loose[2].accepted


def test_numbers_arrays_and_dicts_of_the_same_value_mean_the_same() -> None:
    forms = (1e-6, {"a": 1e-6, "b": np.full(2, 1e-6)}, {"a": np.full(2, 1e-6), "b": 1e-6}, None)
    stats = [errors_of(rtol=1e-6, atol=form)[2] for form in forms]
    assert all(found == stats[0] for found in stats)


def test_rtol_counts_the_size_of_the_state() -> None:
    """With a relative tolerance alone, the same solution at another size takes the same steps."""
    x0 = {name: 2.0**20 * value for name, value in CLOCKS.items()}
    settings = {"t1": 3.0, "rtol": 1e-7, "atol": 0.0, "method": METHOD}
    one, other = (tx.integrate(two_clocks(), start, **settings) for start in (CLOCKS, x0))
    assert one.stats == other.stats
    np.testing.assert_allclose(np.asarray(other.xs["b"]), 2.0**20 * np.asarray(one.xs["b"]), rtol=1e-12)


def test_an_entry_of_an_array_counts_alone() -> None:
    """Entries with a loose tolerance do not ask for steps; the last digits go with the mean over all entries."""
    loose = errors_of(rtol=1e-12, atol={"a": np.array([1e3, 1e3]), "b": np.array([1e3, 1e3])})[2]
    one = errors_of(rtol=1e-12, atol={"a": np.array([1e-8, 1e3]), "b": np.array([1e3, 1e3])})[2]
    both = errors_of(rtol=1e-12, atol={"a": np.array([1e-8, 1e-8]), "b": np.array([1e3, 1e3])})[2]
    assert loose.accepted < 0.1 * one.accepted
    assert one.accepted == pytest.approx(both.accepted, rel=0.2)


@functools.cache
def screw(scale: float | None = None) -> tx.Dynamics:
    """A pose that turns with a rate of its own, and moves in its axes; the two errors can be told apart."""
    g, t = tx.State("g", group=tx.SE3), tx.Time()
    s = tx.State("s") if scale is None else tx.State("s", scale=scale)
    twist = tx.Concat(3.0 * tx.Sin(20.0 * t), 0.0, 0.0, 0.0, 0.0, 1.0 + tx.Sin(3.0 * t))
    return tx.compile(tx.System(rates={g: twist, s: tx.Cos(5.0 * t) * s}))


def screw_errors(atol: object, rtol: float = 1e-12, t1: float = 4.0) -> tuple[float, float, int]:
    """Errors of angle and position of a split solution; the angle has a closed form, the position a fine sum."""
    method = tx.RKMK(TSIT5, tx.charts.SplitExponential())
    sol = tx.integrate(
        screw(), {"g": np.eye(4), "s": 1e-12}, t1=t1, rtol=rtol, atol={"g": atol, "s": 1.0}, method=method
    )
    pose = np.asarray(sol.xs["g"][0])
    t, weights = np.polynomial.legendre.leggauss(200)
    t, weights = 0.5 * t1 * (t + 1.0), 0.5 * t1 * weights
    angle = t + (1.0 - np.cos(3.0 * t)) / 3.0
    speed = 3.0 * np.sin(20.0 * t)
    place = [np.sum(weights * speed * np.cos(angle)), np.sum(weights * speed * np.sin(angle)), 0.0]
    turn = t1 + (1.0 - np.cos(3.0 * t1)) / 3.0
    rotation = abs((np.arctan2(pose[1, 0], pose[0, 0]) - turn + np.pi) % (2.0 * np.pi) - np.pi)
    return rotation, float(np.abs(pose[:3, 3] - place).max()), sol.stats.accepted


def test_a_pose_has_a_tolerance_of_rotation_and_one_of_position() -> None:
    """The position oscillates seven times as fast as the rotation: tight positions need more steps."""
    rotation, position, few = screw_errors((1e-9, 1e3))
    assert rotation < 1e-7 < 1e-6 < position
    rotation, position, many = screw_errors((1e3, 1e-9))
    assert position < 1e-7
    assert many > 3 * few
    assert screw_errors((1e3, 1e-9)) == screw_errors(np.array([1e-9, 1e-9, 1e-9, 1e3, 1e3, 1e3]))
    assert screw_errors((1e-9, 1e-9))[2] == screw_errors(1e-9)[2]


def test_a_declared_scale_stands_for_the_size() -> None:
    """A state of size 1e-12 next to a scale of 1 asks for no steps; without one its own size counts."""
    pose = {"g": np.eye(4), "s": 1e-12}
    settings = {"t1": 4.0, "rtol": 1e-7, "atol": {"g": 1e3, "s": 0.0}, "method": METHOD}
    own = tx.integrate(screw(), pose, **settings)
    declared = tx.integrate(screw(1.0), pose, **settings)
    assert own.stats.accepted > 4 * declared.stats.accepted
    exact = 1e-12 * np.exp(np.sin(20.0) / 5.0)
    np.testing.assert_allclose(own.xs["s"], exact, rtol=1e-5)
    assert abs(float(declared.xs["s"][0]) / exact - 1.0) > 1e-6


def test_tolerances_never_fall_below_round_off() -> None:
    """atol of zero for a state that is large and a scale that is small: the solution still comes to its end."""
    x = tx.State("x", scale=1e-9)
    dynamics = tx.compile(tx.System(rates={x: x}))
    sol = tx.integrate(dynamics, {"x": 1e3}, t1=1.0, rtol=1e-12, atol=0.0, method=METHOD)
    assert sol.result is tx.Result.SUCCESS
    np.testing.assert_allclose(sol.xs["x"], 1e3 * np.exp(1.0), rtol=1e-12)


def test_a_start_at_zero_with_atol_zero_is_integrated() -> None:
    sol = tx.integrate(two_clocks(), {"a": np.zeros(2), "b": np.zeros(2)}, t1=1.0, rtol=1e-6, atol=0.0, method=METHOD)
    np.testing.assert_array_equal(sol.xs["a"], np.zeros((1, 2)))


# ---- nonsense --------------------------------------------------------------------------------------------------------


@functools.cache
def plain() -> tx.Dynamics:
    x, g = tx.State("x", shape=(2, 3)), tx.State("g", group=tx.SE3)
    return tx.compile(tx.System(rates={x: -x, g: np.arange(6.0)}))


def test_single_precision_is_told_of_double(unchecked: None) -> None:
    x0 = {"x": np.ones((2, 3), np.float32), "g": np.eye(4, dtype=np.float32)}
    with pytest.raises(tx.InputError, match=r"round-off of float32.\n  fix: use float64: jax.config.update\(\"jax_en"):
        tx.integrate(plain(), x0, t1=1.0, rtol=1e-6, atol=1e-3)


def test_traced_tolerances_are_not_checked_but_work() -> None:
    """Inside vmap one compiled solution serves many tolerances; each lane is the solution with its own."""
    tols = np.array([1e-4, 1e-6, 1e-8])
    solve = jax.vmap(lambda tol: tx.integrate(two_clocks(), CLOCKS, t1=2.0, rtol=tol, atol=tol, method=METHOD))
    lanes = solve(tols)
    for k, tol in enumerate(tols):
        alone = tx.integrate(two_clocks(), CLOCKS, t1=2.0, rtol=tol, atol=tol, method=METHOD)
        assert int(lanes.stats.accepted[k]) == alone.stats.accepted
        np.testing.assert_allclose(lanes.xs["b"][k], alone.xs["b"], rtol=1e-11)
