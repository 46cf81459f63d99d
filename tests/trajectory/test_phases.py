"""Problems of several phases: known optima, joins of every kind, derivatives, and what is refused."""

import functools
import pickle
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from trajectory_systems import EULER, HEUN

import twistax as tx
from twistax.trajectory import Phase, PhasedResult, Problem, Status

G0 = 9.80665


@functools.cache
def pushed(push: float) -> tx.Dynamics:
    p, v = tx.State("p"), tx.State("v")
    return tx.compile(tx.System(rates={p: v, v: tx.Parameter(f"push {push:+g}", value=push)}))


@functools.cache
def bang_bang() -> Problem:
    """Full ahead, then full back, for as long as each takes: 1 s each for a distance of 1."""
    once: dict[str, Any] = {"final_time": (0.1, 5.0), **HEUN}
    return Problem(
        [
            Phase(pushed(1.0), nodes=3, initial={"p": 0.0, "v": 0.0}, name="ahead", **once),
            Phase(pushed(-1.0), tx.Minimize(tx.Time()), nodes=4, final={"p": 1.0, "v": 0.0}, **once),
        ]
    )


def test_a_switching_time_is_found_exactly() -> None:
    result: PhasedResult = bang_bang().solve()
    assert result.status is Status.SOLVED
    assert result.durations == pytest.approx({"ahead": 1.0, "phase 1": 1.0}, rel=1e-6)
    assert result.final_time == pytest.approx(2.0, rel=1e-6)
    first, second = result.phases
    np.testing.assert_allclose(first.ts, [0.0, 0.5, 1.0], rtol=1e-6)
    np.testing.assert_allclose(second.ts, np.linspace(1.0, 2.0, 4), rtol=1e-6)
    assert second.xs["p"][0] == pytest.approx(0.5, rel=1e-6)
    assert second.xs["v"][0] == pytest.approx(1.0, rel=1e-6)
    # dT / dp = 1, 1 / v at the switch times the share.
    assert abs(result.multipliers["phase 1: final p"][0]) == pytest.approx(1.0, rel=1e-5)
    assert max(own.misses["p"]["distance"] for own in result.replay(steps=2)) < 1e-8
    assert "duration of ahead: lower limit" in result.multipliers


def with_a_free_jump() -> Problem:
    x, u = tx.State("x"), tx.Control("u")
    once: dict[str, Any] = {"nodes": 3, "final_time": 1.0, **EULER}
    dynamics = tx.compile(tx.System(rates={x: u}))
    first = Phase(dynamics, tx.Minimize(running=u**2), initial={x: 0.0}, **once)
    last = Phase(dynamics, tx.Minimize(running=u**2), final={x: 5.0}, **once)
    return Problem([first, last], links=[{x: None}])


def test_a_free_jump_is_no_control_without_a_limit() -> None:
    problem = with_a_free_jump()
    result = problem.solve()
    assert result.solved
    assert result.cost == pytest.approx(0.0, abs=1e-9)


def test_time_goes_on_from_phase_to_phase() -> None:
    """x' = t, and 1 + t along the second second: x(2) = 2, and an integral of 2.5."""
    x, t = tx.State("x"), tx.Time()
    dynamics = tx.compile(tx.System(rates={x: t}))
    last = Phase(dynamics, tx.Minimize(x + 10.0 * t, running=1.0 + t), nodes=2, final_time=1.0, at=None, final=[x <= t])
    result = Problem([Phase(dynamics, nodes=2, final_time=1.0, initial={x: 0.0}), last]).solve()
    assert result.solved
    assert result.cost == pytest.approx(2.0 + 20.0 + 2.5, rel=1e-9)
    assert result.phases[1].replay(steps=3).misses["x"]["distance"] < 1e-9
    assert result.violations["phase 1: final: x <= t"] == 0.0


def test_phases_and_their_results_travel() -> None:
    result = bang_bang().solve()
    back, again = (pickle.loads(pickle.dumps(each)) for each in (result, bang_bang()))
    np.testing.assert_array_equal(back.phases[1].xs["p"], result.phases[1].xs["p"])
    assert back.mesh_error == result.mesh_error
    assert list(again.shooting.names) == list(bang_bang().shooting.names)


@pytest.mark.slow
def test_phases_that_travelled_are_solved_as_they_were() -> None:
    again = pickle.loads(pickle.dumps(bang_bang()))
    assert again.solve().cost == bang_bang().solve().cost


def test_two_stages_share_the_mass_as_tsiolkovsky_says() -> None:
    """Of 100 a payload of 1, a tenth of each stage its structure: 10 are left of it after the first."""
    v, m, s = tx.State("v"), tx.State("m"), tx.Parameter("first stage", value=60.0)
    dynamics = tx.compile(tx.System(rates={v: 10.0 / m, m: -10.0 + 0.0 * v}))
    problem = Problem(
        [
            Phase(dynamics, nodes=13, final_time=(1.0, 12.0), initial={v: 0.0, m: 100.0}, final=[m == 100.0 - 0.9 * s]),
            Phase(
                dynamics,
                tx.Maximize(v),
                nodes=13,
                final_time=(0.1, 12.0),
                final=[m == 1.0 + 0.1 * (99.0 - s)],
                guess={m: [30.0] * 12 + [5.0]},
            ),
        ],
        links=[{m: m - 0.1 * s}],
        free={s: (10.0, 98.0)},
    )
    result = problem.solve()
    assert result.solved
    assert result.params["first stage"] == pytest.approx(90.0, rel=2e-3)
    assert result.cost == pytest.approx(2.0 * np.log(100.0 / 19.0), rel=1e-4)
    assert result.phases[0].xs["m"][-1] - result.phases[1].xs["m"][0] == pytest.approx(9.0, rel=2e-3)


def test_a_phase_cut_in_two_is_the_phase() -> None:
    """Least energy, rest to rest, with a limit that binds; one half has the states the other way round, and a third."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", max=1.2)
    spare = tx.State("spare", shape=(2,))
    first = tx.compile(tx.System(rates={p: v, v: u}))
    second = tx.compile(tx.System(rates={spare: np.array([1.0, 2.0]) * v, v: u, p: v}))
    cost = tx.Minimize(running=u * u)
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}}
    whole = Problem(first, cost, nodes=11, final_time=2.0, final={p: 1.0, v: 0.0}, **ends, **HEUN).solve(tolerance=1e-8)
    halves = Problem(
        [
            Phase(first, cost, nodes=6, final_time=1.0, **ends, **HEUN),
            Phase(second, cost, nodes=6, final_time=1.0, initial={spare: [0.0, 0.0]}, final={p: 1.0, v: 0.0}, **HEUN),
        ]
    ).solve(tolerance=1e-8)
    assert halves.solved
    assert halves.cost == pytest.approx(whole.cost, rel=1e-7)
    found = np.concatenate([own.us["u"] for own in halves.phases])
    np.testing.assert_allclose(found, whole.us["u"], atol=1e-6)
    shift = halves.phases[1].xs["p"][-1] - halves.phases[1].xs["p"][0]
    np.testing.assert_allclose(halves.phases[1].xs["spare"][-1], shift * np.array([1.0, 2.0]), atol=1e-7)
    both = np.concatenate([own_u for name, own_u in halves.multipliers.items() if name.endswith("u <= 1.2")])
    np.testing.assert_allclose(both, whole.multipliers["u <= 1.2"], atol=1e-5)


@pytest.mark.parametrize("link", ["impulse", "free", "value"])
def test_an_impulse_a_free_start_and_a_value(link: str) -> None:
    """1 s at 0.5, then 1 s to p = 2: the second leg flies at 1.5, which the first leaves where nothing jumps."""
    p, v, dv = tx.State("p", max=2.0), tx.State("v"), tx.Parameter("dv", value=0.0)
    drift = tx.compile(tx.System(rates={p: v, v: 0.0 * v}))
    cost = tx.Minimize(dv * dv + (v - 1.0) ** 2) if link == "impulse" else tx.Minimize((v - 1.0) ** 2)
    once: dict[str, Any] = {"nodes": 3, "final_time": 1.0, **EULER}
    problem = Problem(
        [
            Phase(drift, initial={p: 0.0, v: 0.5}, **once),
            Phase(drift, cost, initial={v: 1.5} if link == "value" else None, final={p: 2.0}, **once),
        ],
        links=[{"impulse": {v: v + dv}, "free": {v: None}, "value": None}[link]],
        free={dv: (-5.0, 5.0)} if link == "impulse" else None,
    )
    result = problem.solve()
    assert result.solved
    np.testing.assert_allclose(result.phases[1].xs["v"], 1.5, atol=1e-6)
    assert result.phases[1].xs["p"][0] == pytest.approx(0.5, abs=1e-6)
    if link == "impulse":
        assert result.params["dv"] == pytest.approx(1.0, abs=1e-6)


def test_an_integral_of_a_later_phase_begins_at_zero() -> None:
    """A budget of effort for the second half: SciPy has the held controls alone as unknowns."""
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u")
    dynamics, cost = tx.compile(tx.System(rates={p: v, v: u})), tx.Minimize(running=u * u)
    end, budget, count = [{p: 1.0, v: 0.0}, tx.trajectory.Integral(u * u) <= 0.6], 0.6, 6
    result = Problem(
        [
            Phase(dynamics, cost, nodes=count + 1, final_time=1.0, initial={p: 0.0, v: 0.0}),
            Phase(dynamics, cost, nodes=count + 1, final_time=1.0, final=end),
        ]
    ).solve()
    step = 1.0 / count
    later = step * (np.arange(2 * count)[::-1] + 0.5)  # from the middle of an interval to the end
    least = minimize(
        lambda z: step * z @ z,
        np.zeros(2 * count),
        constraints=[
            {"type": "eq", "fun": lambda z: np.array([step * z.sum(), step * later @ z - 1.0])},
            {"type": "ineq", "fun": lambda z: budget - step * z[count:] @ z[count:]},
        ],
        method="SLSQP",
        options={"ftol": 1e-12},
    )
    assert result.solved
    assert result.cost == pytest.approx(least.fun, rel=1e-6)
    assert result.phases[1].integrals["Integral(u * u)"][-1] == pytest.approx(budget, abs=1e-6)


def test_an_optimum_as_a_function_is_of_no_list_of_phases() -> None:
    with pytest.raises(tx.TrajectoryError, match="of one phase, got a list of phases, 2"):
        tx.trajectory.solution(bang_bang())
    alone = Problem([Phase(pushed(1.0), tx.Minimize(tx.Time()), nodes=3, final_time=1.0, initial={"p": 0.0, "v": 0.0})])
    with pytest.raises(tx.TrajectoryError, match="got a list of phases, 1"):
        tx.trajectory.solution(alone)


def test_a_limit_that_the_end_of_a_phase_meets_binds_nobody_at_the_next_start() -> None:
    p, v, u = tx.State("p", max=1.0), tx.State("v"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    cost = tx.Minimize(running=u * u)
    result = Problem(
        [
            Phase(dynamics, cost, nodes=5, final_time=1.0, initial={p: 0.0, v: 0.0}, final={p: 1.0, v: 0.0}, **HEUN),
            Phase(dynamics, cost, nodes=5, final_time=1.0, final={p: 0.0, v: 0.0}, **HEUN),
        ]
    ).solve()
    assert result.solved
    assert result.cost == pytest.approx(2.0 * 12.0 / (1.0 - 1.0 / 16.0), rel=1e-5)


def test_a_limit_is_asked_once_at_a_join_and_on_both_sides_of_a_jump() -> None:
    p, v, u = tx.State("p", max=1.0), tx.State("v"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    phases = [
        Phase(dynamics, tx.Minimize(running=u * u), nodes=3, final_time=1.0, initial={p: 0.0, v: 0.0}),
        Phase(dynamics, nodes=4, final_time=1.0, final={p: 0.0, v: 0.0}),
    ]
    asked = [int(Problem(phases, links=[link]).shooting.exists.sum()) for link in ({}, {p: 0.9 * p})]
    assert asked[1] == asked[0] + 1


# ---- derivatives -------------------------------------------------------------------------------------------------


# ---- what is refused ---------------------------------------------------------------------------------------------

AHEAD = {"final_time": 1.0, "nodes": 3}
BAD: list[tuple[Any, dict[str, Any], type[Exception], str]] = [
    ([], {}, tx.ModelError, "a list of tx.trajectory.Phase"),
    ([3.0], {}, tx.ModelError, "a list of tx.trajectory.Phase"),
    ([{}], {}, tx.ModelError, "the objectives of all phases must be of one kind"),
    ([{"objective": tx.Minimize(tx.Time())}, {"objective": tx.Maximize(tx.Time())}], {}, tx.ModelError, "Maximize"),
    ([{"objective": tx.Minimize(tx.Time()), "nodes": 1, "name": "up"}], {}, tx.TrajectoryError, "up: nodes"),
    ([{"objective": tx.Minimize(tx.Time())}], {"links": [{}]}, tx.ModelError, "links expects a list of length 0"),
    ([{"objective": tx.Minimize(tx.Time())}, {}], {"links": [{"q": 0.0}]}, tx.ModelError, "'q'"),
    ([{"objective": tx.Minimize(tx.Time())}, {}], {"links": [{"p": [1.0, 2.0]}]}, tx.ShapeError, "'p'"),
    ([{"objective": tx.Minimize(tx.Time())}, {}], {"links": [{"p": tx.State("q")}]}, tx.ModelError, "'q'"),
    ([{"objective": tx.Minimize(tx.Time())}], {"params": {"mass": 1.0}}, tx.InputError, "'mass'"),
    ([{"objective": tx.Minimize(tx.Time())}], {"nodes": 9}, tx.ModelError, "links, params and free only, got 'nodes'"),
    ([{"objective": tx.Minimize(tx.Time())}], {"free": {"mass": (1.0, 2.0)}}, tx.ModelError, "'mass'"),
]


@pytest.mark.parametrize(("phases", "options", "error", "text"), BAD, ids=[str(number) for number in range(len(BAD))])
def test_what_cannot_be_is_refused(phases: Any, options: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        Problem([Phase(pushed(1.0), **(AHEAD | own)) if isinstance(own, dict) else own for own in phases], **options)
