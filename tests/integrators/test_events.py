"""Solutions that end where a condition becomes zero, against exact times."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

WEIGHT = 9.81
SPIN = np.array([0.0, 0.0, 1.2])
FIXED = {"dt": 0.1}
CHOSEN = {"rtol": 1e-10}

g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(3,))
pull = tx.Parameter("pull", value=WEIGHT)


@functools.cache
def falling() -> tx.Dynamics:
    """A body that falls and turns about the vertical at a constant rate: heights and angles are known exactly."""
    rates = {g: tx.lie.twist(linear=g[:3, :3].T @ V, angular=SPIN), V: tx.Concat(0.0, 0.0, -pull)}
    return tx.compile(tx.System(rates=rates))


GROUND = tx.Event(g[2, 3])
QUARTER = tx.Event(g[0, 0], direction=-1)
#: Half a turn further: cos grows through zero at 3/4 of a turn.
RISING = tx.Event(g[0, 0], direction=True)


def start(height: Any = 5.0, speed: Any = 0.0) -> dict[str, Any]:
    return {"g": jnp.eye(4).at[2, 3].set(height), "V": jnp.zeros(3).at[2].set(speed)}


def solve(event: Any, height: Any = 5.0, speed: Any = 0.0, t1: float = 6.0, **how: Any) -> tx.Solution:
    return tx.integrate(falling(), start(height, speed), t1=t1, event=event, **how)


@pytest.mark.parametrize("how", [pytest.param(FIXED, marks=pytest.mark.slow), CHOSEN], ids=["fixed", "chosen"])
def test_the_first_of_several_events_stops_the_solution_at_its_exact_time(how: dict) -> None:
    """The same program for all heights: from low ones the ground comes first, from high ones the quarter of a turn."""
    events = [GROUND, QUARTER, RISING]
    turned = 0.5 * np.pi / SPIN[2]
    for height, which in ((5.0, 0), (50.0, 1)):
        solution = solve(events, height, **how)
        exact = np.sqrt(2.0 * height / WEIGHT) if which == 0 else turned
        assert solution.result is tx.Result.EVENT
        assert solution.event == which
        np.testing.assert_allclose(solution.ts, [exact], atol=2e-7 if "dt" in how else 1e-10)
        end = solution.xs["g"][0]
        np.testing.assert_allclose(end[:3, :3].T @ end[:3, :3], np.eye(3), atol=1e-14)
        np.testing.assert_allclose(end[2, 3] if which == 0 else end[0, 0], 0.0, atol=1e-14)
    assert "event" in str(tx.Result.EVENT)


@pytest.mark.slow
def test_directions() -> None:
    """Thrown up through 6 m at rising and falling heights; each direction stops at its own crossing."""
    rise, fall = (20.0 - np.sqrt(400.0 - 2.0 * WEIGHT)) / WEIGHT, (20.0 + np.sqrt(400.0 - 2.0 * WEIGHT)) / WEIGHT
    assert (tx.Event(V[0], 1).sense, tx.Event(V[0], -1).sense) == (1, -1)
    for direction, exact in ((True, rise), (False, fall)):
        solution = solve(tx.Event(g[2, 3] - 6.0, direction), 5.0, 20.0, **CHOSEN)
        np.testing.assert_allclose(solution.ts, [exact], atol=1e-10)


def test_without_an_event_on_the_way_the_end_is_reached() -> None:
    solution = solve(GROUND, 500.0, t1=1.0, **FIXED)
    assert solution.result is tx.Result.SUCCESS
    assert solution.event is None
    assert float(solution.ts[-1]) == 1.0
    plain = tx.integrate(falling(), start(500.0), t1=1.0, **FIXED)
    assert plain.event is None
    np.testing.assert_allclose(solution.xs["g"], plain.xs["g"], rtol=1e-15)
    assert solution.stats.steps == plain.stats.steps
    # The polynomial of a step reads the rate at its end too.
    assert solution.stats.rhs_evaluations == plain.stats.rhs_evaluations + plain.stats.steps


@pytest.mark.parametrize("how", [FIXED, pytest.param(CHOSEN, marks=pytest.mark.slow)], ids=["fixed", "chosen"])
def test_saved_times_before_the_event_and_the_event(how: dict) -> None:
    """Also those within the last step; later ones are cut, and the last row is the event. Dense output ends there."""
    exact = np.sqrt(2.0 * 5.0 / WEIGHT)
    saves = np.array([0.0, 0.5, 1.0, 1.005, exact - 1e-4, exact + 1e-4, 1.1, 5.0])
    solution = solve(GROUND, save_at=saves, dense=True, **how)
    np.testing.assert_allclose(solution.ts, [*saves[:5], exact], atol=2e-7)
    np.testing.assert_allclose(solution.xs["g"][:, 2, 3], 5.0 - 0.5 * WEIGHT * solution.ts**2, atol=2e-6)
    angle = SPIN[2] * solution.ts
    np.testing.assert_allclose(solution.xs["g"][:, 0, 0], np.cos(angle), atol=1e-9)
    np.testing.assert_allclose(solution.evaluate(solution.ts)["g"], solution.xs["g"], atol=1e-13)
    with pytest.raises(tx.InputError, match="the integrated span"):
        solution.evaluate(1.5)


def test_an_event_at_the_edge_of_a_step_is_neither_lost_nor_doubled() -> None:
    """x' = 1 from -0.5 in steps of 1/8, 1/16, ...: zero is exactly the end of a step, and of the solution it starts."""
    x = tx.State("x")
    line = tx.compile(tx.System(rates={x: 1.0 + 0.0 * x}))
    crossing = tx.Event(x)
    for steps in (8, 16, 24):
        solution = tx.integrate(line, {"x": -0.5}, t1=1.0, steps=steps, event=crossing)
        assert solution.result is tx.Result.EVENT
        assert float(solution.ts[-1]) == pytest.approx(0.5, abs=1e-15)
        again = tx.integrate(line, {"x": solution.xs["x"][-1]}, t0=solution.ts[-1], t1=1.0, steps=steps, event=crossing)
        assert again.result is tx.Result.SUCCESS
    # From round-off on either side it is no event; from further away it is.
    for offset, result in ((1e-16, "SUCCESS"), (-1e-16, "SUCCESS"), (0.0, "SUCCESS"), (-1e-6, "EVENT")):
        solution = tx.integrate(line, {"x": offset}, t1=1.0, steps=8, event=crossing)
        assert solution.result is tx.Result[result], offset
    # The solution ends where the condition becomes zero, up to round-off: else solutions in a row would lose it.
    for how in ({"steps": 8}, CHOSEN):
        assert tx.integrate(line, {"x": -1.0}, t1=1.0, event=crossing, **how).event == 0


def test_a_condition_that_returns_to_zero_stops_at_its_return() -> None:
    """Thrown up from the level itself."""
    solution = solve(tx.Event(g[2, 3] - 5.0), 5.0, 20.0, **CHOSEN)
    np.testing.assert_allclose(solution.ts, [2.0 * 20.0 / WEIGHT], atol=1e-9)


@pytest.mark.parametrize(("t", "how"), [(0.0, CHOSEN), (1e5, {"dt": 0.01})], ids=["chosen", "late"])
def test_a_bouncing_ball(t: float, how: dict) -> None:
    """Solutions from event to event: the times between bounces shrink as the speed does.

    Late, a time is known to 1e-11 s, within which the ball falls further than a thousand units of round-off of a step.
    """
    height, speed, between = 1.0, 0.0, []
    for _ in range(4):
        solution = tx.integrate(falling(), start(height, speed), t0=t, t1=t + 5.0, event=GROUND, **how)
        assert solution.event == 0
        between.append(float(solution.ts[-1]) - t)
        t, height, speed = float(solution.ts[-1]), solution.xs["g"][-1, 2, 3], -0.8 * solution.xs["V"][-1, 2]
    first = np.sqrt(2.0 / WEIGHT)
    np.testing.assert_allclose(between, first * np.array([1.0, 1.6, 1.28, 1.024]), rtol=1e-8)


def _gap(t: Any, x: Any, u: Any, params: Any) -> Any:
    return jnp.where((t > 0.33) & (t < 0.6), jnp.nan, 0.6 - t)


@pytest.mark.slow
@pytest.mark.parametrize("how", [pytest.param({"steps": 8}, marks=pytest.mark.slow), CHOSEN], ids=["fixed", "chosen"])
@pytest.mark.parametrize(
    ("condition", "exact"),
    [
        pytest.param(lambda t, x, u, params: jnp.minimum(t - 0.31, 0.0), 0.31, id="zero from then on"),
        pytest.param(_gap, 0.6, id="not a number before"),
        pytest.param(lambda t, x, u, params: jnp.where(t < 0.31, -1.0, 1.0), 0.31, id="a jump"),
        pytest.param(lambda t, x, u, params: jnp.sqrt(0.31 - t), None, id="not a number from then on"),
    ],
)
def test_conditions_that_are_not_smooth(condition: Any, exact: float | None, how: dict) -> None:
    """Steps reach far beyond: the first of many zeros is found, never the end of the step."""
    x = tx.State("x")
    line = tx.compile(tx.System(rates={x: 1.0 + 0.0 * x}))
    solution = tx.integrate(line, {"x": 0.0}, t1=1.0, event=tx.Event(condition), **how)
    assert solution.result is (tx.Result.SUCCESS if exact is None else tx.Result.EVENT)
    np.testing.assert_allclose(solution.ts, [1.0 if exact is None else exact], atol=1e-13)


def met_at(z: jax.Array, how: dict, level: Any = None) -> jax.Array:
    """When the ground is met, and how far it is turned there, from a height and a pull."""
    event = GROUND if level is None else tx.Event(lambda t, x, u, params: x["g"][2, 3] - level)
    solution = tx.integrate(falling(), start(z[0]), t1=3.0, params={"pull": z[1]}, event=event, **how)
    return jnp.stack([solution.ts[-1], solution.xs["g"][-1, 1, 0], solution.xs["V"][-1, 2]])


@pytest.mark.slow
@pytest.mark.parametrize("how", [FIXED, CHOSEN | {"control": tx.StepControl(max_steps=64)}], ids=["fixed", "chosen"])
def test_derivatives_of_the_time_and_the_state(how: dict) -> None:
    """dt = -(d condition)/(d condition/dt): forward and in reverse, of the time, the angle and the speed there."""

    def exact(z: jax.Array) -> jax.Array:
        t = jnp.sqrt(2.0 * z[0] / z[1])
        return jnp.stack([t, jnp.sin(SPIN[2] * t), -z[1] * t])

    z = jnp.array([5.0, WEIGHT])
    both = jax.jit(lambda z: (jax.jacfwd(met_at)(z, how), jax.jacrev(met_at)(z, how)))
    for found in both(z):
        np.testing.assert_allclose(found, jax.jacfwd(exact)(z), rtol=1e-6)


@pytest.mark.slow
def test_derivatives_with_respect_to_what_a_condition_closes_over() -> None:
    """A function as condition, under jit; a level 1 m up is met earlier by 1/v for every metre."""
    z = jnp.array([5.0, WEIGHT])
    slope = jax.jit(jax.grad(lambda level: met_at(z, FIXED, level)[0]))(jnp.asarray(1.0))
    np.testing.assert_allclose(slope, -1.0 / np.sqrt(2.0 * WEIGHT * 4.0), rtol=1e-6)


def test_a_batch_stops_each_member_at_its_own_event() -> None:
    """Some meet the ground, some solve on to the end; times not reached are not a number."""
    heights, saves = jnp.array([1.0, 5.0, 80.0]), jnp.array([0.2, 0.8, 2.0])

    def one(height: jax.Array) -> tx.Solution:
        return solve(GROUND, height, t1=2.0, save_at=saves, **CHOSEN)

    solutions = jax.jit(jax.vmap(one))(heights)
    exact = np.minimum(np.sqrt(2.0 * np.asarray(heights) / WEIGHT), 2.0)
    np.testing.assert_allclose(solutions.ts[:, -1], exact, atol=1e-9)
    np.testing.assert_array_equal(solutions.result, [tx.Result.EVENT, tx.Result.EVENT, tx.Result.SUCCESS])
    np.testing.assert_array_equal(solutions.event, [0, 0, -1])
    reached = np.isfinite(solutions.xs["g"][:, :3, 2, 3])
    np.testing.assert_array_equal(reached, np.asarray(saves)[None] <= exact[:, None])
    np.testing.assert_allclose(solutions.xs["g"][:2, -1, 2, 3], 0.0, atol=1e-13)


@pytest.mark.slow
def test_conditions_may_read_time_controls_and_parameters() -> None:
    x, F, k = tx.State("x"), tx.Control("F"), tx.Parameter("k", value=2.0)
    motor = tx.compile(tx.System(rates={x: k * F}))
    table = {"F": tx.ZeroOrderHold([0.0, 0.2], [1.0, 3.0])}
    event = [tx.Event(x * k - F), tx.Event(tx.Time() - 0.75)]
    # x = 2 t, then from 0.2 on 0.4 + 6 (t - 0.2), and k x reaches F = 3 at x = 1.5.
    solution = tx.integrate(motor, {"x": 0.0}, t1=1.0, rtol=1e-10, u=table, event=event)
    np.testing.assert_allclose(solution.ts, [0.2 + 1.1 / 6.0], atol=1e-12)
    late = tx.integrate(motor, {"x": 0.0}, t1=1.0, rtol=1e-10, u=table, params={"k": 0.1}, event=event)
    assert late.event == 1
    np.testing.assert_allclose(late.ts, [0.75], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "how"),
    [
        pytest.param(tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5), {"rtol": 1e-8}, marks=pytest.mark.slow),
        (tx.CommutatorFree(), FIXED),
    ],
    ids=["implicit", "commutator-free"],
)
def test_other_methods(method: Any, how: dict) -> None:
    solution = solve(GROUND, method=method, **how)
    np.testing.assert_allclose(solution.ts, [np.sqrt(2.0 * 5.0 / WEIGHT)], atol=1e-6)


@pytest.mark.parametrize("how", [{"dt": 0.1}, {"rtol": 1e-5}], ids=["fixed", "adaptive"])
@pytest.mark.parametrize("direction", [None, False])
def test_an_event_early_in_the_first_step_is_met_in_single_precision(how: Any, direction: Any) -> None:
    """A hundred-thousandth of the step after the start: a value is no zero because the step ends far from it."""
    h, v = tx.State("h"), tx.State("v")
    falling = tx.compile(tx.System(rates={h: v, v: -9.81 + 0.0 * h}))
    for event in (tx.Event(h, direction=direction), tx.Event(h < 0.0)):
        for height in (5e-4, 4e-4, 1e-4):
            start = {"h": np.float32(height), "v": np.float32(-50.0)}
            solution = tx.integrate(falling, start, t1=1.0, event=event, **how)
            assert solution.result is tx.Result.EVENT
            assert float(solution.ts[-1]) == pytest.approx(height / 50.0, rel=1e-2)


def test_an_event_just_after_the_start_is_met_from_either_side() -> None:
    x = tx.State("x")
    falling = tx.compile(tx.System(rates={x: -1.0 + 0.0 * x}))
    for direction in (None, False):
        solution = tx.integrate(falling, {"x": 1e-8}, t1=1.0, dt=1.0, event=tx.Event(x, direction=direction))
        assert solution.result is tx.Result.EVENT
        assert float(solution.ts[-1]) == pytest.approx(1e-8, rel=1e-6)


def test_what_is_small_at_the_end_is_no_event() -> None:
    """A ten-thousandth of the start, in single precision."""
    x = tx.State("x")
    falling = tx.compile(tx.System(rates={x: -0.9999 + 0.0 * x}))
    solution = tx.integrate(falling, {"x": np.float32(1.0)}, t1=1.0, dt=1.0, event=tx.Event(x))
    assert solution.result is tx.Result.SUCCESS
