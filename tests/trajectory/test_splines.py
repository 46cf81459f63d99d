"""Controls that are polynomials between nodes: exact answers, orders, derivatives in conditions, replay."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from trajectory_systems import double_integrator, regulator_error

import twistax as tx
from twistax.trajectory import Collocation, Linear, Problem, Rate, Spline

#: Exact for all polynomials here.
EXACT: dict[str, Any] = {"method": tx.RKMK(tx.tableaus.DOP853), "substeps": 1}


def jerky(degree: int, **options: Any) -> Problem:
    """From rest to rest in 2 s by p''' = u: u = 7.5 (1 - 3 t + 1.5 t^2) costs least, 720 / 2^5."""
    p, v, a, cost, u = tx.State("p"), tx.State("v"), tx.State("a"), tx.State("cost"), tx.Control("u")
    rest = {p: 0.0, v: 0.0, a: 0.0}
    dynamics = tx.compile(tx.System(rates={p: v, v: a, a: u, cost: u**2}))
    given: dict[str, Any] = {"nodes": [0.0, 0.4, 1.0], "final_time": 2.0, "initial": {**rest, cost: 0.0}}
    given |= {"final": {**rest, p: 1.0}, "controls": Spline(degree), **EXACT}
    return Problem(dynamics, tx.Minimize(cost), **{**given, **options})


def test_least_effort_that_is_a_parabola_is_exact_on_three_nodes() -> None:
    result = jerky(2).solve(tolerance=1e-8)
    assert result.solved
    assert result.cost == pytest.approx(22.5, rel=1e-8)
    np.testing.assert_allclose(result.us["u"], 7.5 - 22.5 * result.ts + 11.25 * result.ts**2, atol=1e-5)
    replay = result.replay(tx.RKMK(tx.tableaus.DOP853), steps=2)
    np.testing.assert_allclose(replay.us["u"], 7.5 - 22.5 * replay.ts + 11.25 * replay.ts**2, atol=1e-5)
    assert set(replay.misses) == {"p", "v", "a", "cost"} == set(result.xs)
    assert replay.misses["p"]["distance"] < 1e-9
    table = result.controls["u"]
    np.testing.assert_allclose(
        table.during(jnp.zeros(()), jnp.full((), 2.0))(jnp.full((), 1.1)), 7.5 - 22.5 * 1.1 + 11.25 * 1.1**2, atol=1e-4
    )


@pytest.mark.slow
def test_the_order_in_the_mesh() -> None:
    """A parabola misses by the sixth power of the intervals."""
    rule = Collocation(tx.tableaus.GAUSS_LEGENDRE6, substeps=4)
    far, near = (regulator_error(nodes, Spline(2), 1e-11, transcription=rule) for nodes in (4, 7))
    assert far > near > 0.0
    assert np.log2(far / near) == pytest.approx(6.0, abs=0.5)


@pytest.mark.slow
def test_rates_of_rates_and_finer_meshes() -> None:
    """A cubic whose rate is limited and begins at rest, refined: halves of intervals are the same cubic."""
    u = tx.Control("u")
    problem = jerky(
        3,
        controls={u: Spline(3, rate=16.0)},
        final=[{"p": 1.0, "v": 0.0, "a": 0.0}, Rate(Rate(u)) == 0.0],
        nodes=9,
    )
    result = problem.solve(refine=1e-4, between=1e-6)
    assert result.solved
    table = result.controls["u"]
    rates, times = np.asarray(table.values), np.asarray(table.ts)
    assert rates.shape[1:] == (4,)
    shares = np.linspace(0.0, 1.0, 50)[:, None] * np.diff(result.ts)
    dense = rates[:, 1] + shares * rates[:, 2] + 0.5 * shares**2 * rates[:, 3]
    assert np.abs(dense).max() < 16.0 + 1e-4
    assert np.abs(rates[:, 1]).max() == pytest.approx(16.0, abs=1e-3)
    ends = rates[-1, 2] + rates[-1, 3] * (result.ts[-1] - times[-1])
    assert ends == pytest.approx(0.0, abs=1e-4)
    assert 22.5 < result.cost < 30.0
    # Flown by the system as stated.
    x0 = {name: np.float64(0.0) for name in result.xs}
    own = tx.integrate(result.problem.phases[0].dynamics, x0, t1=2.0, dt=0.01, u=result.controls)
    np.testing.assert_allclose(own.xs["p"][-1], 1.0, atol=1e-4)


def test_what_is_no_spline() -> None:
    dynamics = tx.compile(double_integrator())
    u = dynamics.controls[0]

    def problem(controls: Any, running: Any = u**2) -> Problem:
        return Problem(dynamics, tx.Minimize(running=running), final_time=2.0, controls=controls, initial={"p": 0.0})

    with pytest.raises(tx.ModelError, match="Spline: degree"):
        Spline(1)
    with pytest.raises(tx.ModelError, match="Spline: rate expects positive"):
        Spline(2, rate=-1.0)
    with pytest.raises(tx.ShapeError, match="rate of 'u' expects shape"):
        problem(Spline(2, rate=[1.0, 2.0]))
    with pytest.raises(tx.ModelError, match="reads the rate of rate of u, but the control is piecewise constant"):
        problem(Linear(), running=Rate(Rate(u)) ** 2)
    p, v = dynamics.states
    bent = tx.compile(tx.System(rates={p: v, v: u}, constraints={"bent": Rate(Rate(u)) <= 1.0}))
    with pytest.raises(
        tx.ModelError, match=r"rate of rate of u, which a spline of degree 1 does not have.\n  fix: .*Spline\(2\)"
    ):
        Problem(bent, tx.Minimize(running=u**2), final_time=2.0, controls=Linear(), initial={"p": 0.0})
    assert problem({u: Spline(2)}, running=u**2 + Rate(u) ** 2 + 1e-3 * Rate(Rate(u)) ** 2).continuous.rates == {
        "rate of rate of u": 2
    }


@pytest.mark.parametrize("by_name", [False, True])
def test_bounds_of_norms_are_as_smooth_as_the_control(by_name: bool) -> None:
    """A double integrator goes 1 m in 2 s with an impulse of 1.4 at most: u is a straight line with a dead zone.

    With x = 1 - t, u = a (|x| - d) sign x beyond d: 3 / (2 + d) = 1.4, a (1 - d)^2 = 1.4, the cost 2 a^2 (1 - d)^3 / 3.
    """
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
    impulse, spline = tx.trajectory.Integral(tx.Abs(u)), tx.trajectory.Spline(2)
    problem = tx.trajectory.Problem(
        tx.compile(tx.System(rates={p: v, v: u})),
        tx.Minimize(running=u * u),
        nodes=7,
        final_time=2.0,
        initial={p: 0.0, v: 0.0},
        final=[{p: 1.0, v: 0.0}, impulse <= 1.4],
        controls={u: spline} if by_name else spline,
    )
    dead = 3.0 / 1.4 - 2.0
    exact = 2.0 * (1.4 / (1.0 - dead) ** 2) ** 2 * (1.0 - dead) ** 3 / 3.0
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(exact, rel=3e-3)  # with bounds that are linear in time .027 more
