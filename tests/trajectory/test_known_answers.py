"""Problems whose optimum is known."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trajectory_systems import EULER, HEUN, double_integrator, free_flyer, spinning_ball

import twistax as tx
from twistax.trajectory import Problem, Status


def least_norm(intervals: int, final_time: float) -> np.ndarray:
    """The held controls of least energy that move a double integrator by 1, rest to rest; exact linear algebra."""
    h = final_time / intervals
    ends = np.zeros((2, intervals))
    for k in range(intervals):
        left = final_time - (k + 1) * h
        ends[:, k] = [h * (left + h / 2), h]
    return ends.T @ np.linalg.solve(ends @ ends.T, [1.0, 0.0])


def test_least_energy_of_a_double_integrator() -> None:
    dynamics = tx.compile(double_integrator())
    u = dynamics.controls[0]
    problem = Problem(
        dynamics,
        tx.Minimize(running=u**2),
        nodes=11,
        final_time=2.0,
        initial={"p": 0.0, "v": 0.0},
        final={"p": 1.0, "v": 0.0},
    )
    # The cost errs by the multipliers (here about 3) times what is left of the violation, at most the tolerance.
    result = problem.solve(tolerance=1e-8)
    expected = least_norm(10, 2.0)
    assert result.status is Status.SOLVED
    np.testing.assert_allclose(result.us["u"], expected, atol=1e-4)
    assert result.cost == pytest.approx((expected**2).sum() * 0.2, rel=1e-6)
    assert problem.solve().cost == pytest.approx(result.cost, rel=1e-4)
    assert result.cost == pytest.approx(12.0 / 2.0**3, rel=0.02)
    assert result.xs["p"].shape == (11,)
    assert result.us["u"].shape == (10,)
    np.testing.assert_allclose(result.ts, np.linspace(0.0, 2.0, 11))
    rollout = result.replay(steps=3)
    assert rollout.misses["p"]["distance"] < 1e-6
    assert rollout.ts.shape == (31,)


def test_a_ball_turns_about_one_axis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A spherical body turns rest to rest along the geodesic, timed like the double integrator; and is shown so."""
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3.0, 2.2
    ball = spinning_ball()
    R, w = ball.states
    dynamics = tx.compile(tx.System(ball.rates, outputs={"spin": R @ w}))
    start = np.asarray(tx.SO3.exp(np.array([0.4, 1.0, -0.3])))
    problem = Problem(
        dynamics,
        tx.Minimize(running=dynamics.controls[0] @ dynamics.controls[0]),
        nodes=9,
        final_time=1.0,
        initial={"R": start, "w": np.zeros(3)},
        final={"R": start @ np.asarray(tx.SO3.exp(angle * axis)), "w": np.zeros(3)},
        **HEUN,
    )
    result = problem.solve(seed=3)
    assert result.solved
    np.testing.assert_allclose(result.us["u"], angle * least_norm(8, 1.0)[:, None] * axis, atol=2e-3)
    monkeypatch.setattr(tx.view.Scene, "save", lambda scene, path: path)
    spin = tx.view.Arrow(world=True)
    (vector,) = result.show(tmp_path / "turn.html", bodies={"R": tx.view.Sphere(1.0)}, arrows={"spin": spin}).vectors
    fastest = vector.values[np.linalg.norm(vector.values, axis=1).argmax()]
    np.testing.assert_allclose(fastest / np.linalg.norm(fastest), start @ axis, atol=1e-3)


def test_a_pose_is_reached_through_almost_a_half_turn() -> None:
    """With |v|^2 + |w|^2 as cost the best motion turns evenly and goes straight: J = (angle^2 + distance^2) / T."""
    angle, shift = np.pi - 0.01, np.array([1.0, 2.0, -0.5])
    dynamics = tx.compile(free_flyer())
    V = dynamics.controls[0]
    problem = Problem(
        dynamics,
        tx.Minimize(running=V @ V),
        nodes=21,
        final_time=2.0,
        initial={"g": np.eye(4)},
        final={"g": tx.pose(position=shift, rotation=tx.SO3.exp(angle * np.array([0.6, 0.0, 0.8])))},
        **EULER,
    )
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx((angle**2 + shift @ shift) / 2.0, rel=5e-3)
    rates = np.linalg.norm(result.us["V"][:, 3:], axis=1)
    np.testing.assert_allclose(rates, angle / 2.0, rtol=2e-2)
    miss = result.replay(steps=4).misses["g"]
    assert miss["position"] < 1e-4
    assert miss["angle"] < 1e-4


def test_problems_and_results_travel() -> None:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-6.0, max=6.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}, constraints={"speed": v <= 1.4}))
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": [{v: 0.0}, p == 1.0]}
    problem = Problem(dynamics, tx.Minimize(running=u**2), nodes=6, final_time=1.0, **ends, **HEUN)
    result = problem.solve()
    back, again = (pickle.loads(pickle.dumps(each)) for each in (result, problem))
    assert (back.status, back.cost, back.message) == (result.status, result.cost, result.message)
    np.testing.assert_array_equal(back.xs["p"], result.xs["p"])
    assert back.replay(steps=2).violations == result.replay(steps=2).violations
    assert again.solve().cost == result.cost


def test_a_maximum_is_reported_as_stated() -> None:
    """How far can a limited push for 1 s carry: p = 1/2, under a speed limit between nodes too."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    limited = tx.compile(tx.System(rates={p: v, v: u}, constraints={"speed": v <= 0.6}))
    result = Problem(limited, tx.Maximize(p), nodes=6, final_time=1.0, initial={"p": 0.0, "v": 0.0}, substeps=3).solve(
        guesses=2
    )
    assert result.solved
    # Full push until v = 0.6, then coasting: held controls of 0.2 s reach that exactly.
    assert result.cost == pytest.approx(0.5 * 0.6**2 + 0.6 * 0.4, abs=1e-4)
    assert len(result.tries) == 2
    assert result.replay(steps=10).violations["speed"] < 1e-6


@pytest.mark.parametrize(("limit", "options"), [(np.inf, {"nodes": 11, "substeps": 1}), (3.0, {"nodes": 21})])
def test_a_turn_about_one_axis_is_left(limit: float, options: dict[str, Any]) -> None:
    """Its 2 sqrt(pi) s meet the first-order conditions, but are no minimum; from a step away the search is back.

    By symmetry the other axes move by rounding alone, which says nothing of their units.
    """
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,), min=-limit, max=limit)
    u, rest = tx.Control("u", shape=(3,), min=-1.0, max=1.0), np.zeros(3)
    ends: dict[str, Any] = {"initial": {R: np.eye(3), w: rest}, "final": {R: np.diag([-1.0, -1.0, 1.0]), w: rest}}
    dynamics = tx.compile(tx.System(rates={R: w, w: u}))
    result = Problem(dynamics, tx.Minimize(tx.Time()), final_time=(1.0, 6.0), **ends, **options).solve()
    assert result.solved
    assert result.cost < 3.4
    assert result.optimality.gap < 1e-5


def test_a_turn_about_one_axis_is_left_for_the_fastest() -> None:
    """The half turn about one axis takes 2 sqrt(pi) s and meets the first-order conditions; the fastest 3.24308 s.

    Source: Bilimoria and Wie, J. Guidance 16 (1993).
    """
    R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,), min=-4e4, max=4e4)
    u, rest = tx.Control("u", shape=(3,), min=-1.0, max=1.0), np.zeros(3)
    ends: dict[str, Any] = {"initial": {R: np.eye(3), w: rest}, "final": {R: np.diag([-1.0, -1.0, 1.0]), w: rest}}
    dynamics = tx.compile(tx.System(rates={R: w, w: u}))
    problem = Problem(dynamics, tx.Minimize(tx.Time()), nodes=51, final_time=(1e-4, 6e4), **ends)
    results = [problem.solve(seed=seed) for seed in (1, 2, 3)]
    assert all(result.solved for result in results)
    assert min(result.cost for result in results) < 3.2435


def test_free_entries_of_the_start_are_chosen_too() -> None:
    """x' = u, |u| <= 1, x <= 2, one entry starts at 0 and the other anywhere: the best end is (1, 2)."""
    x = tx.State("x", shape=(2,), min=-2.0, max=2.0, initial=[0.0, None])
    u = tx.Control("u", shape=(2,), min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={x: u}))
    result = Problem(dynamics, tx.Maximize(x[0] + x[1]), nodes=4, final_time=1.0, **EULER).solve()
    assert result.solved
    np.testing.assert_allclose(result.xs["x"][-1], [1.0, 2.0], atol=1e-4)
    assert result.xs["x"][0, 0] == 0.0


def test_a_direction_without_limit_or_cost() -> None:
    """From the orbit of the Earth as far out as 193 days of a small thrust lead, 1.525 astronomical units.

    Only multipliers bend the objective along the direction, so without any at the start the first step is worthless.
    Source: Bryson and Ho, Applied Optimal Control (1975), section 2.5.
    """
    r, vr, vt, a = tx.State("r"), tx.State("vr"), tx.State("vt"), tx.Control("a")
    thrust = 0.1405 / (1.0 - 0.0749 * tx.Time())
    rates = {r: vr, vr: vt**2 / r - 1.0 / r**2 + thrust * tx.Sin(a), vt: -vr * vt / r + thrust * tx.Cos(a)}
    problem = Problem(
        tx.compile(tx.System(rates=rates)),
        tx.Maximize(r),
        nodes=60,
        final_time=3.3193,
        initial={r: 1.0, vr: 0.0, vt: 1.0},
        final=[vr == 0.0, vt == 1.0 / tx.Sqrt(r)],
        controls=tx.trajectory.Linear(),
    )
    guess = np.repeat([0.3, 5.9], 30)
    noise = np.random.default_rng(0).normal(scale=0.3, size=60)
    results = [problem.solve(guess={a: start}) for start in (guess, guess + noise)]  # an angle may wind once more
    assert all(result.solved and result.iterations < 50 for result in results)
    assert abs(max(result.cost for result in results) - 1.525) < 1e-3
