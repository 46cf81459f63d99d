"""SOLVED says that the mesh follows the equations, too: misses, the objective, limits between nodes, all by oracles."""

import functools
import sys
from typing import Any

import jax
import numpy as np
import pytest
from trajectory_systems import HEUN

import twistax as tx
from twistax.trajectory import Collocation, Held, Linear, Mesh, Phase, Problem, Spline, Status

RATE = 50.0  # 1/s
RADAU = Collocation(tx.tableaus.RADAU_IIA5, substeps=2)


@functools.cache
def lag() -> tx.Dynamics:
    """A velocity that follows its command at a rate of 50 1/s."""
    x, z, u = tx.State("x"), tx.State("z"), tx.Control("u", min=-1.0, max=1.0)
    return tx.compile(tx.System(rates={x: z, z: -RATE * (z - u)}))


@functools.cache
def lagging(**options: Any) -> Problem:
    x, u = lag().states[0], lag().controls[0]
    asked: dict[str, Any] = {"nodes": 21, "final_time": 2.0, "initial": {"x": 1.0, "z": 0.0}} | options
    return Problem(lag(), tx.Minimize(running=x**2 + 0.01 * u**2), **asked)


def test_a_mesh_too_coarse_for_a_fast_rate_is_said() -> None:
    result = lagging().solve()
    assert result.status is Status.COARSE
    assert not result.solved
    own = result.accuracy
    assert own is not None
    assert own.coarse
    for text in ("COARSE: ", own.place, f"{own.error:.2g} in scales", "solve(refine=1e-4)", "RADAU_IIA5"):
        assert text in result.message
    assert f"{own.error:.1e} {own.place}" in result.explain()
    # The close integration is right where the planned one is not: z has a closed form under a held command.
    (misses,), sizes = own.intervals, result.warm.scales.d[1:]
    ts, xs, us = result.ts, result.xs, result.us["u"]
    for k in range(len(us)):
        h, start = ts[k + 1] - ts[k], xs["z"][k] - us[k]
        z = us[k] + start * np.exp(-RATE * h)
        x = xs["x"][k] + us[k] * h + start * (1.0 - np.exp(-RATE * h)) / RATE
        gap = np.abs([x - xs["x"][k + 1], z - xs["z"][k + 1]]) / sizes[k]
        assert misses[k] == pytest.approx(gap.max(), rel=1e-3, abs=1e-6)


def test_a_method_for_stiff_rates_is_accurate_there() -> None:
    result = lagging(transcription=RADAU).solve()
    assert result.status is Status.SOLVED
    assert result.cost == pytest.approx(0.36267, abs=2e-4)


@pytest.mark.parametrize("controls", [Held(), Linear(), Spline(2)], ids=["held", "linear", "spline"])
def test_every_kind_of_control(controls: Any) -> None:
    assert lagging(controls=controls).solve().status is Status.COARSE


def test_free_nodes_do_not_hide_what_they_gain() -> None:
    """An optimiser that moves nodes to where the error pays finds less than the least, 1.330807."""
    x, u = tx.State("x"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: -(x**3) + u}))
    running = 0.5 * (x**2 + u**2)
    result = Problem(
        dynamics,
        tx.Minimize(running=running),
        nodes=Mesh(20, free=True),
        final_time=25.0,
        initial={x: 1.5},
        final={x: 1.0},
    ).solve()
    assert result.cost < 1.33
    assert result.status is Status.COARSE


def test_the_change_of_the_objective_is_that_of_a_finer_method() -> None:
    """On the same mesh, so that the controls are as free as before."""
    rough, fine = (lagging(nodes=31, substeps=n).solve() for n in (2, 24))
    own = rough.accuracy
    assert own is not None
    assert fine.accuracy is not None
    assert abs(fine.cost - rough.cost) > 1e-6
    assert own.change == pytest.approx(fine.cost - rough.cost, rel=0.15)
    assert abs(fine.accuracy.change) < 1e-7


def test_what_a_mesh_misses_is_worth_its_multipliers() -> None:
    """The integral of held controls is exact on any mesh: all of the change is what it takes to close the gaps."""
    x, u = tx.State("x"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: -5.0 * x + u}))

    def solved(substeps: int) -> Any:
        asked = {"nodes": 9, "final_time": 1.0, "initial": {x: 0.0}, "final": {x: 1.0}, "substeps": substeps}
        return Problem(dynamics, tx.Minimize(running=u**2), **asked).solve()

    rough, fine = solved(1), solved(8)
    assert rough.accuracy is not None
    assert abs(fine.cost / rough.cost - 1.0) > 1e-4
    assert rough.accuracy.change == pytest.approx(fine.cost - rough.cost, rel=0.05)


def test_the_change_of_a_maximum_has_its_sign() -> None:
    x, u = lag().states[0], lag().controls[0]
    asked: dict[str, Any] = {"nodes": 41, "final_time": 2.0, "initial": {"x": 1.0, "z": 0.0}, "substeps": 2}
    most = Problem(lag(), tx.Maximize(running=-(x**2) - 0.01 * u**2), **asked).solve()
    least = lagging(nodes=41, substeps=2).solve()
    assert most.accuracy is not None
    assert least.accuracy is not None
    assert most.accuracy.change == pytest.approx(-least.accuracy.change, rel=1e-6)


def test_a_tolerance_of_the_mesh_is_as_asked() -> None:
    result = lagging().solve(mesh_tolerance=np.inf)
    assert result.status is Status.SOLVED
    assert "too coarse" not in result.explain()
    for size in (0.0, -1.0, np.nan):
        with pytest.raises(tx.TrajectoryError, match="mesh_tolerance"):
            lagging().solve(mesh_tolerance=size)
        with pytest.raises(tx.TrajectoryError, match="mesh_tolerance"):
            lagging().solve_many(initial={"x": np.ones(2), "z": np.zeros(2)}, mesh_tolerance=size)


def test_a_tighter_mesh_is_asked_for() -> None:
    fine = lagging(transcription=RADAU).solve()
    assert fine.accuracy is not None
    tight = lagging(transcription=RADAU).solve(mesh_tolerance=0.5 * fine.accuracy.error)
    assert tight.status is Status.COARSE


def test_many_cases_and_warm_starts_are_looked_at() -> None:
    problem, start = lagging(), {"x": np.array([1.0, 0.5, 0.9, 1.1, 0.0]), "z": np.zeros(5)}
    many = problem.solve_many(initial=start)
    # At rest at the goal there is nothing to miss.
    assert many.status == (*[Status.COARSE] * 4, Status.SOLVED)
    assert many[0].message == problem.solve().message
    assert problem.solve_many(initial=start, mesh_tolerance=np.inf).solved.all()
    assert problem.solve(warm=problem.solve(), initial={"x": 0.9}).status is Status.COARSE


def test_a_phase_that_is_coarse_is_named() -> None:
    x, z, u = lag().states + lag().controls
    running = x**2 + 0.01 * u**2
    first = Phase(lag(), tx.Minimize(running=running), nodes=9, final_time=0.1, initial={x: 1.0, z: 0.0}, name="near")
    phases = [first, Phase(lag(), tx.Minimize(running=running), nodes=11, final_time=1.0, name="far")]
    result = Problem(phases).solve()
    assert result.status is Status.COARSE
    assert "of 'far' misses its end" in result.message


@pytest.mark.parametrize("name", ["IPOPT", "Fatrop"])
def test_solvers_of_others_are_looked_at(name: str) -> None:
    pytest.importorskip("casadi")
    solver = getattr(tx.trajectory, name)(max_seconds=None)
    assert lagging().solve(solver=solver).status is Status.COARSE
    result = lagging(transcription=RADAU).solve(solver=solver)
    assert result.status is Status.SOLVED
    assert lagging(transcription=RADAU).solve(solver=solver, warm=result).iterations == 0


def test_derivatives_of_a_coarse_optimum_are_refused() -> None:
    optimum = tx.trajectory.solution(lagging())
    with pytest.raises(tx.TrajectoryError, match=r"not solved\. COARSE"):
        optimum()
    coarse = tx.trajectory.solution(lagging(), mesh_tolerance=np.inf)
    assert coarse().cost == pytest.approx(lagging().solve().cost, abs=1e-5)
    if sys.platform == "linux":
        with pytest.raises(Exception, match=r"not solved\. COARSE"):
            jax.jit(lambda x: optimum(initial={"x": x}).cost)(1.0).block_until_ready()


# ---- limits between nodes --------------------------------------------------------------------------------------------


@functools.cache
def below_a_ceiling() -> Problem:
    x, v, u = tx.State("x"), tx.State("v"), tx.Control("u")
    dynamics = tx.compile(tx.System(rates={x: v, v: u}, constraints={"ceiling": x <= 0.1}))
    ends: dict[str, Any] = {"initial": {x: 0.0, v: 1.0}, "final": {x: 0.0, v: -1.0}}
    return Problem(dynamics, tx.Minimize(running=0.5 * u**2), nodes=8, final_time=1.0, **ends, **HEUN)


def test_limits_that_are_exceeded_between_nodes_are_named() -> None:
    result = below_a_ceiling().solve()
    assert result.status is Status.SOLVED
    assert result.accuracy is not None
    exceeded = result.accuracy.exceeded["ceiling"]
    # On each interval x is a parabola; its top by hand.
    tops = []
    for k, u in enumerate(result.us["u"]):
        turn = np.clip(-result.xs["v"][k] / u, 0.0, 1.0 / 7.0)
        tops.append(result.xs["x"][k] + result.xs["v"][k] * turn + 0.5 * u * turn**2 - 0.1)
    stage = next(k for k in range(len(tops)) if exceeded.place == f"between nodes {k} and {k + 1}")
    assert tops[stage] == pytest.approx(max(tops), rel=1e-3)
    # It is looked at in eight steps.
    assert exceeded.by == pytest.approx(max(tops), rel=0.3, abs=1e-9)
    assert f"Exceeded between nodes: 'ceiling' by {exceeded.by:.2g} {exceeded.place}" in result.message
    assert f"({exceeded.share / 1e-6:.2g} times the tolerance)" in result.message
    assert "Exceeded" not in below_a_ceiling().solve(between=1e-6).message


# ---- rows without slope ----------------------------------------------------------------------------------------------


@functools.cache
def to_rest(condition: str, nodes: int) -> Problem:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    final: Any = {"v": [p == 1.0, v**2 <= 0.0], "p": [(p - 1.0) ** 2 <= 0.0, v == 0.0]}[condition]
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends: dict[str, Any] = {"initial": {p: 0.0, v: 0.0}, "final": final}
    return Problem(dynamics, tx.Minimize(tx.Time()), nodes=nodes, final_time=(0.1, 6.0), **ends, **HEUN)


@pytest.mark.parametrize("nodes", [11, 21, 41])
@pytest.mark.parametrize("condition", ["v", "p"])
def test_an_end_condition_without_slope_is_never_solved_elsewhere(condition: str, nodes: int) -> None:
    """The least time is 2. A multiplier of 1e20 makes every gradient small beside itself."""
    result = to_rest(condition, nodes).solve()
    if result.status is Status.SOLVED:
        assert result.cost == pytest.approx(2.0, abs=1e-5)
    if result.status is Status.DEGENERATE:
        text = {"v": "final: (v ** 2.) <= 0.", "p": "final: ((p - 1.) ** 2.) <= 0."}[condition]
        assert f"The multiplier of {text!r} at node {nodes - 1} is" in result.message


# ---- warm from its own result ----------------------------------------------------------------------------------------


def test_a_solution_as_a_start_is_the_result() -> None:
    problem = lagging()
    result = problem.solve()
    again = problem.solve(warm=result)
    assert (again.iterations, again.status) == (0, result.status)
    assert again.cost == pytest.approx(result.cost, rel=1e-14)
    np.testing.assert_array_equal(again.xs["x"], result.xs["x"])
    # What is asked now decides.
    assert problem.solve(warm=result, tolerance=1e-12).iterations > 0
    moved = problem.solve(warm=result, initial={"x": 0.9})
    assert moved.iterations > 0
    assert moved.xs["x"][0] == 0.9


# ---- points that are not finite --------------------------------------------------------------------------------------


def test_nothing_is_rolled_out_from_what_is_not_finite() -> None:
    import dataclasses

    result = lagging().solve(mesh_tolerance=np.inf)
    xs = dict(result.xs) | {"z": np.where(np.arange(21) == 3, np.nan, result.xs["z"])}
    broken = dataclasses.replace(result, phases=(dataclasses.replace(result.phases[0], xs=xs),))
    for read in ("mesh_error", "between_nodes", "dense", "extremes"):
        with pytest.raises(tx.TrajectoryError, match="'z' is not finite at node 3"):
            getattr(broken, read)
    assert "no finer rollout: 'z' is not finite at node 3" in broken.explain()
