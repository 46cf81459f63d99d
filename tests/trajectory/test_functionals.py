"""Integrals, extremes and starts in the statement of a problem, against exact optima."""

import functools
import pickle
from typing import Any

import jax
import numpy as np
import pytest
from minimum_energy import NODES, STEP, TIME, dynamics, farthest, least_energy, leaves, reached
from trajectory_systems import HEUN, free_flyer

import twistax as tx
from twistax.errors import ModelError
from twistax.trajectory import Initial, Integral, Linear, Maximum, Minimum, Phase, Problem, Rate, solution

BUDGET = 3.0


@functools.cache
def with_budget() -> Problem:
    """As far as a budget of the integral of u^2 takes it from rest."""
    p, v, u = leaves()
    return Problem(
        dynamics(),
        tx.Maximize(p),
        nodes=NODES,
        final_time=TIME,
        **HEUN,
        initial={p: 0.0, v: 0.0},
        final=[Integral(u**2) <= BUDGET],
    )


def test_a_budget_of_an_integral_is_used_up_by_the_best_control() -> None:
    result = with_budget().solve(tolerance=1e-7)
    assert result.solved
    assert result.cost == pytest.approx(farthest(BUDGET), rel=1e-6)
    name = "final: Integral(u ** 2.) <= 3."
    assert result.active == (name,)
    assert result.multipliers[name] == pytest.approx([farthest(BUDGET) / (2.0 * BUDGET)], rel=1e-5)
    assert result.violations[name] < 1e-8
    along = result.integrals["Integral(u ** 2.)"]
    np.testing.assert_allclose(along, STEP * np.cumsum([0.0, *result.us["u"] ** 2]), atol=1e-9)
    assert set(result.xs) == set(result.replay().xs) == {"p", "v"}
    assert "Integral(u ** 2.) distance" in result.explain()


@pytest.mark.slow
def test_a_budget_is_solved_again_warm_in_cases_and_in_another_process() -> None:
    problem = with_budget()
    p, _, _ = leaves()
    result = problem.solve()
    again = problem.solve(warm=result, initial={p: 0.5})
    assert again.solved
    assert again.cost == pytest.approx(0.5 + farthest(BUDGET), rel=1e-6)
    assert again.iterations <= 5
    many = problem.solve_many(initial={p: [0.0, 1.0]})
    np.testing.assert_allclose(many.cost, farthest(BUDGET) + np.array([0.0, 1.0]), rtol=1e-6)
    assert set(many.xs) == {"p", "v"}
    assert many[1].integrals["Integral(u ** 2.)"][-1] == pytest.approx(BUDGET, rel=1e-6)
    other = pickle.loads(pickle.dumps(problem))
    assert other.final_rows.names == problem.final_rows.names
    optimum = tx.trajectory.solution(problem)(initial={"p": 0.25})
    assert set(optimum.xs) == {"p", "v"}
    assert float(optimum.cost) == pytest.approx(0.25 + farthest(BUDGET), rel=1e-6)


def test_an_integral_in_an_objective_is_a_running_cost() -> None:
    _, _, u = leaves()
    problem = Problem(dynamics(), tx.Minimize(2.0 * Integral(u * u) + tx.Time(), running=u * u), final_time=1.0)
    assert problem.dynamics is dynamics()
    assert repr(problem.objective.running) == repr((u * u + 2.0 * (u * u)).canonicalize())
    assert problem.objective.final.key() == tx.Time().key()


@pytest.mark.slow
def test_derivatives_of_optima() -> None:
    """By a budget, by a distance under the smallest peak, and by the step of a periodic path."""
    p, v, u = leaves()
    budget, step = tx.Parameter("budget", value=BUDGET), tx.Parameter("step", value=1.0)
    given: dict[str, Any] = {"nodes": NODES, "final_time": TIME, **HEUN}
    rest = {p: 0.0, v: 0.0}
    farther = Problem(dynamics(), tx.Maximize(p), initial=rest, final=[Integral(u**2) <= budget], **given)
    slope = jax.grad(lambda b: solution(farther)(params={"budget": b}).cost)(BUDGET)
    assert slope == pytest.approx(farthest(BUDGET) / (2.0 * BUDGET), rel=1e-6)
    softest = solution(
        Problem(dynamics(), tx.Minimize(Maximum(tx.Abs(u))), initial=rest, final={p: 1.0, v: 0.0}, **given)
    )
    assert jax.grad(lambda d: softest(final={"p": d}).cost)(1.0) == pytest.approx(1.0, rel=1e-6)
    forces = jax.jacfwd(lambda d: softest(final={"p": d}).us["u"])(1.0)
    np.testing.assert_allclose(forces, np.repeat([1.0, -1.0], 5), atol=1e-4)
    periodic = solution(
        Problem(
            dynamics(),
            tx.Minimize(running=u**2),
            initial={p: 0.0},
            at={5: p == 0.3},
            final=[p == Initial(p) + step, v == Initial(v)],
            **given,
        )
    )
    z = reached()
    rows = np.stack([z[5, 0], z[-1, 0], z[-1, 1] - z[0, 1]])
    above, below = (least_energy(rows, [0.3, s, 0.0]) for s in (1.01, 0.99))
    slope = jax.grad(lambda s: periodic(params={"step": s}).cost)(1.0)
    assert slope == pytest.approx((above - below) / 0.02, rel=1e-6)


@pytest.mark.slow
def test_a_hanging_chain_is_a_catenary() -> None:
    """Least height of a chain of given length between two nails; y = c cosh((x - 1/2) / c) + const."""
    y, slope = tx.State("y"), tx.Control("slope")
    length = (1.0 + slope**2) ** 0.5
    problem = Problem(
        tx.compile(tx.System(rates={y: slope})),
        tx.Minimize(Integral(y * length)),
        nodes=33,
        final_time=1.0,
        initial={y: 0.0},
        final=[{y: 0.0}, Integral(length) == 1.5],
        guess={y: -0.4 * np.sin(np.linspace(0.0, np.pi, 33)), slope: -1.2 * np.cos(np.linspace(0.0, np.pi, 32))},
    )
    result = problem.solve()
    assert result.solved
    low, high = 0.1, 2.0
    for _ in range(100):  # 2 c sinh(1 / (2 c)) = 1.5
        c = 0.5 * (low + high)
        low, high = (c, high) if 2.0 * c * np.sinh(0.5 / c) > 1.5 else (low, c)
    x = np.linspace(0.0, 1.0, 33)
    exact = c * (np.cosh((x - 0.5) / c) - np.cosh(0.5 / c))
    np.testing.assert_allclose(result.xs["y"], exact, atol=2e-3)


def test_the_smallest_peak_force() -> None:
    """A mass moved by 1 m in 2 s from rest to rest: force 4 d / T^2 = 1 N, one switch."""
    p, v, u = leaves()
    problem = Problem(
        dynamics(),
        tx.Minimize(Maximum(tx.Abs(u))),
        nodes=NODES,
        final_time=TIME,
        **HEUN,
        initial={p: 0.0, v: 0.0},
        final={p: 1.0, v: 0.0},
    )
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(1.0, rel=1e-6)
    np.testing.assert_allclose(result.us["u"], np.repeat([1.0, -1.0], 5), atol=1e-4)
    assert result.extremes == {"Maximum(Abs(u))": pytest.approx(1.0, rel=1e-5)}
    assert "Abs(u) <= Maximum(Abs(u))" in result.active
    # twice as far
    assert problem.solve(final={p: 2.0}).cost == pytest.approx(2.0, rel=1e-6)


@pytest.mark.slow
def test_limits_on_extremes_bind_and_the_least_is_pushed_up() -> None:
    """1 m in 2 s with a velocity of 0.6 m/s at most, over its least: v = 0.5 where both count."""
    p, v, _ = leaves()
    problem = Problem(
        dynamics(),
        tx.Maximize(2.0 * Minimum(v) - 0.5 * p),
        nodes=NODES,
        final_time=TIME,
        **HEUN,
        initial={p: 0.0},
        final=[p >= 1.0, Maximum(v) <= 0.6],
    )
    result = problem.solve()
    assert result.solved
    # p = 2 v_mean, at least 2 v_least: 2 v - 0.5 (2 v) grows with v, up to 0.6.
    assert result.cost == pytest.approx(0.6, rel=1e-6)
    assert result.extremes == {"Minimum(v)": pytest.approx(0.6, rel=1e-5), "Maximum(v)": pytest.approx(0.6, rel=1e-5)}


def test_a_periodic_path_of_least_energy() -> None:
    """0.3 m after one second, 1 m after two, with the velocity of the start at the end."""
    p, v, u = leaves()
    problem = Problem(
        dynamics(),
        tx.Minimize(running=u**2),
        nodes=NODES,
        final_time=TIME,
        **HEUN,
        initial={p: 2.0},
        at={5: p == 2.3},
        final=[p == Initial(p) + 1.0, v == Initial(v)],
    )
    result = problem.solve(tolerance=1e-9)
    assert result.solved
    z = reached()
    rows = np.stack([z[5, 0], z[-1, 0], z[-1, 1] - z[0, 1]])
    assert result.cost == pytest.approx(least_energy(rows, [0.3, 1.0, 0.0]), rel=1e-8)
    assert result.xs["v"][0] == pytest.approx(result.xs["v"][-1], abs=1e-9)
    assert set(result.xs) == {"p", "v"}
    assert result.violations["final: v == Initial(v)"] < 1e-9


@pytest.mark.slow
def test_a_forced_oscillator_finds_its_periodic_motion() -> None:
    """x'' + 0.4 x' + x = cos 2 t + u: with u = 0 the phasor 1 / (1 - 4 + 0.8 i)."""
    x, w, u = tx.State("x"), tx.State("w"), tx.Control("u")
    t = tx.Time()
    problem = Problem(
        tx.compile(tx.System(rates={x: w, w: tx.Cos(2.0 * t) - 0.4 * w - x + u})),
        tx.Minimize(running=u * u),
        nodes=25,
        final_time=np.pi,
        final=[x == Initial(x), w == Initial(w)],
    )
    result = problem.solve()
    assert result.solved
    phasor = 1.0 / (1.0 - 4.0 + 0.8j)
    assert result.xs["x"][0] == pytest.approx(phasor.real, abs=1e-5)
    assert result.xs["w"][0] == pytest.approx((2j * phasor).real, abs=1e-5)
    assert set(result.xs) == {"x", "w"}
    assert result.violations["final: x == Initial(x)"] < 1e-8
    assert max(miss["distance"] for miss in result.replay().misses.values()) < 1e-5


@pytest.mark.slow
def test_a_pose_relative_to_a_free_start() -> None:
    """A screw along its own axis from wherever it starts: cost |Log|^2 / T. It is six conditions, not sixteen."""
    system = free_flyer()
    (g,), (V,) = system.states, system.controls
    twist = np.array([0.0, 0.0, 0.2, 0.0, 0.0, 1.5])
    problem = Problem(
        tx.compile(system),
        tx.Minimize(running=V @ V),
        nodes=5,
        final_time=2.0,
        initial=[g[2, 3] == 1.0],
        final=[g == tx.lie.Compose(Initial(g), tx.lie.SE3Exp(twist))],
        guess={g: tx.pose(rotation=np.asarray(tx.SO3.exp(np.array([0.4, -0.3, 0.8]))))},
    )
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(twist @ twist / 2.0, rel=1e-6)
    assert result.xs["g"][0, 2, 3] == pytest.approx(1.0, abs=1e-8)
    np.testing.assert_allclose(np.linalg.inv(result.xs["g"][0]) @ result.xs["g"][-1], tx.SE3.exp(twist), atol=1e-7)


@pytest.mark.slow
def test_functionals_in_phases() -> None:
    """Two seconds in two phases: 0.3 m in the first, 1 m in all, with the velocity of the start at the end."""
    p, v, u = leaves()
    half = NODES // 2
    phases = [
        Phase(
            dynamics(),
            tx.Minimize(Integral(u**2)),
            nodes=half + 1,
            final_time=1.0,
            **HEUN,
            initial={p: 0.0},
            final=[Integral(v) == 0.3, Maximum(v) <= 3.0],
            name="first",
        ),
        Phase(
            dynamics(),
            tx.Minimize(Integral(u**2)),
            nodes=half + 1,
            final_time=1.0,
            **HEUN,
            final=[p == Initial(p) + 1.0, v == Initial(v), Maximum(v) <= 4.0, Integral(v) == 0.7],
            name="second",
        ),
    ]
    result = Problem(phases).solve()
    assert result.solved
    z = reached()
    rows = np.stack([z[half, 0], z[-1, 0], z[-1, 1] - z[0, 1]])
    assert result.cost == pytest.approx(least_energy(rows, [0.3, 1.0, 0.0]), rel=1e-6)
    first, second = result.phases
    assert first.integrals["Integral(v)"][-1] == pytest.approx(0.3, abs=1e-8)
    assert second.integrals["Integral(v)"][0] == 0.0
    for own in result.phases:
        assert own.extremes["Maximum(v)"] == pytest.approx(own.replay().xs["v"].max(), rel=1e-9)
    assert second.xs["v"][-1] == pytest.approx(first.xs["v"][0], abs=1e-8)


def test_norms_have_bounds_where_less_is_wanted() -> None:
    """In a budget alone; an equation or a gain wants the norm itself."""
    _, _, u = leaves()
    spent = Integral(tx.Abs(u) + 2.0 * u**2)

    def bounds(*final: Any, objective: Any = None) -> list[str]:
        problem = Problem(dynamics(), objective or tx.Minimize(tx.Time()), final_time=1.0, final=list(final))
        return list(problem.functionals.bounds)

    assert bounds(2.0 * spent <= 3.0) == [f"bound on {tx.Abs(u)!r} in {spent!r}"]
    assert bounds(spent == 3.0) == bounds(spent >= 3.0) == bounds(spent <= 3.0, spent >= 1.0) == []
    assert bounds(spent <= 3.0, objective=tx.Maximize(spent**2)) == []


@pytest.mark.slow
@pytest.mark.parametrize("linear", [False, True])
def test_least_time_on_a_budget_of_velocity(linear: bool) -> None:
    """1 m from rest to rest with |f| <= 1 and 1 m/s to spend: thrust for half a second, coast for 1.5 s, thrust."""
    x, w, f = tx.State("x", shape=(2,)), tx.State("w", shape=(2,)), tx.Control("f", shape=(2,))
    size = tx.linalg.Norm(f)
    problem = Problem(
        tx.compile(tx.System(rates={x: w, w: f}, constraints=[size <= 1.0])),
        tx.Minimize(tx.Time()),
        nodes=31,
        final_time=(0.5, 10.0),
        **({"controls": {f: Linear()}} if linear else HEUN),
        initial={x: [0.0, 0.0], w: [0.0, 0.0]},
        final=[{x: [0.8, 0.6], w: [0.0, 0.0]}, Integral(size) <= 1.0],
    )
    result = problem.solve()
    assert result.solved
    assert set(result.us) == {"f"}
    thrust = np.linalg.norm(result.us["f"], axis=1)
    if linear:
        assert 2.5 < result.final_time < 2.52  # it cannot jump
        spent = float(np.sum(np.diff(result.ts) * (thrust[1:] + thrust[:-1]) / 2.0))
    else:
        assert result.final_time == pytest.approx(2.5, rel=1e-5)
        np.testing.assert_allclose(thrust, np.repeat([1.0, 0.0, 1.0], [6, 18, 6]), atol=1e-3)
        spent = float(np.sum(np.diff(result.ts) * thrust))
    assert result.integrals["Integral(Norm(f))"][-1] == pytest.approx(spent, rel=1e-6)
    assert spent == pytest.approx(1.0, rel=1e-5)
    # Plenty: the budget does not bind, and what is told is what was spent.
    rich = problem.solve(warm=result, final={x: [0.08, 0.06]})
    assert rich.solved
    assert rich.final_time == pytest.approx(2.0 * np.sqrt(0.1), rel=2e-2)
    thrust = np.linalg.norm(rich.us["f"], axis=1)
    own = thrust if len(thrust) < 31 else (thrust[1:] + thrust[:-1]) / 2.0
    assert rich.integrals["Integral(Norm(f))"][-1] == pytest.approx(float(np.sum(np.diff(rich.ts) * own)), rel=1e-6)


@pytest.mark.slow
def test_bryson_and_denham_backwards() -> None:
    """The lowest ceiling for 4 of half the integral of u^2, where a ceiling of 1/9 costs 4 (Bryson and Ho, 3.11)."""
    p, v, u = leaves()
    problem = Problem(
        dynamics(),
        tx.Minimize(Maximum(p)),
        nodes=61,
        final_time=1.0,
        controls=Linear(),
        initial={p: 0.0, v: 1.0},
        final=[{p: 0.0, v: -1.0}, 0.5 * Integral(u**2) <= 4.0],
    )
    result = problem.solve(between=1e-6)
    assert result.solved
    assert result.cost == pytest.approx(1.0 / 9.0, rel=1e-4)
    assert result.extremes["Maximum(p)"] == pytest.approx(result.cost, rel=1e-5)
    # d cost / d energy of cost = 4 / (9 energy): -1/36, over the half in front.
    (name,) = (name for name in result.multipliers if name.startswith("final: (0.5"))
    assert result.multipliers[name] == pytest.approx([1.0 / 36.0], rel=1e-3)


@pytest.mark.slow
def test_the_smallest_peak_of_a_rate() -> None:
    """From force 0 to 1 in 2 s with work to do between: no faster than a straight line, and no more work."""
    p, v, u = leaves()
    problem = Problem(
        dynamics(),
        tx.Minimize(Maximum(tx.Abs(Rate(u)))),
        nodes=5,
        final_time=TIME,
        controls=Linear(),
        initial={p: 0.0, v: 0.0, u: 0.0},
        final=[{u: 1.0}, Integral(Rate(u) ** 2) <= 0.5000001],  # a straight line takes 0.5
    )
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(0.5, rel=1e-5)
    np.testing.assert_allclose(result.us["u"], np.linspace(0.0, 1.0, 5), atol=1e-3)


def refused(word: str, objective: Any = None, **ends: Any) -> None:
    with pytest.raises(ModelError, match=word):
        Problem(dynamics(), objective or tx.Minimize(tx.Time()), final_time=1.0, **ends)


def test_what_has_no_meaning_is_refused() -> None:
    p, v, u = leaves()
    refused("push Maximum", tx.Maximize(Maximum(u)))
    refused("push Minimum", tx.Minimize(Minimum(u)))
    refused("push Maximum", tx.Minimize(Maximum(u) ** 2))
    refused("push Maximum", final=[Maximum(u) == 1.0])
    refused("push Maximum", final=[Maximum(u) >= 1.0])
    refused("not defined at the start", initial=[Integral(u) == 1.0])
    refused("running cost", tx.Minimize(running=Integral(u)))
    refused("functional of the whole path", at={3: Maximum(u) <= 1.0})
    refused("which the system does not have", final=[Initial(tx.State("x")) == p])
    refused("which the system does not have", final=[Integral(tx.Control("w")) == 0.0])
    refused("no constraint or objective bounds", final=[Integral(Maximum(u)) == 0.0])
    with pytest.raises(ModelError, match="expects a state"):
        Initial(p + v)
    with pytest.raises(ModelError, match="condition"):
        Integral(p <= v)
    with pytest.raises(ModelError, match="whole path"):
        tx.System(rates={p: Integral(u)})
    with pytest.raises(ModelError, match="whole path"):
        tx.lower(Integral(u))(0.0, {})
