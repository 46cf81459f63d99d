"""Soft constraints, against optima with slacks by SciPy, exact answers and hard constraints."""

import functools
import itertools
import pickle
from typing import Any

import jax
import numpy as np
import pytest
from scipy.optimize import minimize
from trajectory_systems import HEUN

import twistax as tx
from twistax.errors import InputError
from twistax.trajectory import Collocation, Integral, Linear, Maximum, Mesh, Phase, Problem, Status, solution

INTERVALS, TIME = 8, 2.0
STEP = TIME / INTERVALS
p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
RATES: Any = {p: v, v: u}
REST = {p: 0.0, v: 0.0}
weight = tx.Parameter("weight", value=0.3)


def reached(us: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """p and v at the nodes from rest under held accelerations, exactly."""
    speeds = np.concatenate([[0.0], np.cumsum(us) * STEP])
    return np.concatenate([[0.0], np.cumsum(speeds[:-1] * STEP + 0.5 * us * STEP**2)]), speeds


def problem(along: Any = (), final: Any = (p == 1.0, v == 0.0), **options: Any) -> Problem:
    """The least integral of u^2 that comes to p = 1 at rest."""
    dynamics = tx.compile(tx.System(rates=RATES, constraints=along))
    chosen = {"objective": tx.Minimize(running=u**2), "nodes": INTERVALS + 1, "final_time": TIME, **HEUN, **options}
    return Problem(dynamics, initial=REST, final=list(final), **chosen)


def by_scipy(l1: float, l2: float, is_equality: bool) -> tuple[float, float]:
    """The least cost with slacks of |v| or v beyond 0.6 at both ends of each interval, and the largest slack."""

    def split(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return z[:INTERVALS], z[INTERVALS:]

    def cost(z: np.ndarray) -> float:
        us, slacks = split(z)
        return float(STEP * (us @ us + l1 * slacks.sum() + l2 * slacks @ slacks))

    def room(z: np.ndarray) -> np.ndarray:
        us, slacks = split(z)
        over = reached(us)[1] - 0.6
        sides = [over[:-1], over[1:]] + ([-over[:-1], -over[1:]] if is_equality else [])
        return np.concatenate([slacks - side for side in sides] + [slacks])

    ends = {"type": "eq", "fun": lambda z: np.array([a[-1] for a in reached(split(z)[0])]) - [1.0, 0.0]}
    start = np.concatenate([np.repeat([1.0, -1.0], INTERVALS // 2), np.ones(INTERVALS)])
    limits: Any = [ends, {"type": "ineq", "fun": room}]
    found = minimize(cost, start, method="SLSQP", constraints=limits, options={"ftol": 1e-14, "maxiter": 500})
    return float(found.fun), float(split(found.x)[1].max())


@pytest.mark.parametrize(
    ("l1", "l2", "is_equality"),
    [(0.3, None, False), (None, 3.0, False), (0.2, 1.5, False), (0.3, None, True), (0.2, 1.5, True)],
)
def test_the_price_along_the_path_is_that_of_slacks(l1: float | None, l2: float | None, is_equality: bool) -> None:
    constraint = v == 0.6 if is_equality else v <= 0.6
    result = problem({"speed": tx.Soft(constraint, l1=l1, l2=l2)}).solve()
    cost, most = by_scipy(l1 or 0.0, l2 or 0.0, is_equality)
    assert result.solved
    np.testing.assert_allclose(result.cost, cost, rtol=2e-7)
    np.testing.assert_allclose(result.soft["speed"], most, rtol=2e-4)


def test_a_smooth_equality_is_integrated() -> None:
    """Its price is a running cost, to which the trapezoid rule applies here."""
    soft = problem({"speed": tx.Soft(v == 0.6, l2=2.0)}).solve()
    stated = problem(objective=tx.Minimize(running=u**2 + 2.0 * (v - 0.6) ** 2)).solve()
    np.testing.assert_allclose(soft.cost, stated.cost, rtol=1e-9)
    np.testing.assert_allclose(soft.xs["v"], stated.xs["v"], atol=1e-7)
    np.testing.assert_allclose(soft.soft["speed"], 0.6, rtol=1e-9)  # at rest


def test_a_weight_above_the_multiplier_is_exact_and_one_below_it_is_paid() -> None:
    """J(c) of p(T) = c has the slope 2 c of J(1) = m: the hard optimum for l1 above it, else c = l1 / (2 m)."""
    hard = problem().solve()
    slope = 2.0 * hard.cost
    np.testing.assert_allclose(abs(hard.multipliers["final: p == 1."]), slope, rtol=1e-6)
    soft = problem(final=[tx.Soft(p == 1.0, l1=weight), v == 0.0])
    above, below = (soft.solve(params={weight: share * slope}) for share in (1.5, 0.4))
    assert above.solved
    assert below.solved
    np.testing.assert_allclose(above.cost, hard.cost, rtol=1e-6)
    assert above.soft["final: p == 1."] < 1e-6
    np.testing.assert_allclose(below.xs["p"][-1], 0.4, rtol=1e-5)
    np.testing.assert_allclose(below.soft["final: p == 1."], 0.6, rtol=1e-5)
    np.testing.assert_allclose(below.cost, 0.16 * hard.cost + 0.4 * slope * 0.6, rtol=1e-6)


@pytest.mark.parametrize("constraint", [p == 1.0, p >= 1.0], ids=["equality", "inequality"])
def test_squares_at_the_end_have_the_exact_answer(constraint: Any) -> None:
    """The least m c^2 + l2 (1 - c)^2 is at c = l2 / (m + l2)."""
    m = problem().solve().cost
    result = problem(final=[tx.Soft(constraint, l2=2.0), v == 0.0]).solve()
    np.testing.assert_allclose(result.xs["p"][-1], 2.0 / (m + 2.0), rtol=1e-6)
    np.testing.assert_allclose(result.cost, 2.0 * m / (m + 2.0), rtol=1e-6)
    (size,) = result.soft.values()
    np.testing.assert_allclose(size, m / (m + 2.0), rtol=1e-5)
    (replayed,) = (value for name, value in result.replay().final.items() if "p" in name)
    np.testing.assert_allclose(replayed, size, rtol=1e-6)


def test_both_ends_and_inner_nodes_may_be_soft() -> None:
    """Each price raises or keeps the cost, and each violation is named."""
    soft = functools.partial(tx.Soft, l2=0.5)
    result = Problem(
        tx.compile(tx.System(rates=RATES)),
        tx.Minimize(running=u**2),
        nodes=INTERVALS + 1,
        final_time=TIME,
        **HEUN,
        initial=[soft(p == 0.0), v == 0.0],
        at={4: [soft(v <= 0.5, l1=0.1)]},
        final=[soft(p == 1.0), v == 0.0],
    ).solve()
    assert result.solved
    assert set(result.soft) == {"initial: p == 0.", "node 4: v <= 0.5", "final: p == 1."}
    sizes = [abs(result.xs["p"][0]), max(result.xs["v"][4] - 0.5, 0.0), abs(1.0 - result.xs["p"][-1])]
    np.testing.assert_allclose(result.soft["initial: p == 0."], sizes[0], atol=1e-9)
    np.testing.assert_allclose(result.soft["final: p == 1."], sizes[2], atol=1e-9)
    np.testing.assert_allclose(result.soft["node 4: v <= 0.5"], sizes[1], atol=1e-9)
    price = 0.5 * (sizes[0] ** 2 + sizes[1] ** 2 + sizes[2] ** 2) + 0.1 * sizes[1]
    np.testing.assert_allclose(result.cost, STEP * result.us["u"] @ result.us["u"] + price, rtol=1e-6)


def test_what_is_maximised_pays_too() -> None:
    speed = tx.Soft(v <= 0.5, l1=weight)
    farthest = problem({"speed": speed, "push": u <= 1.0}, final=[Integral(u**2) <= 2.0], objective=tx.Maximize(p))
    costs = [farthest.solve(params={weight: size}).cost for size in (0.0, 0.05, 0.2, 5.0)]
    assert all(a > b + 1e-4 for a, b in itertools.pairwise(costs))
    hard = problem({"speed": v <= 0.5, "push": u <= 1.0}, final=[Integral(u**2) <= 2.0], objective=tx.Maximize(p))
    np.testing.assert_allclose(costs[-1], hard.solve().cost, rtol=1e-6)
    at_end = [tx.Soft(v == 0.0, l2=3.0), Integral(u**2) <= 2.0]
    result = problem(final=at_end, objective=tx.Maximize(p)).solve()
    np.testing.assert_allclose(result.cost, result.xs["p"][-1] - 3.0 * result.xs["v"][-1] ** 2, rtol=1e-7)
    assert 0.0 < result.soft["final: v == 0."] < 0.5


def test_vectors_norms_and_extremes_may_be_soft() -> None:
    x, w = tx.State("x", shape=(2,)), tx.Control("w", shape=(2,))
    rows = {"thrust": tx.Soft(tx.linalg.Norm(w) <= 0.4, l1=50.0), "box": tx.Soft(x <= [0.5, 9.0], l1=[0.01, 1.0])}
    dynamics = tx.compile(tx.System(rates={x: w}, constraints=rows))
    common: Any = {"nodes": 5, "final_time": 2.0, "initial": {x: [0.0, 0.0]}, **HEUN}
    result = Problem(dynamics, tx.Minimize(running=w @ w), final={x: [0.6, 0.0]}, **common).solve()
    assert result.solved
    np.testing.assert_allclose(result.us["w"], np.tile([0.3, 0.0], (4, 1)), atol=1e-3)
    np.testing.assert_allclose([result.soft["box[0]"], result.soft["box[1]"]], [0.1, 0.0], atol=1e-6)
    assert result.soft["thrust"] == 0.0
    end = [tx.Soft(Maximum(x[0]) <= 0.5, l2=10.0), tx.Soft(x == [0.6, 0.3], l1=1.0)]
    again = Problem(tx.compile(tx.System(rates={x: w})), tx.Minimize(running=w @ w), final=end, **common).solve()
    assert again.solved
    assert len(again.soft) == 3


@pytest.mark.parametrize(
    "options",
    [
        {"controls": Linear(), "method": None, "substeps": None},
        {"nodes": Mesh(6, free=True)},
        {"method": None, "substeps": None, "transcription": Collocation(tx.tableaus.GAUSS_LEGENDRE4)},
    ],
    ids=["linear", "free mesh", "collocation"],
)
def test_transcriptions_pay_the_integral_of_the_violation(options: Any) -> None:
    """Held over a span at 0.6 the speed costs l1 for each second: between the prices of no and of all violation."""
    hard, loose = (problem(along, **options).solve() for along in ({"speed": v <= 0.6}, {}))
    soft = problem({"speed": tx.Soft(v <= 0.6, l1=0.3)}, **options).solve()
    assert soft.solved
    assert loose.cost < soft.cost < hard.cost
    assert 0.0 < soft.soft["speed"] < loose.xs["v"].max() - 0.6


def test_phases_have_soft_constraints_of_the_same_name() -> None:
    dynamics = tx.compile(tx.System(rates=RATES, constraints={"speed": tx.Soft(v <= 0.6, l1=0.3)}))
    energy = tx.Minimize(running=u**2)
    rest = tx.Soft(v == 0.0, l1=1e-3)  # while it goes this costs little, and changes little
    first = Phase(dynamics, energy, nodes=5, final_time=1.0, initial=REST, final=rest, **HEUN, name="go")
    final = [tx.Soft(p == 1.0, l1=50.0), {v: 0.0}, tx.Soft(v == 0.0, l1=1e-3)]
    result = Problem(
        [first, Phase(dynamics, energy, nodes=5, final_time=1.0, final=final, **HEUN, name="stop")]
    ).solve()
    whole = problem({"speed": tx.Soft(v <= 0.6, l1=0.3)}).solve()
    assert result.solved
    assert result.iterations <= 30  # slacks of small weights move as far as they like
    np.testing.assert_allclose(result.cost, whole.cost + 1e-3 * result.soft["go: final: v == 0."], rtol=1e-5)
    assert set(result.soft) == {f"{name}: {row}" for name in ("go", "stop") for row in ("speed", "final: v == 0.")} | {
        "stop: final: p == 1."
    }
    np.testing.assert_allclose(result.soft["stop: speed"], whole.soft["speed"], rtol=1e-2)
    assert result.soft["go: final: v == 0."] > 0.5
    assert result.soft["stop: final: v == 0."] < 1e-6
    assert "go: speed" in result.explain()


def test_costs_have_derivatives_by_weights() -> None:
    """dJ/d l1 is what is paid for: the integral of the slack."""
    soft = problem({"speed": tx.Soft(v <= 0.6, l1=weight)})
    low, high = (soft.solve(params={weight: 0.3 + side * 1e-3}) for side in (-1.0, 1.0))
    slope = jax.grad(lambda size: solution(soft)(params={"weight": size}).cost)(0.3)
    np.testing.assert_allclose(slope, (high.cost - low.cost) / 2e-3, rtol=1e-4)


def test_weights_are_data() -> None:
    soft = problem({"speed": tx.Soft(v <= 0.6, l1=weight)})
    low, high = (soft.solve(params={weight: 0.3 + side * 1e-3}) for side in (-1.0, 1.0))
    many = soft.solve_many(params={weight: np.array([0.299, 0.301])})
    np.testing.assert_allclose(many.cost, [low.cost, high.cost], rtol=1e-9)
    again = pickle.loads(pickle.dumps(soft)).solve()
    np.testing.assert_allclose(again.cost, soft.solve().cost, rtol=1e-12)
    warm = soft.solve(warm=low)
    assert warm.solved
    assert warm.iterations <= 10


@pytest.mark.parametrize("place", ["path", "node"])
def test_a_negative_weight_is_refused_wherever_it_comes_from(place: str) -> None:
    asked = tx.Soft(v <= 0.6, l2=2.0 * weight - 0.5)
    soft = problem({"speed": asked}) if place == "path" else problem(final=[p == 1.0, asked])
    for call in (soft.solve, tx.trajectory.solution(soft)):
        with pytest.raises(InputError, match=r"weight l2 of .* must be 0 or more, got -0.1 by 'w"):
            call(params={"weight": 0.2})
    many = soft.solve_many(params={weight: np.array([1.0, 0.2])})
    assert many.status == (Status.SOLVED, Status.REFUSED)
    phases = [Phase(tx.compile(tx.System(rates=RATES, constraints={"speed": asked})), tx.Minimize(v), final_time=1.0)]
    with pytest.raises(InputError, match="phase 0: params: the weight l2"):
        Problem(phases, params={weight: 0.2})


def test_a_system_has_its_soft_constraints() -> None:
    system = tx.System(rates=RATES, constraints=[tx.Soft(v <= 1.0, l1=1.0)])
    assert list(system.constraints) == list(system.soft) == ["v <= 1."]


def test_messages_name_no_violation_of_a_soft_constraint() -> None:
    """Its row with the slack is far less violated than the constraint, and that is what a search has left to do."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-2.0, max=2.0)
    soft = {"slow": tx.Soft(v <= 0.6, l1=0.1)}
    problem = Problem(
        tx.compile(tx.System(rates={p: v, v: u}, constraints=soft)),
        tx.Minimize(running=u * u),
        nodes=9,
        final_time=2.0,
        initial={p: 0.0, v: 0.0},
        final=[p == 1.0, v == 0.0],
    )
    result = problem.solve(callback=lambda iteration, *_: iteration >= 3)
    assert result.status is Status.STOPPED
    assert "Worst: 'slow'" in result.message
    named = float(result.message.partition("violated by ")[2].split(";")[0])
    assert named < 0.7 * result.soft["slow"]
