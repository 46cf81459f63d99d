"""The length of steps: the first one, the formula of the controller, its bounds, and solutions that end early."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.tableaus import BOGACKI_SHAMPINE3, TSIT5

METHOD = tx.RKMK(TSIT5)


@functools.cache
def chase() -> tx.Dynamics:
    """x' = k (cos(k t) - x): the same motion at any speed k."""
    x, k, t = tx.State("x"), tx.Parameter("k", value=1.0), tx.Time()
    return tx.compile(tx.System(rates={x: k * (tx.Cos(k * t) - x)}))


def chase_exact(s: float) -> float:
    """x at k t = s, from x = 2."""
    return 0.5 * (np.cos(s) + np.sin(s)) + 1.5 * np.exp(-s)


@functools.cache
def stiff() -> tx.Dynamics:
    """x' = k (cos t - x): the faster, the stiffer."""
    x, k, t = tx.State("x"), tx.Parameter("k", value=1.0), tx.Time()
    return tx.compile(tx.System(rates={x: k * (tx.Cos(t) - x)}))


# ---- the first step --------------------------------------------------------------------------------------------------


def test_no_unit_of_time_is_preferred() -> None:
    """The same motion a million times slower or faster takes about as many steps."""
    accepted = []
    for power in (-20, -10, 0, 10, 20):
        k = 2.0**power
        sol = tx.integrate(chase(), {"x": 2.0}, t1=10.0 / k, rtol=1e-6, atol=1e-6, params={"k": k}, method=METHOD)
        assert float(sol.xs["x"][0]) == pytest.approx(chase_exact(10.0), abs=1e-5)
        assert sol.stats.rejected <= 5
        accepted.append(sol.stats.accepted)
    assert max(accepted) < 1.5 * min(accepted)


@pytest.mark.parametrize("rtol", [1e-4, 1e-9])
def test_the_first_step_is_sensible_over_twelve_decades(rtol: float) -> None:
    """Neither far too long, which the error of the first try shows, nor far too short."""
    for k in 10.0 ** np.arange(-6.0, 7.0, 2.0):
        settings = {"t1": min(5.0, 30.0 / k), "rtol": rtol, "atol": rtol, "params": {"k": k}, "method": METHOD}
        one = tx.integrate(stiff(), {"x": 2.0}, control=tx.StepControl(max_steps=1), throw=False, **settings)
        sol = tx.integrate(stiff(), {"x": 2.0}, **settings)
        assert sol.stats.rejected <= 3
        assert sol.stats.accepted < 600
        if one.stats.accepted:
            assert 1e-3 * settings["t1"] / sol.stats.accepted < float(one.ts[0])


@pytest.mark.parametrize("start", [0.0, 1.0, 1e9])
def test_a_rate_that_is_zero_at_the_start_is_no_trouble(start: float) -> None:
    """x' = 0 for a moment, then an oscillation; from x = 0 too. The truth: 1 - cos t."""
    sol = tx.integrate(ramp(), {"x": start}, t1=3.0, rtol=1e-8, atol=1e-8, params={"n": 1.0}, method=METHOD)
    assert sol.stats.rejected <= 3
    assert sol.stats.accepted < 60
    assert float(sol.xs["x"][0]) - start == pytest.approx(1.0 - np.cos(3.0), abs=1e-7 * max(1.0, start))


@functools.cache
def ramp() -> tx.Dynamics:
    x, n, t = tx.State("x"), tx.Parameter("n", value=1.0), tx.Time()
    return tx.compile(tx.System(rates={x: n * tx.Sin(t)}))


def test_a_system_at_rest_stays_and_is_done_soon() -> None:
    sol = tx.integrate(ramp(), {"x": 0.0}, t1=1e6, rtol=1e-8, params={"n": 0.0}, method=METHOD)
    assert float(sol.xs["x"][0]) == 0.0
    assert sol.stats.accepted < 20


def test_dt_is_the_first_step() -> None:
    once = tx.StepControl(max_steps=1)
    for dt in (1e-5, 1e-3):
        sol = tx.integrate(chase(), {"x": 2.0}, t1=1.0, dt=dt, rtol=1e-4, control=once, throw=False, method=METHOD)
        assert float(sol.ts[0]) == dt
    too_long = tx.integrate(chase(), {"x": 2.0}, t1=50.0, dt=25.0, rtol=1e-4, control=once, throw=False, method=METHOD)
    assert (too_long.stats.accepted, too_long.stats.rejected, float(too_long.ts[0])) == (0, 1, 0.0)


# ---- the formula -----------------------------------------------------------------------------------------------------


def wave(t: float) -> float:
    return np.exp(2.0 * np.sin(3.0 * t)) * np.cos(t * t)


@functools.cache
def quadrature() -> tx.Dynamics:
    x, t = tx.State("x"), tx.Time()
    return tx.compile(tx.System(rates={x: tx.Exp(2.0 * tx.Sin(3.0 * t)) * tx.Cos(t * t)}))


def by_hand(control: tx.StepControl, t1: float, tol: float, first: float) -> tuple[float, int, int]:
    """The solution of `quadrature` with its steps, in plain Python. Returns x, and steps taken and taken back."""
    b, b_low, c = BOGACKI_SHAMPINE3.b, BOGACKI_SHAMPINE3.b_embedded, BOGACKI_SHAMPINE3.c
    p, i, d, order = control.pcoeff, control.icoeff, control.dcoeff, 3
    t, x, h, past, before, accepted, rejected, last_bad = 0.0, 0.3, first, 1.0, 1.0, 0, 0, False
    while t < t1:
        planned = h if control.dtmax is None else min(h, control.dtmax)
        room = t1 - t
        # To the end where next to nothing would be left; else what is left in two equal halves.
        step = room if 1.01 * planned >= room else 0.5 * room if 2.0 * planned > room else planned
        k = np.array([wave(t + node * step) for node in c])
        end = x + step * float(b @ k)
        error = abs(step * float((b - b_low) @ k)) / (tol + tol * max(abs(x), abs(end)))
        if error <= 1.0:
            error = max(error, 1e-12)
            factor = control.safety * error ** (-(p + i + d) / order) * past ** ((p + 2 * d) / order)
            factor *= before ** (-d / order)
            factor = min(max(factor, control.factormin), 1.0 if last_bad else control.factormax)
            h = max(step * factor, planned if step < planned and not last_bad else 0.0)
            t, x, past, before = (t1 if step == room else t + step), end, error, past
            accepted, last_bad = accepted + 1, False
        else:
            h = step * max(control.safety * error ** (-1.0 / order), control.factormin)
            rejected, last_bad = rejected + 1, True
    return x, accepted, rejected


CONTROLS = {
    "default": tx.StepControl(),
    "plain": tx.StepControl(pcoeff=0.0, icoeff=1.0),
    "pid": tx.StepControl(pcoeff=0.3, icoeff=0.3, dcoeff=0.1),
    "bounded": tx.StepControl(factormin=0.5, factormax=1.2, safety=0.7, dtmax=0.2),
}


@pytest.mark.parametrize("name", CONTROLS)
def test_steps_follow_the_formula(name: str) -> None:
    """At loose tolerances the end tells the steps apart: its error is a thousand times what is compared here."""
    control, rejected = CONTROLS[name], 0
    for tol, first in ((1e-2, 0.05), (1e-3, 0.5), (1e-4, 1e-3)):
        sol = tx.integrate(
            quadrature(),
            {"x": 0.3},
            t1=4.0,
            dt=first,
            rtol=tol,
            atol=tol,
            control=control,
            method=tx.RKMK(BOGACKI_SHAMPINE3),
        )
        x, taken, back = by_hand(control, 4.0, tol, first)
        assert (sol.stats.accepted, sol.stats.rejected) == (taken, back)
        np.testing.assert_allclose(sol.xs["x"], x, rtol=1e-11)
        rejected += back
    assert rejected > 2


def test_no_step_is_longer_than_dtmax() -> None:
    sol = tx.integrate(ramp(), {"x": 0.0}, t1=1.0, rtol=1e-3, control=tx.StepControl(dtmax=0.05), method=METHOD)
    assert sol.stats.accepted >= 20
    free = tx.integrate(ramp(), {"x": 0.0}, t1=1.0, rtol=1e-3, method=METHOD)
    assert free.stats.accepted < 10


# ---- solutions that end early ---------------------------------------------------------------------------------------


@functools.cache
def blow_up() -> tx.Dynamics:
    """x' = x^2 reaches infinity at t = 1 from x = 1; y does not care."""
    x, y = tx.State("x"), tx.State("y")
    return tx.compile(tx.System(rates={y: -y, x: x * x}))


UP = {"x": 1.0, "y": 1.0}


def test_steps_that_run_out_are_named() -> None:
    settings = {"t1": 20.0, "rtol": 1e-6, "atol": 1e-6, "control": tx.StepControl(max_steps=10), "method": METHOD}
    with pytest.raises(tx.IntegrationError) as caught:
        tx.integrate(chase(), {"x": 2.0}, **settings)
    message = str(caught.value)
    good = tx.integrate(chase(), {"x": 2.0}, throw=False, **settings)
    assert message.startswith(
        f"the integration used all 10 steps at t = {float(good.ts[0]):.6g} s; state 'x' has the largest error."
    )
    assert "fix: looser tolerances, or more steps: control=tx.StepControl(max_steps=...)" in message
    assert good.result is tx.Result.MAX_STEPS
    assert str(good.result) == "MAX_STEPS: the integration reached max_steps before the end time"
    assert good.stats.steps == 10
    assert float(good.xs["x"][0]) == pytest.approx(chase_exact(float(good.ts[0])), abs=1e-5)


def test_the_number_of_steps_that_is_needed_is_enough() -> None:
    settings = {"t1": 5.0, "rtol": 1e-5, "atol": 1e-5, "method": METHOD}
    needed = tx.integrate(chase(), {"x": 2.0}, **settings).stats.steps
    enough = tx.integrate(chase(), {"x": 2.0}, control=tx.StepControl(max_steps=needed), **settings)
    assert enough.result is tx.Result.SUCCESS
    with pytest.raises(tx.IntegrationError, match="used all"):
        tx.integrate(chase(), {"x": 2.0}, control=tx.StepControl(max_steps=needed - 1), **settings)


def test_a_singularity_ends_a_solution_by_name() -> None:
    settings = {"t1": 2.0, "rtol": 1e-8, "atol": 1e-8, "save_at": [0.0, 0.5, 0.9, 1.5, 2.0], "method": METHOD}
    with pytest.raises(tx.IntegrationError) as caught:
        tx.integrate(blow_up(), UP, **settings)
    message = str(caught.value)
    assert "state 'x'" in message.splitlines()[0]
    assert "t = 1 s" in message.splitlines()[0]
    assert "likely cause: " in message
    assert "throw=False keeps the solution up to here" in message
    good = tx.integrate(blow_up(), UP, throw=False, **settings)
    assert good.result in (tx.Result.STEP_TOO_SMALL, tx.Result.NON_FINITE)
    np.testing.assert_array_equal(good.ts, [0.0, 0.5, 0.9])
    np.testing.assert_allclose(good.xs["x"], [1.0, 2.0, 10.0], rtol=1e-6)
    np.testing.assert_allclose(good.xs["y"], np.exp([-0.0, -0.5, -0.9]), rtol=1e-7)


def test_dtmin_ends_a_solution() -> None:
    settings = {"t1": 2.0, "rtol": 1e-8, "atol": 1e-8, "method": METHOD, "control": tx.StepControl(dtmin=1e-3)}
    with pytest.raises(tx.IntegrationError, match=r"^no step is small enough .* at t = 0.*; state 'x' has the largest"):
        tx.integrate(blow_up(), UP, **settings)
    good = tx.integrate(blow_up(), UP, throw=False, **settings)
    assert good.result is tx.Result.STEP_TOO_SMALL
    t = float(good.ts[0])
    assert 0.8 < t < 1.0
    np.testing.assert_allclose(good.xs["x"], 1.0 / (1.0 - t), rtol=1e-5)


def test_a_last_step_shorter_than_dtmin_is_fine() -> None:
    sol = tx.integrate(chase(), {"x": 2.0}, t1=1e-4, rtol=1e-6, control=tx.StepControl(dtmin=1e-3), method=METHOD)
    assert sol.result is tx.Result.SUCCESS
    assert float(sol.xs["x"][0]) == pytest.approx(chase_exact(1e-4), abs=1e-9)


def test_a_control_that_is_no_number_is_named() -> None:
    x, F = tx.State("x"), tx.Control("F")
    dynamics = tx.compile(tx.System(rates={x: F - x}))

    def u(t: jax.Array) -> dict[str, jax.Array]:
        return {"F": jnp.where(t > 0.75, jnp.nan, jnp.cos(t))}

    settings = {"t1": 2.0, "rtol": 1e-6, "u": u, "method": METHOD, "save_at": [0.25, 0.7, 0.8]}
    with pytest.raises(tx.IntegrationError, match=r"t = 0.75 s.\n  likely cause: control 'F' is not finite"):
        tx.integrate(dynamics, {"x": 1.0}, **settings)
    good = tx.integrate(dynamics, {"x": 1.0}, throw=False, **settings)
    assert good.result is tx.Result.NON_FINITE
    np.testing.assert_array_equal(good.ts, [0.25, 0.7])


def test_a_rate_that_is_no_number_at_the_start_is_named() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: tx.Sqrt(x)}))
    with pytest.raises(tx.IntegrationError, match=r"(?s)state 'x'.*t = 0 s.*rate of 'x' is not finite there"):
        tx.integrate(dynamics, {"x": -1.0}, t1=1.0, rtol=1e-6, method=METHOD)


def test_the_state_with_the_largest_error_is_named() -> None:
    """Of two oscillators the fast one is to blame."""
    a, b = tx.State("slow", shape=(2,)), tx.State("fast", shape=(2,))
    dynamics = tx.compile(tx.System(rates={a: tx.Concat(a[1], -a[0]), b: 50.0 * tx.Concat(b[1], -b[0])}))
    with pytest.raises(tx.IntegrationError, match="state 'fast' has the largest error"):
        tx.integrate(
            dynamics,
            {"slow": np.ones(2), "fast": np.ones(2)},
            t1=10.0,
            rtol=1e-8,
            control=tx.StepControl(max_steps=30),
            method=METHOD,
        )


def test_controllers_are_values() -> None:
    assert tx.StepControl() == tx.StepControl()
    assert hash(tx.StepControl(dtmax=1.0)) == hash(tx.StepControl(dtmax=1.0))
    with pytest.raises(dataclasses.FrozenInstanceError):
        tx.StepControl().safety = 0.5  # type: ignore[misc]
