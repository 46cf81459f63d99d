"""Controls in every form: held, tables, functions of time; and what is said about wrong ones."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.tableaus import HEUN

TIMES = np.array([0.0, 0.5, 1.0, 1.5])
ROWS = np.array([[1.0, 0.0], [-2.0, 1.0], [0.5, 0.5], [3.0, -1.0]])
HOLDS, TOLERANCES = (tx.ZeroOrderHold, tx.FirstOrderHold), {"rtol": 1e-6, "atol": 1e-6}


@functools.cache
def integrator() -> tx.Dynamics:
    """x' = F: the solution is the integral of the control, exact for every method where F is piecewise linear."""
    x, F = tx.State("x", shape=(2,)), tx.Control("F", shape=(2,))
    return tx.compile(tx.System(rates={x: F}))


def end(dynamics: tx.Dynamics, u: object, t1: float = 2.0, dt: float = 0.1, **rest: object) -> np.ndarray:
    return np.asarray(tx.integrate(dynamics, {"x": np.zeros(2)}, t1=t1, dt=dt, u=u, **rest).xs["x"][-1])


def test_an_array_is_held() -> None:
    np.testing.assert_allclose(end(integrator(), {"F": [1.0, -2.0]}), [2.0, -4.0], rtol=1e-14)


@pytest.mark.parametrize("dt", [0.5, 0.1, 0.1 / 3])
def test_a_held_table_is_exact_on_steps_that_end_at_its_jumps(dt: float) -> None:
    expected = 0.5 * ROWS.sum(axis=0)
    np.testing.assert_allclose(end(integrator(), {"F": tx.ZeroOrderHold(TIMES, ROWS)}, dt=dt), expected, rtol=1e-12)


def test_a_held_table_holds_in_single_precision_and_far_from_zero() -> None:
    table = tx.ZeroOrderHold(TIMES + 1000.0, ROWS)
    start = {"x": np.zeros(2, np.float32)}
    sol = tx.integrate(integrator(), start, t0=1000.0, t1=1002.0, dt=0.5, u={"F": table})
    assert sol.xs["x"].dtype == jnp.float32
    np.testing.assert_array_equal(sol.xs["x"][0], 0.5 * ROWS.sum(axis=0))
    # In double precision with steps that are no binary fractions.
    sol = tx.integrate(integrator(), {"x": np.zeros(2)}, t0=1000.0, t1=1002.0, dt=0.1, u={"F": table})
    np.testing.assert_allclose(sol.xs["x"][0], 0.5 * ROWS.sum(axis=0), rtol=1e-11)


def test_the_last_row_of_a_held_table_holds_on() -> None:
    table = tx.ZeroOrderHold([0.0], [[1.0, 2.0]])
    np.testing.assert_allclose(end(integrator(), {"F": table}, t1=1.0), [1.0, 2.0], rtol=1e-14)


@pytest.mark.parametrize("adaptive", [{"dt": 0.25}, {"rtol": 1e-6, "atol": 1e-6}])
@pytest.mark.parametrize(
    ("form", "ts"),
    [(tx.ZeroOrderHold, [0.5, 1.0]), (tx.FirstOrderHold, [0.5, 2.0]), (tx.FirstOrderHold, [0.0, 0.5])],
)
def test_a_table_has_no_value_where_it_does_not_reach(form: type, ts: list[float], adaptive: dict[str, float]) -> None:
    """Known times are refused before a step is taken; of traced ones the result says so, and the end is NaN."""
    with pytest.raises(
        tx.InputError, match=r"u\['F'\] (begins|ends) at 0.5, but the integration (begins|ends) at t[01] = "
    ):
        tx.integrate(integrator(), {"x": np.zeros(2)}, t1=1.0, u={"F": form(ts, ROWS[:2])}, **adaptive)

    @jax.jit
    def traced(ts: jax.Array) -> tx.Solution:
        steps = {"steps": 4} if "dt" in adaptive else adaptive
        return tx.integrate(integrator(), {"x": jnp.zeros(2)}, t1=1.0, u={"F": form(ts, ROWS[:2])}, **steps)

    sol = traced(jnp.asarray(ts))
    assert sol.result == tx.Result.NON_FINITE
    assert traced(jnp.asarray([0.0, 1.0])).result == tx.Result.SUCCESS


@pytest.mark.parametrize(
    ("form", "inside", "adaptive"),
    [
        *((form, inside, {"steps": 4}) for form in HOLDS for inside in (False, True)),
        *((form, inside, TOLERANCES) for form, inside in zip(HOLDS, (False, True), strict=True)),
        # Each form, each place and each kind of steps has met the two others above.
        *(
            pytest.param(form, inside, TOLERANCES, marks=pytest.mark.slow)
            for form, inside in zip(HOLDS, (True, False), strict=True)
        ),
    ],
)
def test_a_table_whose_times_are_known_in_a_traced_integration(
    form: type, inside: bool, adaptive: dict[str, float]
) -> None:
    """A table made before jit, vmap or grad, or in the traced function, covers the span or is refused."""
    dynamics, times, rows = integrator(), [0.0, 0.5, 1.0], ROWS[:3]
    held = {times[-1]: form(times, rows), 0.5: form(times[:2], rows[:2])}

    def at(start: jax.Array, last: float = 1.0, first: float = 0.0) -> jax.Array:
        known = form([time for time in times if time <= last], rows[: 3 if last == 1.0 else 2])
        u = {"F": known if inside else held[last]}
        return tx.integrate(dynamics, {"x": start}, t0=first, t1=1.0, u=u, **adaptive).xs["x"][-1]

    start = np.array([0.3, -0.2])
    weights = [0.5, 0.5, 0.0] if form is tx.ZeroOrderHold else [0.25, 0.5, 0.25]
    expected = start + weights @ rows
    both = jax.value_and_grad(lambda x: at(x).sum())
    found, slope = jax.jit(both)(start)
    np.testing.assert_allclose(found, expected.sum(), rtol=1e-13)
    np.testing.assert_allclose(slope, np.ones(2), rtol=1e-14)
    if "steps" in adaptive:  # what takes long to compile, of equal steps alone
        np.testing.assert_allclose(jax.jit(at)(start), expected, rtol=1e-13)
        found, slope = jax.jit(jax.vmap(both))(np.stack([start, start + 1.0]))
        np.testing.assert_allclose(found, expected.sum() + np.array([0.0, 2.0]), rtol=1e-13)
        np.testing.assert_allclose(slope, np.ones((2, 2)), rtol=1e-14)
        np.testing.assert_allclose(both(start)[1], np.ones(2), rtol=1e-14)
    if form is tx.FirstOrderHold:
        with pytest.raises(tx.InputError, match=r"u\['F'\] ends at 0.5, but the integration ends at t1 = 1"):
            jax.jit(lambda x: at(x, 0.5))(start)
    with pytest.raises(tx.InputError, match=r"u\['F'\] begins at 0, but the integration begins at t0 = -1"):
        jax.jit(lambda x: at(x, first=-1.0))(start)


def test_a_linear_table_is_the_trapezoidal_rule() -> None:
    expected = 0.5 * (0.5 * ROWS[0] + ROWS[1] + ROWS[2] + 0.5 * ROWS[3]) + 0.5 * ROWS[3]
    table = tx.FirstOrderHold([*TIMES, 2.0], [*ROWS, ROWS[-1]])
    np.testing.assert_allclose(end(integrator(), {"F": table}), expected, atol=1e-13)


def test_a_function_is_called_at_stage_times() -> None:
    """RK4 is Simpson's rule here, exact for cubics; Heun is the trapezoidal rule."""

    def u(t: jax.Array) -> dict[str, jax.Array]:
        return {"F": jnp.stack([t**3, 1.0 - t])}

    np.testing.assert_allclose(end(integrator(), u), [4.0, 0.0], atol=1e-13)
    crude = end(integrator(), u, dt=1.0, method=tx.RKMK(HEUN))
    np.testing.assert_allclose(crude, [5.0, 0.0], rtol=1e-14)


def test_forms_agree_where_they_mean_the_same() -> None:
    dynamics, F = integrator(), np.array([0.3, -0.7])
    forms = [
        {"F": F},
        {"F": tx.ZeroOrderHold([0.0], F[None])},
        {"F": tx.FirstOrderHold([0.0, 2.0], np.stack([F, F]))},
        lambda t: {"F": F},
    ]
    ends = [end(dynamics, u) for u in forms]
    np.testing.assert_allclose(np.stack(ends[1:]), np.broadcast_to(ends[0], (3, 2)), rtol=1e-14)


def test_a_partial_traces_its_arrays() -> None:
    """Arrays bound by jax.tree_util.Partial are inputs: derivatives pass, and new ones do not compile again."""

    def u(gain: jax.Array, t: jax.Array) -> dict[str, jax.Array]:
        return {"F": gain * t}

    dynamics = integrator()

    def solve(gain: jax.Array) -> jax.Array:
        start = {"x": np.zeros(2)}
        return tx.integrate(dynamics, start, t1=2.0, dt=0.5, u=jax.tree_util.Partial(u, gain)).xs["x"][-1]

    np.testing.assert_allclose(solve(jnp.array([1.0, 3.0])), [2.0, 6.0], rtol=1e-14)
    np.testing.assert_allclose(jax.jacrev(solve)(jnp.array([1.0, 3.0])), 2.0 * np.eye(2), rtol=1e-14)


def test_derivatives_pass_through_a_function_that_closes_over_what_is_traced() -> None:
    dynamics = integrator()
    solve = functools.partial(tx.integrate, dynamics, {"x": np.zeros(2)}, t1=2.0, dt=0.5)
    slope = jax.grad(lambda gain: solve(u=lambda t: {"F": gain * t * jnp.ones(2)}).xs["x"].sum())(1.5)
    np.testing.assert_allclose(slope, 4.0, rtol=1e-14)


def test_derivatives_with_respect_to_a_table() -> None:
    dynamics = integrator()

    def solve(rows: jax.Array, form: type[tx.ZeroOrderHold] | type[tx.FirstOrderHold]) -> jax.Array:
        return tx.integrate(dynamics, {"x": np.zeros(2)}, t1=1.5, dt=0.25, u={"F": form(TIMES, rows)}).xs["x"][0, 0]

    np.testing.assert_allclose(
        jax.grad(solve)(jnp.asarray(ROWS), tx.ZeroOrderHold)[:, 0], [0.5, 0.5, 0.5, 0.0], atol=1e-13
    )
    np.testing.assert_allclose(
        jax.grad(solve)(jnp.asarray(ROWS), tx.FirstOrderHold)[:, 0], [0.25, 0.5, 0.5, 0.25], atol=1e-13
    )


def test_wrong_tables_inside_jit_are_named() -> None:
    with pytest.raises(tx.InputError, match="expects increasing ts"):
        jax.jit(lambda start: start + tx.ZeroOrderHold([0.0, 0.0], ROWS[:2]).values.sum())(0.0)


@pytest.mark.parametrize("ts", [[0, 1], [False, True], jnp.arange(2)])
def test_whole_numbers_are_times(ts: object) -> None:
    np.testing.assert_allclose(end(integrator(), {"F": tx.FirstOrderHold(ts, [[0, 0], [1, 2]])}, 1.0), [0.5, 1.0])


@pytest.mark.parametrize("width", [1e-6, 1e-9, 1e-12])
def test_a_row_shorter_than_round_off_of_its_neighbours_counts(width: float) -> None:
    """A kick of area 1: all of it arrives, and nothing has to be found out by steps that fail."""
    x, F = tx.State("x"), tx.Control("F")
    moved = tx.compile(tx.System(rates={x: F}))
    ts = np.array([0.0, 0.7, 0.7 + width])
    kick = {"F": tx.ZeroOrderHold(ts=ts, values=[2.0, 1.0 / (ts[2] - ts[1]), -3.0])}
    sol = tx.integrate(moved, {"x": 0.0}, t1=2.0, u=kick, rtol=1e-9)
    assert float(sol.xs["x"][-1]) == pytest.approx(1.4 + 1.0 - 3.0 * (2.0 - ts[2]), abs=1e-12)
    assert sol.stats.rejected == 0
