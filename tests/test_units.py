"""Units: exact factors, what is done with them, and what a door refuses."""

import copy
import functools
import math
import operator
import pickle
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax import units
from twistax.mechanics import SpatialInertia
from twistax.units import Quantity, degrees, feet, knots, metres, minutes, seconds, slugs, taken

#: Their definitions, in m, kg, s and K.
EXACT = {
    "feet": Fraction("0.3048"),
    "inches": Fraction("0.0254"),
    "nautical_miles": Fraction(1852),
    "knots": Fraction(1852, 3600),
    "hours": Fraction(3600),
    "pounds": Fraction("0.45359237"),
    "pounds_force": Fraction("0.45359237") * Fraction("9.80665"),
    "slugs": Fraction("0.45359237") * Fraction("9.80665") / Fraction("0.3048"),
    "rankines": Fraction(5, 9),
    "newtons": Fraction(1),
    "pascals": Fraction(1),
    "kilometres": Fraction(1000),
}


@pytest.mark.parametrize("name", EXACT)
def test_factors_are_those_of_the_definitions(name: str) -> None:
    assert float(getattr(units, name)) == float(EXACT[name])


def test_quantities_are_floats_that_know_their_unit() -> None:
    altitude = 30_000 * feet
    assert isinstance(altitude, float)
    assert altitude == 9144.0
    assert repr(altitude) == "9144.0 m"
    assert (3.6 * slugs * feet**2).unit == "kg m2"
    assert repr(1.0 / seconds) == "1.0 s-1"
    assert repr(feet / feet) == "1.0 1"
    assert repr(-altitude + 2 * altitude - 144 * metres) == "9000.0 m"
    assert type(altitude + 1.0) is float
    assert type(1.0 - altitude) is float
    assert math.isclose(180 * degrees, math.pi)
    for other in (pickle.loads(pickle.dumps(altitude)), copy.deepcopy(altitude)):
        assert repr(other) == "9144.0 m"


def test_units_of_lists_arrays_and_expressions() -> None:
    assert repr([400, 0] * (feet / seconds)) == "[121.92 m s-1, 0.0 m s-1]"
    found = np.array([1.0, 2.0]) * feet
    assert isinstance(found, np.ndarray)
    np.testing.assert_array_equal(found, [0.3048, 0.6096])
    height = tx.State("h")
    assert float(tx.lower(height / feet)(0.0, {"h": np.float64(0.6096)})) == 2.0
    assert float(tx.lower(feet * height)(0.0, {"h": np.float64(2.0)})) == 0.6096


def test_comparisons_of_different_units_are_refused() -> None:
    for compared in (operator.lt, operator.le, operator.gt, operator.ge):
        with pytest.raises(tx.OperationError, match=r"0.3048 m and 1.0 s cannot be compared"):
            compared(feet, seconds)
    assert 1 * feet < 2 * metres
    assert 1 * feet <= 0.3048 < 2 * metres
    assert feet != seconds


def test_poses_and_inertias_refuse_other_units() -> None:
    np.testing.assert_array_equal(tx.pose(position=[1.0 * feet] * 3)[:3, 3], [0.3048] * 3)
    with pytest.raises(tx.InputError, match=r"pose: position expects m, got 1.0 s"):
        tx.pose(position=[seconds, 0.0, 0.0])
    with pytest.raises(tx.InputError, match=r"pose: euler expects rad, got 0.3048 m"):
        tx.pose(euler=[feet, 0.0, 0.0])
    with pytest.raises(tx.InputError, match=r"pose: rotation_vector expects rad"):
        tx.pose(rotation_vector=[0.0, feet, 0.0])
    with pytest.raises(tx.InputError, match=r"inertia expects kg m2, got 0.3048 m"):
        SpatialInertia(mass=1.0, inertia=np.eye(3).tolist() * feet)
    endless: list[Any] = [1.0]
    endless.append(endless)
    with pytest.raises(tx.InputError, match="rate expects real numbers"):
        taken("rate", endless, seconds**-1)


def test_sums_of_different_units_are_refused() -> None:
    with pytest.raises(tx.OperationError, match=r"0.3048 m and 1.0 s cannot be added"):
        _ = feet + seconds
    with pytest.raises(tx.OperationError, match=r"a whole number as exponent, got 0.5"):
        _ = feet**0.5


@pytest.mark.parametrize(
    ("value", "unit", "shape", "words"),
    [
        (3 * knots, metres, (), "x expects m, got .* m s-1\\.\n  fix"),
        ([1 * feet, 1 * degrees], metres, (2,), "x expects m, got .* rad"),
        ([1.0, 2.0], metres, (), "a finite number in m, got"),
        (np.inf, metres, (), "a finite number in m, got inf"),
        ("high", metres, (), "real numbers, got 'high'"),
    ],
)
def test_a_door_refuses(value: Any, unit: Quantity, shape: tuple[int, ...], words: str) -> None:
    with pytest.raises(tx.InputError, match=words):
        taken("x", value, unit, shape)


def test_a_door_takes_plain_numbers() -> None:
    np.testing.assert_array_equal(taken("x", (1 * feet, 2.0), metres, (2,)), [0.3048, 2.0])


@pytest.mark.parametrize("number", [np.float64(3.0), np.float32(3.0), np.int64(3)])
def test_numbers_of_numpy_keep_the_unit(number: Any) -> None:
    for made, words in [(number * feet, "m"), (feet * number, "m"), (number / seconds, "s-1")]:
        assert isinstance(made, Quantity)
        assert made.unit == words
    assert number * feet == 3 * 0.3048
    assert np.cos(60 * degrees) == pytest.approx(0.5)


def test_times_refuse_other_units(unchecked: None) -> None:
    x = tx.State("x")
    fall = tx.compile(tx.System({x: -x}))
    far, run = 3 * feet, functools.partial(tx.integrate, fall, {"x": 1.0})
    calls: dict[str, Callable[[], Any]] = {
        "t1": lambda: run(t1=far, dt=0.1),
        "t0": lambda: run(t0=far, t1=2.0, dt=0.1),
        "dt": lambda: run(t1=1.0, dt=far),
        "save_at": lambda: run(t1=1.0, dt=0.1, save_at=[0.5, far]),
        "jumps": lambda: run(t1=1.0, rtol=1e-6, jumps=[far]),
        "ZeroOrderHold: ts": lambda: tx.ZeroOrderHold([0.0, far], [1.0, 2.0]),
        "duration": lambda: tx.integrate_phases([tx.Phase(fall, duration=far)], {"x": 1.0}, dt=0.1),
        "StepControl: dtmax": lambda: tx.StepControl(dtmax=far),
        "final_time": lambda: tx.trajectory.Problem(fall, tx.Minimize(x), final_time=(1.0, far)),
        "trim: t": lambda: tx.trim(fall, {"x": 1.0}, free="x", zero="x", t=far),
        "evaluate: t": lambda: run(t1=1.0, dt=0.5, dense=True).evaluate(far),
    }
    for name, call in calls.items():
        with pytest.raises(tx.InputError, match=f"{name} expects s, got .* m\\.\n  fix"):
            call()
    assert float(run(t1=0.01 * minutes, dt=0.1 * seconds).ts[-1]) == 0.6
