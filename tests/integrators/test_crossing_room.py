"""More crossings than there is room for: they count in the order of time, however a step is searched."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

x = tx.State("x")

#: Levels that a clock passes within an eighth of a step of 1 s, in an order that is not that of time.
LEVELS, LAST = (0.58, 0.53, 0.60, 0.51, 0.52), 0.55

#: With a polynomial, without one, and with more than one step.
METHODS = {
    "fixed": {"steps": 1},
    "two steps": {"steps": 2},
    "chosen": {"rtol": 1e-9, "dt": 1.0},
    "commutator-free": {"steps": 1, "method": tx.CommutatorFree()},
}


@functools.cache
def clock(native: bool = True) -> tx.Dynamics:
    """x' = 1: it passes a level at the time of that level."""
    system = tx.System(rates={x: 1.0 + 0.0 * x})
    return tx.compile(system) if native else tx.compile(system, backend=tx.JAX())


def events(levels: Sequence[float] = LEVELS, last: float = LAST) -> list[tx.Event]:
    return [*(tx.Event(x - level, terminal=False) for level in levels), tx.Event(x - last)]


def passed(room: int, native: bool = True, back: bool = False, **how: Any) -> tx.Solution:
    span = {"t0": 1.0, "t1": 0.0} if back else {"t1": 1.0}
    event = how.pop("event", None) or events()
    return tx.integrate(
        clock(native), {"x": 1.0 if back else 0.0}, event=event, max_crossings=room, throw=False, **span, **how
    )


def expected(levels: Any, last: float, room: int, sign: float = 1.0) -> tuple[tx.Result, float, np.ndarray]:
    """How it ends, when, and the crossings until then."""
    levels = sign * np.sort(sign * np.asarray(levels))
    before = levels[sign * levels < sign * last]
    if len(before) > room:
        return tx.Result.MAX_CROSSINGS, before[room], before[:room]
    return tx.Result.EVENT, last, before


def check(found: tx.Solution, wanted: tuple[tx.Result, float, np.ndarray], levels: Any, atol: float = 1e-13) -> None:
    result, end, times = wanted
    assert found.result is result
    np.testing.assert_allclose(found.ts[-1], end, atol=atol)
    np.testing.assert_allclose(found.xs["x"][-1], end, atol=atol)
    assert found.crossings.count == len(times)
    np.testing.assert_allclose(found.crossings.ts, times, atol=atol)
    np.testing.assert_allclose(found.crossings.xs["x"], times, atol=atol)
    np.testing.assert_allclose(np.asarray(levels)[np.asarray(found.crossings.events)], times, atol=atol)


@pytest.mark.parametrize("back", [False, True], ids=["forward", "backward"])
@pytest.mark.parametrize("name", METHODS)
def test_what_comes_first_counts(name: str, back: bool) -> None:
    """In one step: with room for all before the event it is met, with less the integration ends at the first without.

    Those after the event need no room.
    """
    sign = -1.0 if back else 1.0
    for room in (1, 2, 3):
        found = passed(room, back=back, **METHODS[name])
        check(found, expected(LEVELS, LAST, room, sign), LEVELS)
        assert found.event == (5 if found.result is tx.Result.EVENT else None)


def test_without_kernels_and_in_single_precision() -> None:
    for room in (2, 3):
        check(passed(room, native=False, rtol=1e-9, dt=1.0), expected(LEVELS, LAST, room), LEVELS)
    with jax.enable_x64(False):
        low = tx.compile(clock().system)
        for room in (2, 3):
            found = tx.integrate(low, {"x": 0.0}, t1=1.0, steps=1, event=events(), max_crossings=room, throw=False)
            check(found, expected(LEVELS, LAST, room), LEVELS, 1e-6)


@pytest.mark.parametrize("how", [{"steps": 3}, {"rtol": 1e-9, "dt": 0.4}], ids=["fixed", "chosen"])
def test_many_levels_over_several_steps_under_jit_and_vmap(how: dict[str, Any]) -> None:
    """Members begin at other places, so that they meet other levels, in other steps; ten levels, room for four."""
    random = np.random.default_rng(3)
    levels, last = random.uniform(0.0, 1.0, 10), 0.9
    watched = events(list(levels), last)
    starts = np.array([-0.02, 0.2, 0.5, 0.7])

    def one(start: jax.Array) -> tx.Solution:
        end = {"t1": 1.0} if "steps" in how else {"t1": 1.0, "control": tx.StepControl(max_steps=16)}
        return tx.integrate(clock(), {"x": start}, event=watched, max_crossings=4, throw=False, **end, **how)

    found = jax.jit(jax.vmap(one))(jnp.asarray(starts))
    for k, start in enumerate(starts):
        result, _, places = expected(levels[levels > start], last, 4)
        assert int(found.result[k]) == result
        assert int(found.crossings.count[k]) == len(places)
        np.testing.assert_allclose(found.crossings.ts[k, : len(places)], places - start, atol=1e-13)
        assert np.isnan(found.crossings.ts[k, len(places) :]).all()
    assert {int(code) for code in found.result} == {tx.Result.EVENT, tx.Result.MAX_CROSSINGS}


def test_a_crossing_at_the_time_of_the_event_needs_no_room() -> None:
    """It is there if there is room."""
    level = tx.Event(x - LAST, terminal=False)
    for first, second in ((level, tx.Event(x - LAST)), (tx.Event(x - LAST), level)):
        event = [tx.Event(x - 0.51, terminal=False), first, second]
        for room, count in ((1, 1), (2, 2)):
            found = passed(room, steps=1, event=event)
            assert found.result is tx.Result.EVENT
            assert found.crossings.count == count


def test_more_crossings_at_the_start_than_room() -> None:
    event = [tx.Event(x, direction=True, terminal=False), tx.Event(2.0 * x, direction=True, terminal=False)]
    for room, result in ((1, tx.Result.MAX_CROSSINGS), (2, tx.Result.SUCCESS)):
        found = passed(room, steps=2, event=event)
        assert found.result is result
        np.testing.assert_array_equal(found.crossings.events, [0, 1][:room])
        np.testing.assert_array_equal(found.crossings.ts, [0.0, 0.0][:room])
    assert float(passed(1, steps=2, event=event).ts[-1]) == 0.0


def test_saved_times_and_dense_output_reach_the_crossing_without_room() -> None:
    saves = np.array([0.2, 0.515, 0.54])
    found = passed(2, steps=1, save_at=saves, dense=True)
    np.testing.assert_allclose(found.ts, [0.2, 0.515, 0.53], atol=1e-13)
    np.testing.assert_allclose(found.xs["x"], found.ts, atol=1e-13)
    np.testing.assert_allclose(found.evaluate(0.525)["x"], 0.525, atol=1e-13)
    with pytest.raises(tx.InputError, match=r"in \[0, 0.53\]"):
        found.evaluate(0.54)


def test_the_error_names_room_and_time_and_evaluates_no_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    def unwanted(*_: Any) -> None:
        raise AssertionError("the error needs no rates")

    monkeypatch.setattr("twistax.integrators.loop.failures.on_host", unwanted)
    with pytest.raises(tx.IntegrationError, match=r"more than 2 crossings .* at t = 0.53 s\.\n.*\n.*\n.*max_crossings"):
        tx.integrate(clock(), {"x": 0.0}, t1=1.0, rtol=1e-9, dt=1.0, event=events(), max_crossings=2)


def test_derivatives_up_to_the_crossing_without_room() -> None:
    """Rows before it have theirs; the end of a failed integration has none."""

    def place(start: jax.Array) -> tuple[jax.Array, jax.Array]:
        event = events()[:-1]
        how: dict[str, Any] = {"steps": 2, "event": event, "max_crossings": 2, "throw": False}
        found = tx.integrate(clock(), {"x": start}, t1=1.0, save_at=jnp.array([0.2, 0.515, 0.9]), **how)
        return found.xs["x"], found.crossings.ts

    xs, ts = jax.jit(jax.jacrev(place))(jnp.asarray(0.0))
    np.testing.assert_array_equal(xs, [1.0, 1.0, np.nan])
    np.testing.assert_allclose(ts, [-1.0, -1.0], atol=1e-13)
