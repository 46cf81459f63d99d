"""Events within a step and at the start, and crossings that do not end an integration, against exact times."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

PULL = 9.81
h, v = tx.State("h"), tx.State("v")
FIXED, CHOSEN = {"dt": 0.25}, {"rtol": 1e-9}
#: With a polynomial, and without one.
METHODS = {
    "fixed": FIXED,
    "chosen": CHOSEN,
    "commutator-free": FIXED | {"method": tx.CommutatorFree()},
    "Radau": CHOSEN | {"method": tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)},
}

NAMES = [pytest.param(name, marks=[pytest.mark.slow] if name == "Radau" else []) for name in METHODS]


@functools.cache
def ball(native: bool = True) -> tx.Dynamics:
    """A ball that is thrown: its height is a parabola, which every step has exactly."""
    system = tx.System(rates={h: v, v: -tx.Parameter("pull", value=PULL) + 0.0 * h})
    return tx.compile(system) if native else tx.compile(system, backend=tx.JAX())


def thrown(event: Any, speed: Any = 10.0, height: Any = 0.0, t1: float = 3.0, **how: Any) -> tx.Solution:
    how = how if {"dt", "rtol"} & how.keys() else FIXED | how
    return tx.integrate(ball(), {"h": height, "v": speed}, t1=t1, event=event, **how)


def passes(level: float, speed: float = 10.0) -> np.ndarray:
    """When the ball passes a level, up and down."""
    return (speed + np.array([-1.0, 1.0]) * np.sqrt(speed**2 - 2.0 * PULL * level)) / PULL


# ---- two roots within a step ---------------------------------------------------------------------------------------

TOP = 100.0 / (2.0 * PULL)


@pytest.mark.parametrize("name", NAMES)
def test_two_roots_within_a_step_are_seen(name: str) -> None:
    """A level just below the top, between two places at which the step is looked at; one just above it."""
    for below in (1e-2, 1e-6):
        found = thrown(tx.Event(h - (TOP - below)), **METHODS[name])
        assert found.result is tx.Result.EVENT
        np.testing.assert_allclose(found.ts, passes(TOP - below)[:1], atol=2e-10)
        down = thrown(tx.Event(h - (TOP - below), direction=False), **METHODS[name])
        np.testing.assert_allclose(down.ts, passes(TOP - below)[1:], atol=2e-10)
    assert thrown(tx.Event(h - (TOP + 1e-6)), **METHODS[name]).result is tx.Result.SUCCESS


def test_a_perigee_below_the_ground_is_met() -> None:
    """An orbit whose perigee lies 10 km, or 100 m, under a sphere; the time of impact is that of Kepler's equation."""
    mu, radius, apogee = 3.986004418e14, 6.371e6, 4.2e7
    r, w = tx.State("r", shape=(2,)), tx.State("w", shape=(2,))
    orbit = tx.compile(tx.System(rates={r: w, w: -mu * r / tx.linalg.Norm(r) ** 3}))
    ground = tx.Event(tx.linalg.Norm(r) - radius, direction=False)
    for depth in (1e4, 100.0, -100.0):
        perigee = radius - depth
        a, e = 0.5 * (apogee + perigee), (apogee - perigee) / (apogee + perigee)
        n, speed = np.sqrt(mu / a**3), np.sqrt(mu * (2.0 / apogee - 1.0 / a))
        start = {"r": [apogee, 0.0], "w": [0.0, speed]}
        found = tx.integrate(orbit, start, t1=2.0 * np.pi / n, rtol=1e-6, event=ground)
        if depth < 0.0:
            assert found.result is tx.Result.SUCCESS
            continue
        E = -np.arccos((1.0 - radius / a) / e)  # of the impact, before the perigee
        impact = (E - e * np.sin(E) + np.pi) / n
        assert found.result is tx.Result.EVENT
        np.testing.assert_allclose(found.ts, [impact], atol=1.0 if depth < 1e3 else 0.1)
        np.testing.assert_allclose(np.linalg.norm(found.xs["r"][0]), radius, rtol=1e-12)
        assert found.stats.steps < 60


# ---- conditions at the start ---------------------------------------------------------------------------------------

ON_GROUND, FALLS, STOP, IGNORE = h < 0.0, {"direction": False}, tx.AtStart.STOP, tx.AtStart.IGNORE


@pytest.mark.parametrize("how", [FIXED, CHOSEN], ids=["fixed", "chosen"])
@pytest.mark.parametrize(
    ("event", "height", "speed", "time", "at_start"),
    [
        pytest.param(tx.Event(h, **FALLS), 0.0, 0.0, 0.0, True, id="begins to fall"),
        pytest.param(tx.Event(h, at_start=IGNORE, **FALLS), 0.0, 0.0, None, True, id="begins to fall, ignored"),
        pytest.param(tx.Event(h, **FALLS), 0.0, 5.0, 10.0 / PULL, True, id="takes off and lands"),
        pytest.param(tx.Event(h, at_start=STOP, **FALLS), 0.0, 5.0, 10.0 / PULL, True, id="takes off and lands, stop"),
        pytest.param(tx.Event(h, **FALLS), -1.0, 0.0, None, True, id="a number past zero"),
        pytest.param(tx.Event(h, at_start=STOP, **FALLS), -1.0, 0.0, 0.0, True, id="a number past zero, stop"),
        pytest.param(tx.Event(ON_GROUND), -1.0, 0.0, 0.0, True, id="a condition that holds"),
        pytest.param(tx.Event(ON_GROUND, at_start=IGNORE), -1.0, 0.0, None, True, id="a condition, ignored"),
        pytest.param(tx.Event(ON_GROUND), 0.0, 5.0, 10.0 / PULL, True, id="a condition that ceases to hold"),
        pytest.param(tx.Event(h), 0.0, 5.0, 10.0 / PULL, True, id="any direction"),
        pytest.param(tx.Event(h, at_start=STOP), 0.0, 5.0, 0.0, True, id="any direction, stop"),
        pytest.param(tx.Event(h, **FALLS), 5.0, 0.0, np.sqrt(10.0 / PULL), False, id="before zero"),
    ],
)
def test_an_event_at_the_start(
    event: tx.Event, height: float, speed: float, time: float | None, at_start: bool, how: dict
) -> None:
    found = thrown(event, speed, height, save_at=[0.0, 0.01, 3.0], **how)
    assert found.result is (tx.Result.SUCCESS if time is None else tx.Result.EVENT)
    np.testing.assert_array_equal(found.at_start, [at_start])
    if time is not None:
        np.testing.assert_allclose(found.ts[-1], time, atol=1e-12)
    if time == 0.0:
        assert found.event == 0
        assert float(found.xs["h"][-1]) == height
        assert found.stats.steps == 0


def test_the_result_says_which_event_held() -> None:
    found = thrown([tx.Event(v < 0.0), tx.Event(h < 1.0), tx.Event(h >= 7.0)], 1.0, 5.0)
    np.testing.assert_array_equal(found.at_start, [False, False, False])
    assert found.event == 0
    found = thrown([tx.Event(v < 0.0), tx.Event(h < 6.0), tx.Event(h >= 7.0)], 1.0, 5.0)
    np.testing.assert_array_equal(found.at_start, [False, True, False])
    assert (found.event, float(found.ts[-1])) == (1, 0.0)


# ---- crossings -----------------------------------------------------------------------------------------------------

LEVEL, TURN = tx.Event(h - 3.0, terminal=False), tx.Event(v, terminal=False)


@pytest.mark.parametrize("name", NAMES)
def test_crossings_have_their_times_states_events_and_directions(name: str) -> None:
    """Until the ball lands; with steps of 1.5 s all three lie in one step."""
    how = METHODS[name]
    for more in (how, {**how, "dt": 1.5} if "dt" in how else how):
        found = thrown([LEVEL, TURN, tx.Event(h, direction=False)], save_at=[0.5, 1.0], **more)
        up, down = passes(3.0)
        assert (found.event, found.crossings.count) == (2, 3)
        np.testing.assert_allclose(found.crossings.ts, [up, 10.0 / PULL, down], atol=1e-9)
        np.testing.assert_array_equal(found.crossings.events, [0, 1, 0])
        np.testing.assert_array_equal(found.crossings.directions, [1, -1, -1])
        np.testing.assert_allclose(found.crossings.xs["h"], [3.0, TOP, 3.0], atol=1e-8)
        np.testing.assert_allclose(found.crossings.xs["v"], 10.0 - PULL * np.array([up, 10.0 / PULL, down]), atol=1e-8)
        np.testing.assert_allclose(found.ts, [0.5, 1.0, 20.0 / PULL], atol=1e-9)


def test_without_an_event_that_ends_it_nothing_else_changes() -> None:
    """The rows are those that were asked for; a crossing at the start, and what is crossed after the end, are not."""
    found = thrown([LEVEL, tx.Event(h, direction=True, terminal=False, at_start=IGNORE)], t1=1.0, save_at=[0.2, 1.0])
    plain = thrown(None, t1=1.0, save_at=[0.2, 1.0])
    assert found.result is tx.Result.SUCCESS
    np.testing.assert_allclose(found.xs["h"], plain.xs["h"], rtol=1e-14)
    assert (found.event, found.crossings.count) == (None, 1)
    # Both in the last step, of which the one that ends it comes first.
    early = thrown([tx.Event(h - 3.0, terminal=False), tx.Event(h - 2.9)], dt=3.0)
    assert (early.event, early.crossings.count) == (1, 0)
    at_once = thrown(tx.Event(h, direction=True, terminal=False), t1=1.0)
    np.testing.assert_array_equal(at_once.crossings.ts, [0.0])
    assert float(at_once.crossings.xs["v"][0]) == 10.0


@pytest.mark.parametrize(
    "how", [{"steps": 40}, {"rtol": 1e-8, "control": tx.StepControl(dtmax=0.5)}], ids=["fixed", "chosen"]
)
def test_crossings_are_bounded(how: dict) -> None:
    """cos(8 t) has 13 zeros in 5 s."""
    x = tx.State("x")
    clock = tx.compile(tx.System(rates={x: 1.0 + 0.0 * x}))
    event = tx.Event(tx.Cos(8.0 * x), terminal=False)
    found = tx.integrate(clock, {"x": 0.0}, t1=5.0, event=event, max_crossings=13, **how)
    zeros = (np.arange(13) + 0.5) * np.pi / 8.0
    np.testing.assert_allclose(found.crossings.ts, zeros, atol=1e-12)
    with pytest.raises(tx.IntegrationError, match=r"more than 12 crossings .*\n.*\n.*\n  fix: .*max_crossings"):
        tx.integrate(clock, {"x": 0.0}, t1=5.0, event=event, max_crossings=12, **how)
    part = tx.integrate(clock, {"x": 0.0}, t1=5.0, event=event, max_crossings=12, throw=False, **how)
    assert part.result is tx.Result.MAX_CROSSINGS
    np.testing.assert_allclose(part.crossings.ts, zeros[: part.crossings.count], atol=1e-12)
    assert zeros[part.crossings.count - 1] < float(part.ts[-1]) <= zeros[12] + 1e-12


def _crossed(z: jax.Array, how: dict) -> tx.Crossings:
    event = [LEVEL, TURN, tx.Event(h, direction=False)]
    pull = {"pull": z[1]}
    return tx.integrate(
        ball(), {"h": 0.0, "v": z[0]}, t1=3.0, event=event, params=pull, max_crossings=5, **how
    ).crossings


@pytest.mark.parametrize("how", [{"steps": 6}, {"rtol": 1e-9, "control": tx.StepControl(max_steps=32)}])
def test_a_batch_of_crossings_and_their_derivatives(how: dict) -> None:
    """Of other numbers; dt/dp by the implicit function theorem, of which the exact times know nothing."""
    z = jnp.array([[10.0, PULL], [7.0, PULL], [9.0, 8.0]])
    found = jax.jit(jax.vmap(lambda z: _crossed(z, how)))(z)
    np.testing.assert_array_equal(found.count, [3, 1, 3])
    assert np.isnan(found.ts[1, 1:]).all()
    assert (np.asarray(found.events[:, 3:]) == -1).all()

    def exact(z: jax.Array) -> jax.Array:
        root = jnp.sqrt(z[0] ** 2 - 6.0 * z[1])
        return jnp.stack([z[0] - root, z[0], z[0] + root]) / z[1]

    for k in (0, 2):
        np.testing.assert_allclose(found.ts[k, :3], exact(z[k]), atol=1e-9)
    times = lambda z: _crossed(z, how).ts[:3]  # noqa: E731
    speeds = lambda z: _crossed(z, how).xs["v"][:3]  # noqa: E731
    wanted, of_speed = jax.jacfwd(exact)(z[0]), jax.jacfwd(lambda z: z[0] - z[1] * exact(z))(z[0])
    forward, backward = jax.jit(lambda z: (jax.jacfwd(times)(z), jax.jacrev(speeds)(z)))(z[0])
    np.testing.assert_allclose(forward, wanted, atol=1e-7)
    np.testing.assert_allclose(backward, of_speed, atol=1e-6)


@pytest.mark.parametrize("how", [FIXED, CHOSEN], ids=["fixed", "chosen"])
def test_backward_in_time(how: dict) -> None:
    """The same crossings in the other order, and what rose falls."""
    end = {"h": 30.0 - 4.5 * PULL, "v": 10.0 - 3.0 * PULL}
    ts = np.array([2.0, 1.5, 0.1])
    event = [LEVEL, TURN, tx.Event(h, direction=False)]
    found = tx.integrate(ball(), end, t0=3.0, t1=-1.0, event=event, save_at=ts, dense=True, **how)
    up, down = passes(3.0)
    np.testing.assert_allclose(found.crossings.ts, [down, 10.0 / PULL, up], atol=1e-9)
    np.testing.assert_array_equal(found.crossings.directions, [1, 1, -1])
    np.testing.assert_allclose(found.ts, [*ts, 0.0], atol=1e-9)
    assert found.event == 2
    np.testing.assert_allclose(found.evaluate(ts)["h"], found.xs["h"][:3], atol=1e-9)


def test_without_x64_and_without_kernels() -> None:
    with jax.enable_x64(False):
        low = tx.compile(ball().system)
        found = tx.integrate(low, {"h": 0.0, "v": 10.0}, t1=3.0, event=[LEVEL, tx.Event(h < -1.0)], dt=0.1)
        assert found.crossings.ts.dtype == np.float32
    other = tx.integrate(ball(False), {"h": 0.0, "v": 10.0}, t1=3.0, event=[LEVEL, tx.Event(h < -1.0)], rtol=1e-8)
    for each in (found, other):
        np.testing.assert_allclose(each.crossings.ts, passes(3.0), atol=2e-6)


def test_refusals(unchecked: None) -> None:
    with pytest.raises(tx.ModelError, match="terminal must be True or False"):
        tx.Event(h, terminal=None)
    with pytest.raises(tx.ModelError, match=r"at_start expects a tx\.AtStart"):
        tx.Event(h, at_start="stop")
    with pytest.raises(tx.InputError, match="max_crossings applies to events that do not end"):
        thrown(tx.Event(h), max_crossings=3, dt=0.1)
    with pytest.raises(tx.InputError, match="max_crossings applies to events"):
        thrown(None, max_crossings=3, dt=0.1)
    with pytest.raises(tx.InputError, match="max_crossings must be a whole number of 1 or more, got 0"):
        thrown(LEVEL, max_crossings=0, dt=0.1)
