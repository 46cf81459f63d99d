"""Controls that are linear between nodes: exact answers, limits of their rates, replay by the integrators."""

from typing import Any

import numpy as np
import pytest
from trajectory_systems import double_integrator, regulator_error

import twistax as tx
from twistax.trajectory import Held, Linear, Problem, Rate

ENDS: dict[str, Any] = {"initial": {"p": 0.0, "v": 0.0}, "final": {"p": 1.0, "v": 0.0}}


def test_least_energy_of_a_double_integrator_is_exact_on_three_nodes() -> None:
    """u = 6 / T^2 (1 - 2 t / T) is linear, and costs 12 / T^3."""
    dynamics = tx.compile(double_integrator())
    u = dynamics.controls[0]
    problem = Problem(
        dynamics, tx.Minimize(running=u**2), nodes=[0.0, 0.3, 1.0], final_time=2.0, controls=Linear(), **ENDS
    )
    result = problem.solve(tolerance=1e-8)
    assert result.solved
    assert result.cost == pytest.approx(1.5, rel=1e-8)
    np.testing.assert_allclose(result.us["u"], [1.5, 0.6, -1.5], atol=1e-6)
    assert set(result.xs) == {"p", "v"} == set(result.mesh_error)
    assert result.explain()
    # The system as stated, with the controls that were found, goes where the result says.
    x0 = {"p": np.float64(0.0), "v": np.float64(0.0)}
    own = tx.integrate(dynamics, x0, t1=2.0, dt=0.1, u=result.controls, save_at=result.ts)
    np.testing.assert_allclose(own.xs["p"], result.xs["p"], atol=1e-7)
    replay = result.replay(steps=2)
    np.testing.assert_allclose(replay.us["u"], [1.5, 1.05, 0.6, -0.45, -1.5], atol=1e-6)
    # Fixed values of controls; a warm start; a guess at every node.
    fixed = Problem(
        dynamics,
        tx.Minimize(running=u**2 + 1e-3 * Rate(u) ** 2),
        nodes=6,
        final_time=2.0,
        controls={u: Linear(rate=4.0)},
        initial={"p": 0.0, "v": 0.0, u: 0.0},
        final=[{"p": 1.0, "v": 0.0}, u == -0.5],
        guess={"u": np.linspace(1.0, -1.0, 6)},
    )
    found = fixed.solve()
    assert found.solved
    assert found.us["u"][0] == 0.0
    assert found.us["u"][-1] == pytest.approx(-0.5, abs=1e-6)
    assert np.abs(np.diff(found.us["u"])).max() / 0.4 <= 4.0 + 1e-6
    assert fixed.solve(warm=found).cost == pytest.approx(found.cost, rel=1e-6)
    assert found.shifted().point.us[-1] == 0.0


@pytest.mark.parametrize(("controls", "order"), [pytest.param(Held(), 2.0, marks=pytest.mark.slow), (Linear(), 4.0)])
def test_the_order_in_the_mesh(controls: Any, order: float) -> None:
    """Held controls miss the optimum by the second power of the intervals, linear ones by the fourth."""
    far, near = (regulator_error(nodes, controls, 1e-10, substeps=4) for nodes in (5, 9))
    assert far > near > 0.0
    assert np.log2(far / near) == pytest.approx(order, abs=0.25)


def test_limits_hold_at_both_ends_and_norms_are_cones() -> None:
    """Least fuel of a push in the plane with limits of its size and of its rate, and a gain that is held."""
    p, v = tx.State("p", shape=(2,)), tx.State("v", shape=(2,))
    u, gain = tx.Control("u", shape=(2,), min=[-1.0, -2.0], max=1.0), tx.Control("gain", min=0.0, max=2.0)
    system = tx.System(
        rates={p: v, v: gain * u},
        constraints={"size": tx.linalg.Norm(u) <= 1.0, "slew": tx.linalg.Dot(Rate(u), Rate(u)) <= 4.0},
    )
    problem = Problem(
        tx.compile(system),
        tx.Minimize(running=tx.linalg.Norm(u) + 0.1 * gain**2),
        nodes=9,
        final_time=3.0,
        initial={p: np.zeros(2), v: np.zeros(2)},
        final={p: [0.8, 0.3], v: np.zeros(2)},
        controls={"u": Linear()},
    )
    result = problem.solve()
    assert result.solved
    assert set(result.us) == {"u", "gain"}
    assert result.us["u"].shape == (9, 2)
    assert result.us["gain"].shape == (8,)
    assert np.linalg.norm(result.us["u"], axis=1).max() <= 1.0 + 1e-6
    slew = np.linalg.norm(np.diff(result.us["u"], axis=0), axis=1) / np.diff(result.ts)
    assert slew.max() == pytest.approx(2.0, abs=1e-4)
    assert max(result.between_nodes.values()) < 1e-6
    # The bound on the norm is linear, too, and stands on it at the nodes.
    sizes = np.linalg.norm(result.us["u"], axis=1)
    fuel = 0.5 * (sizes[1:] + sizes[:-1]) @ np.diff(result.ts)
    assert result.cost == pytest.approx(fuel + 0.1 * result.us["gain"] ** 2 @ np.diff(result.ts), rel=1e-5)


def test_what_is_no_way_of_a_control() -> None:
    dynamics = tx.compile(double_integrator())
    u = dynamics.controls[0]

    def problem(controls: Any, running: Any = u**2) -> Problem:
        return Problem(dynamics, tx.Minimize(running=running), final_time=2.0, controls=controls, **ENDS)

    with pytest.raises(tx.ModelError, match="controls names 'w'; the controls are: 'u'"):
        problem({"w": Linear()})
    with pytest.raises(tx.ModelError, match=r"tx.trajectory.Held\(\), Linear\(\) or Spline"):
        problem("linear")
    with pytest.raises(tx.ModelError, match="reads the rate of u, but the control is piecewise constant"):
        problem(Held(), running=Rate(u) ** 2)
    with pytest.raises(tx.ModelError, match="positive"):
        Linear(rate=0.0)
    with pytest.raises(tx.ShapeError, match="rate of 'u' expects shape"):
        problem(Linear(rate=[1.0, 2.0]))
    with pytest.raises(tx.ModelError, match="Rate expects a control"):
        Rate("u")
    p, v = dynamics.states
    slew = tx.compile(tx.System(rates={p: v, v: u}, constraints={"slew": Rate(u) <= 1.0}))
    with pytest.raises(tx.ModelError, match="reads the rate of u, but the control is piecewise constant"):
        Problem(slew, tx.Minimize(running=u**2), final_time=2.0, **ENDS)
