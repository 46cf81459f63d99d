"""Jumps of the controls: steps end there, start afresh, and cost nothing more than that."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.tableaus import BOGACKI_SHAMPINE3, DOP853, DORMAND_PRINCE5, TSIT5

TOL = 1e-9
HALF_BELOW = tx.Event(tx.Control("F") + 0.5)


@functools.cache
def lag() -> tx.Dynamics:
    """x' = F - x."""
    x, F = tx.State("x"), tx.Control("F")
    return tx.compile(tx.System(rates={x: F - x}))


def solve(u: object, t1: float = 3.0, t0: float = 0.0, tableau: object = TSIT5, **options: object) -> tx.Solution:
    settings = {"rtol": TOL, "atol": TOL, "u": u, "method": tx.RKMK(tableau)} | options
    return tx.integrate(lag(), {"x": 1.0}, t0=t0, t1=t1, **settings)


def held_exact(ts: np.ndarray, values: np.ndarray, t: float, t0: float = 0.0) -> float:
    """x at t from x(t0) = 1: piece by piece."""
    x, now = 1.0, t0
    for k, value in enumerate(values):
        end = t if k + 1 == len(ts) else min(ts[k + 1], t)
        if end > now:
            x, now = value + (x - value) * np.exp(-(end - now)), end
    return x


def linear_exact(ts: np.ndarray, values: np.ndarray, t: float) -> float:
    """x at t from x(0) = 1 for a piecewise linear control that is held beyond its ends, ts[0] <= 0."""
    x, now = 1.0, 0.0
    for k in range(len(ts)):
        end = t if k + 1 == len(ts) else min(ts[k + 1], t)
        if end <= now:
            continue
        slope = 0.0 if k + 1 == len(ts) else (values[k + 1] - values[k]) / (ts[k + 1] - ts[k])
        level = values[k] + slope * (now - ts[k])
        # x = level + slope (s - 1) + c exp(-s), s the time since now.
        x = level + slope * (end - now - 1.0) + (x - level + slope) * np.exp(-(end - now))
        now = end
    return x


TS, VALUES = np.array([0.0, 0.313, 0.5, 1.7]), np.array([1.0, -2.0, 30.0, 0.5])


@pytest.mark.parametrize("jumps", [[], [0.3, 0.5]], ids=["none", "two"])
def test_a_jump_costs_one_evaluation(jumps: list[float]) -> None:
    """A step hands its last rate on to the next one, but not across a jump; the first one and its size take two."""
    stats = solve({"F": 0.3}, jumps=jumps).stats
    assert stats.rhs_evaluations == 6 * stats.steps + 2 + len(jumps)


#: What a step hands on to the next one is the same for the other pairs.
OTHERS = [pytest.param(tableau, marks=pytest.mark.slow) for tableau in (BOGACKI_SHAMPINE3, DORMAND_PRINCE5)]


@pytest.mark.parametrize("tableau", [*OTHERS, TSIT5, DOP853], ids=lambda t: t.name)
def test_a_held_table_is_integrated_to_tolerance_without_a_search(tableau: object) -> None:
    """The rate after a jump is not the one carried on from the step before it: that would cost a search or digits."""
    tol = 1e-6 if tableau is BOGACKI_SHAMPINE3 else TOL
    sol = solve({"F": tx.ZeroOrderHold(TS, VALUES)}, tableau=tableau, rtol=tol, atol=tol)
    assert float(sol.xs["x"][0]) == pytest.approx(held_exact(TS, VALUES, 3.0), abs=20 * tol)
    assert sol.stats.rejected <= 2 * (TS.size - 1)
    smooth = solve({"F": 30.0}, tableau=tableau, rtol=tol, atol=tol)
    assert sol.stats.accepted < TS.size * smooth.stats.accepted


def test_a_linear_table_is_integrated_to_tolerance() -> None:
    sol = solve({"F": tx.FirstOrderHold([*TS, 3.0], [*VALUES, VALUES[-1]])})
    assert float(sol.xs["x"][0]) == pytest.approx(linear_exact(TS, VALUES, 3.0), abs=20 * TOL)
    assert sol.stats.rejected <= 2 * TS.size


def test_jumps_that_do_not_matter_change_nothing() -> None:
    """Outside of the solution, at its ends, or twice."""
    wide = np.array([-5.0, -1.0, 0.0, 0.313, 0.5, 1.7, 3.0, 9.0])
    values = np.array([7.0, 7.0, 1.0, -2.0, 30.0, 0.5, 99.0, 77.0])
    sol = solve({"F": tx.ZeroOrderHold(wide, values)})
    assert float(sol.xs["x"][0]) == pytest.approx(held_exact(TS, VALUES, 3.0), abs=20 * TOL)
    narrow = solve({"F": tx.ZeroOrderHold(TS, VALUES)})
    assert (sol.stats.accepted, sol.stats.rejected) == (narrow.stats.accepted, narrow.stats.rejected)
    again = solve({"F": tx.ZeroOrderHold(TS, VALUES)}, jumps=[-3.0, 0.0, 0.5, 0.5, 1.7, 3.0, 8.0])
    assert (again.stats.accepted, again.stats.rejected) == (narrow.stats.accepted, narrow.stats.rejected)
    np.testing.assert_allclose(again.xs["x"], narrow.xs["x"], rtol=1e-13)


def test_a_solution_that_starts_at_a_jump_sees_what_comes_after() -> None:
    sol = solve({"F": tx.ZeroOrderHold(TS, VALUES)}, t0=0.5, t1=1.7)
    assert float(sol.xs["x"][0]) == pytest.approx(30.0 - 29.0 * np.exp(-1.2), abs=30 * TOL)
    assert sol.stats.rejected <= 2


def test_a_first_step_that_is_longer_than_the_first_row_reads_that_row() -> None:
    ts, values = np.array([0.0, 0.1]), np.array([1.0, 30.0])
    sol = solve({"F": tx.ZeroOrderHold(ts, values)}, dt=1.0)
    assert float(sol.xs["x"][0]) == pytest.approx(held_exact(ts, values, 3.0), abs=50 * TOL)
    assert sol.stats.rejected <= 4


@pytest.mark.parametrize("dt", [None, 2.0])
def test_an_event_of_a_table_begins_in_its_first_row(dt: float | None) -> None:
    """However long the first step is to be: a later row is on the other side."""
    sol = solve({"F": tx.FirstOrderHold([0.0, 0.1, 2.0, 3.0], [0.0, -1.0, -4.0, 3.0])}, dt=dt, event=HALF_BELOW)
    assert float(sol.ts[-1]) == pytest.approx(0.05, abs=1e-14)


def test_a_traced_table_that_begins_later_has_no_value_before() -> None:
    """Steps may be so long that their middles lie in its first row."""

    def end(ts: jax.Array) -> jax.Array:
        table = tx.ZeroOrderHold(ts, jnp.array([1.0, 2.0]))
        return solve({"F": table}, t1=1.0, dt=0.3, tableau=DOP853, rtol=1e-3, atol=1e-3).xs["x"][0]

    ends = jax.jit(jax.vmap(end))(jnp.array([[0.1, 0.9], [0.0, 0.9]]))
    assert np.isnan(ends[0])
    assert float(ends[1]) == pytest.approx(2.0 - np.exp(-0.1), abs=1e-6)


def test_tables_with_different_times_are_all_met() -> None:
    x, F, G = tx.State("x"), tx.Control("F"), tx.Control("G")
    dynamics = tx.compile(tx.System(rates={x: F + G - x}))
    other, more = np.array([0.0, 0.313, 2.1]), np.array([4.0, -4.0, 8.0])
    sol = tx.integrate(
        dynamics,
        {"x": 1.0},
        t1=3.0,
        rtol=TOL,
        atol=TOL,
        u={"F": tx.ZeroOrderHold(TS, VALUES), "G": tx.ZeroOrderHold(other, more)},
    )
    joined = np.array([0.0, 0.313, 0.5, 1.7, 2.1])
    exact = held_exact(joined, np.array([1.0 + 4.0, -2.0 - 4.0, 30.0 - 4.0, 0.5 - 4.0, 0.5 + 8.0]), 3.0)
    assert float(sol.xs["x"][0]) == pytest.approx(exact, abs=20 * TOL)
    assert sol.stats.rejected <= 8


@pytest.mark.parametrize(
    ("tableau", "side"),
    [
        pytest.param(tableau, side, id=f"{tableau.name}, {side}", marks=[pytest.mark.slow] if left_out else [])
        for tableau, side, left_out in (
            (DORMAND_PRINCE5, "before", False),
            (DORMAND_PRINCE5, "after", True),
            (DOP853, "before", True),
            (DOP853, "after", False),
        )
    ],
)
def test_a_function_of_time_that_jumps_is_integrated_cheaply_where_it_is_told(tableau: object, side: str) -> None:
    """Whichever value the function has at the very moment of the jump."""

    def u(t: jax.Array) -> dict[str, jax.Array]:
        late = t >= 0.7 if side == "after" else t > 0.7
        return {"F": jnp.where(late, -2.0, 1.0) + jnp.sin(t)}

    blind, told = solve(u, tableau=tableau), solve(u, tableau=tableau, jumps=[0.7])
    part = (np.exp(-3.0) - np.cos(3.0) + np.sin(3.0)) / 2.0
    exact = held_exact(np.array([0.0, 0.7]), np.array([1.0, -2.0]), 3.0) + part
    assert float(told.xs["x"][0]) == pytest.approx(exact, abs=20 * TOL)
    assert float(blind.xs["x"][0]) == pytest.approx(exact, abs=200 * TOL)
    assert blind.stats.rejected > 10
    assert told.stats.rejected <= 3
    assert told.stats.accepted < blind.stats.accepted


@pytest.mark.parametrize("tableau", [TSIT5, pytest.param(DOP853, marks=pytest.mark.slow)], ids=lambda t: t.name)
def test_a_system_that_jumps_is_integrated_cheaply_where_it_is_told(tableau: object) -> None:
    x, t = tx.State("x"), tx.Time()
    dynamics = tx.compile(tx.System(rates={x: tx.Where(t >= 0.7, -2.0, 1.0) - x}))
    settings = {"t1": 3.0, "rtol": TOL, "atol": TOL, "method": tx.RKMK(tableau)}
    blind = tx.integrate(dynamics, {"x": 1.0}, **settings)
    told = tx.integrate(dynamics, {"x": 1.0}, jumps=np.array([0.7]), **settings)
    exact = held_exact(np.array([0.0, 0.7]), np.array([1.0, -2.0]), 3.0)
    assert float(told.xs["x"][0]) == pytest.approx(exact, abs=20 * TOL)
    assert blind.stats.rejected > 10
    assert told.stats.rejected <= 3


def test_times_saved_at_and_around_jumps() -> None:
    ts = np.array([0.0, 0.3, 0.313, 0.313, 0.32, 0.5, 0.5 + 1e-9, 1.7, 2.9, 3.0])
    sol = solve({"F": tx.ZeroOrderHold(TS, VALUES)}, save_at=ts)
    exact = [held_exact(TS, VALUES, t) for t in ts]
    np.testing.assert_allclose(sol.xs["x"], exact, rtol=0.0, atol=20 * TOL)
    alone = solve({"F": tx.ZeroOrderHold(TS, VALUES)})
    assert sol.stats.accepted == alone.stats.accepted


@pytest.mark.parametrize("offset", [0.0, 500.0])
def test_a_pulse_far_shorter_than_the_steps_around_it(offset: float) -> None:
    """Of a thousandth of a second after long steps: it is neither jumped over nor a cause of trouble."""
    x, F = tx.State("x"), tx.Control("F")
    dynamics = tx.compile(tx.System(rates={x: F - 1e-6 * x}))
    ts = offset + np.array([0.0, 100.0, 100.001])
    sol = tx.integrate(
        dynamics,
        {"x": 0.0},
        t0=offset,
        t1=offset + 200.0,
        rtol=1e-9,
        atol=1e-9,
        u={"F": tx.ZeroOrderHold(ts, np.array([0.0, 1e3, 0.0]))},
        method=tx.RKMK(TSIT5),
    )
    np.testing.assert_allclose(sol.xs["x"], [np.exp(-1e-6 * 99.999)], rtol=1e-7)
    assert sol.stats.rejected < 20


def test_jumps_are_inputs_and_one_solution_serves_a_batch_of_them() -> None:
    def end(first: jax.Array) -> tx.Solution:
        ts = jnp.stack([jnp.zeros(()), first, jnp.asarray(2.0)])
        return solve({"F": tx.ZeroOrderHold(ts, jnp.array([1.0, -2.0, 4.0]))})

    firsts = np.array([0.1, 0.55, 1.9])
    lanes = jax.vmap(end)(firsts)
    exact = [held_exact(np.array([0.0, first, 2.0]), np.array([1.0, -2.0, 4.0]), 3.0) for first in firsts]
    np.testing.assert_allclose(np.asarray(lanes.xs["x"])[:, 0], exact, rtol=0.0, atol=20 * TOL)


def test_single_precision_steps_end_at_jumps_too() -> None:
    ts, values = TS.astype(np.float32), VALUES.astype(np.float32)
    sol = tx.integrate(
        lag(), {"x": np.float32(1.0)}, t1=3.0, rtol=1e-5, atol=1e-5, u={"F": tx.ZeroOrderHold(ts, values)}
    )
    assert sol.xs["x"].dtype == jnp.float32
    np.testing.assert_allclose(sol.xs["x"], held_exact(TS, VALUES, 3.0), atol=3e-4)
    assert sol.stats.rejected <= 6
