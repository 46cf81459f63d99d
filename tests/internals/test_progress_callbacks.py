"""`tx.integrate(progress=...)`: what is told on the way, and that nothing else changes."""

import functools
import io
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.integrators.loop import progress_callback as meter
from twistax.integrators.loop.progress_callback import calling_back

FIXED, CHOSEN = {"dt": 5e-3}, {"rtol": 1e-10}
START = {"x": np.array([1.0, 0.0])}


@functools.cache
def pendulum() -> tx.Dynamics:
    x = tx.State("x", shape=(2,))
    return tx.compile(tx.System(rates={x: tx.Concat(x[1], -tx.Sin(x[0]))}))


def flown(**options: Any) -> tx.Solution:
    return tx.integrate(pendulum(), START, t1=200.0, save_at=np.array([50.1, 200.0]), **options)


@pytest.mark.parametrize("steps", [FIXED, CHOSEN], ids=["fixed", "chosen"])
def test_it_tells_how_far_it_is_and_changes_nothing(steps: dict[str, float]) -> None:
    told: list[tuple[float, float]] = []
    quiet = flown(**steps)
    loud = flown(**steps, progress=lambda t, share: told.append((t, share)))
    np.testing.assert_array_equal(loud.xs["x"], quiet.xs["x"])
    assert loud.stats == quiet.stats
    assert len(told) >= 3
    assert told == sorted(told)
    np.testing.assert_allclose([t for t, _ in told], [200.0 * share for _, share in told], rtol=1e-12)
    assert told[-1] == (200.0, 1.0)
    if "dt" in steps:
        assert len(told) == 100
    again: list[float] = []
    flown(**steps, progress=lambda t, share: again.append(t))
    assert again == [t for t, _ in told]
    assert meter._CALLBACKS == {}


def test_an_error_of_the_function_is_raised_once() -> None:
    calls = []

    def no(t: float, share: float) -> None:
        calls.append(t)
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        flown(**FIXED, progress=no)
    assert len(calls) == 1
    assert meter._CALLBACKS == {}


def test_nothing_is_told_where_something_is_traced() -> None:
    told: list[float] = []

    def end(x: jax.Array) -> jax.Array:
        return tx.integrate(pendulum(), {"x": x}, t1=0.1, steps=4, progress=lambda t, share: told.append(t)).xs["x"][-1]

    jax.jit(end)(START["x"])
    assert told == []


def test_other_things_are_refused() -> None:
    with pytest.raises(tx.InputError, match="progress expects True"):
        flown(**FIXED, progress=3)


def test_a_line_shows_it() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    line = Terminal()
    progress = tx.trajectory.Progress("flight", stream=line)
    progress.reached(50.0, 0.25)
    progress.reached(200.0, 1.0)
    assert "flight" in line.getvalue()
    assert "t           50 s    25.0 %" in line.getvalue()
    assert line.getvalue().endswith("\r\033[K")
    progress.reached(50.0, 0.25)
    with calling_back(progress.reached):  # ends on the way, by an event
        pass
    assert line.getvalue().endswith("\r\033[K")
