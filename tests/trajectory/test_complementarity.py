"""Contact as complementarity constraints: against time steps, against CasADi's IPOPT, and what is left of products."""

import functools
import logging
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.errors import ModelError, ShapeError
from twistax.trajectory import IPOPT, Collocation, Contact, Friction, Problem, Status, Strategy

GRAVITY, MASS, FOOT, NODES = 9.81, 2.0, 0.3, 21
EULER: Any = Collocation(tx.tableaus.RADAU_IIA1)
z, vz, x, v = (tx.State(name) for name in ("z", "vz", "x", "v"))
N, f, u = tx.Control("N", min=0.0), tx.Control("f"), tx.Control("u", min=-60.0, max=60.0)


@functools.cache
def hopper(transcription: Any = EULER) -> Problem:
    """A mass x on a leg over a foot z: it hops once, with the least square of the leg's force."""
    rates: Any = {x: v, z: vz, v: u / MASS - GRAVITY, vz: (N - u) / FOOT - GRAVITY}
    reach = {"long": x - z <= 0.6, "short": x - z >= 0.2}
    system = tx.System(rates=rates, constraints={"toe": Contact(z, N), **reach})
    rest = {x: 0.4, z: 0.0, v: 0.0, vz: 0.0}
    high, objective = {NODES // 2: [z >= 0.1]}, tx.Minimize(running=1e-3 * u * u)
    ends = {"initial": rest, "final": rest, "at": high}
    return Problem(
        tx.compile(system), objective, nodes=NODES, final_time=1.0, transcription=transcription, guess={N: 20.0}, **ends
    )


@functools.cache
def hop() -> Any:
    return hopper().solve(mesh_tolerance=np.inf)


def test_without_controls_it_is_the_time_stepping_of_a_block_that_falls_and_slides() -> None:
    mu, steps = 0.3, 20
    system = tx.System(
        rates={x: v, z: vz, v: f, vz: N - GRAVITY}, constraints=[Contact(z, N, Friction(mu, force=f, velocity=v))]
    )
    start = {x: 0.0, v: 1.0, z: 0.2, vz: 0.0}
    problem = Problem(
        tx.compile(system), tx.Minimize(0.0 * x), nodes=steps + 1, final_time=1.0, initial=start, transcription=EULER
    )
    result = problem.solve(mesh_tolerance=np.inf, guess={N: 10.0})
    # Stewart and Trinkle's step, of which each part has one unknown here.
    h, (px, pv, pz, pw) = 1.0 / steps, (0.0, 1.0, 0.2, 0.0)
    for k in range(steps):
        n = max(0.0, -(pz / h + pw - h * GRAVITY) / h)
        pw, pv = pw + h * (n - GRAVITY), pv + h * float(np.clip(-pv / h, -mu * n, mu * n))
        px, pz = px + h * pv, pz + h * pw
        there = [result.xs[name][k + 1] for name in ("x", "v", "z", "vz")]
        np.testing.assert_allclose(there, [px, pv, pz, pw], atol=2e-4)
    assert min(result.complementarity.values()) < 1e-9  # the slip that does not occur
    assert result.solved
    assert abs(pv) < 1e-12
    assert max(result.complementarity.values()) < 1e-4


def test_a_hop_has_a_gap_or_a_force() -> None:
    result = hop()
    assert result.solved, result.message
    assert result.iterations < 600  # at rest at the end, the gap of a node has no interior
    gap, force = result.xs["z"][1:], result.us["N"]
    assert (gap * force).max() <= 1e-4
    assert gap.min() > -1e-6
    assert force.min() > -1e-6
    assert (gap > 0.01).any()
    assert (force > 10.0).any()
    (left,) = result.complementarity.values()
    np.testing.assert_allclose(left, (gap * force).max(), atol=1e-6)
    assert f"is left is {left:.2g}" in result.message
    assert "complementarity" in result.explain()


def test_the_hop_is_an_optimum_of_ipopt_by_a_transcription_by_hand() -> None:
    casadi = pytest.importorskip("casadi")
    result, h = hop(), 1.0 / (NODES - 1)
    opti = casadi.Opti()
    states, leg, force = opti.variable(4, NODES), opti.variable(NODES - 1), opti.variable(NODES - 1)
    for k in range(NODES - 1):
        a, b = states[:, k], states[:, k + 1]
        up, down = leg[k] / MASS - GRAVITY, (force[k] - leg[k]) / FOOT - GRAVITY
        opti.subject_to(b == a + h * casadi.vertcat(b[2], b[3], up, down))
        opti.subject_to(b[1] * force[k] <= result.params["contact relaxation"])
    opti.subject_to(opti.bounded(0.2, (states[0, :] - states[1, :]).T, 0.6))
    opti.subject_to(states[1, 1:].T >= 0.0)
    opti.subject_to(force >= 0.0)
    opti.subject_to(opti.bounded(-60.0, leg, 60.0))
    opti.subject_to(states[1, NODES // 2] >= 0.1)
    for end in (0, NODES - 1):
        opti.subject_to(states[:, end] == casadi.DM([0.4, 0.0, 0.0, 0.0]))
    opti.minimize(h * 1e-3 * casadi.sumsqr(leg))
    opti.set_initial(states, np.stack([result.xs[name] for name in ("x", "z", "v", "vz")]))
    opti.set_initial(leg, result.us["u"])
    opti.set_initial(force, result.us["N"])
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-9})
    np.testing.assert_allclose(opti.solve().value(opti.f), result.cost, rtol=2e-4)


def test_ipopt_comes_to_the_same_hop_by_the_same_relaxations() -> None:
    pytest.importorskip("casadi")
    other = hopper().solve(mesh_tolerance=np.inf, solver=IPOPT())
    assert other.solved
    np.testing.assert_allclose(other.cost, hop().cost, rtol=0.03)  # other patterns of contacts are as near
    kept = hopper().solve(warm=hop(), mesh_tolerance=np.inf, solver=IPOPT())
    np.testing.assert_allclose(kept.cost, hop().cost, rtol=1e-6)


def test_each_guess_has_its_own_relaxations() -> None:
    best = hopper().solve(mesh_tolerance=np.inf, guesses=4)
    assert best.solved, best.message
    assert best.cost < 0.99 * hop().cost  # another contact sequence
    assert len(best.tries) >= 4


def test_what_the_fixed_values_alone_violate_is_not_solved_again_with_smaller_relaxations() -> None:
    result = hopper().solve(initial={x: 0.3, z: -0.1, v: 0.0, vz: 0.0})
    assert result.status is Status.INFEASIBLE
    assert result.message.endswith(
        "'toe: gap' at node 0 is violated by 0.1, by the fixed initial and final values alone."
    )
    assert result.iterations <= 1


def test_the_message_says_where_impacts_are_not_inelastic() -> None:
    system = tx.System(rates={z: vz, vz: N - GRAVITY}, constraints={"toe": Contact(z, N)})
    for transcription, says in ((EULER, False), (Collocation(tx.tableaus.RADAU_IIA3), True)):
        rest = {"initial": {z: 0.0, vz: 0.0}, "transcription": transcription}
        problem = Problem(
            tx.compile(system), tx.Minimize(running=N * N), nodes=4, final_time=1.0, guess={N: 9.0}, **rest
        )
        assert ("impacts are not inelastic" in problem.solve(mesh_tolerance=np.inf).message) is says


def test_relaxations_are_numbers_and_compile_nothing(caplog: pytest.LogCaptureFixture) -> None:
    hop()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        loose = hopper().solve(params={"contact relaxation": 0.4}, mesh_tolerance=np.inf)
        at_once = hopper().solve(warm=loose, params={"contact relaxation": 0.3}, mesh_tolerance=np.inf)
    assert not [record for record in caplog.records if "Compiling" in record.getMessage()]
    assert loose.solved
    assert loose.cost < hop().cost
    assert at_once.solved
    assert max(at_once.complementarity.values()) < 0.3001
    assert at_once.cost > loose.cost
    assert "relaxations" not in at_once.message


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_relaxation_that_is_not_positive_is_refused_by_solve(value: float) -> None:
    with pytest.raises(ModelError, match="relaxation 'contact relaxation' must be a positive number"):
        hopper().solve(params={"contact relaxation": value})


def test_a_name_that_a_contact_takes_is_refused() -> None:
    with pytest.raises(ModelError, match="'toe: gap' is a part of 'toe'"):
        tx.System(rates={z: vz, vz: N}, constraints={"toe": Contact(z, N), "toe: gap": z >= 0.1})


def test_one_solve_with_the_last_relaxation_where_the_strategy_is_left_out() -> None:
    strategies = [it for it in Strategy if it is not Strategy.LOWERED_RELAXATIONS]
    counts = list[int]()
    hopper().solve(strategies=strategies, mesh_tolerance=np.inf, callback=lambda k, *_: counts.append(k))
    assert counts.count(0) >= 1
    result = hopper().solve(strategies=(), mesh_tolerance=np.inf, max_iterations=5)
    assert result.iterations <= 5
    assert "relaxations" not in result.message


def test_in_space_friction_opposes_slip_and_may_be_less_where_nothing_slips() -> None:
    pull, way, speed = tx.Control("pull", (2,)), tx.State("way", (2,)), tx.State("speed", (2,))
    force = tx.Control("force", (2,))
    ground = Contact(z, N, Friction(0.5, force=force, velocity=speed))
    rates: Any = {way: speed, speed: force + pull, z: vz, vz: N - GRAVITY}
    problem = Problem(
        tx.compile(tx.System(rates=rates, constraints={"ground": ground})),
        tx.Minimize(running=pull @ pull),
        nodes=11,
        final_time=1.0,
        initial={way: [0.0, 0.0], speed: [0.0, 0.0], z: 0.0, vz: 0.0},
        final=[way == np.array([0.3, 0.4])],
        transcription=EULER,
        guess={N: GRAVITY, pull: [3.0, 4.0]},
    )
    result = problem.solve(mesh_tolerance=np.inf)
    assert result.solved, result.message
    friction, slip = result.us["force"], result.xs["speed"][1:]
    fast = np.linalg.norm(slip, axis=1) > 1e-2
    assert fast.sum() >= 3
    sizes = np.linalg.norm(friction, axis=1)
    assert (sizes <= 0.5 * result.us["N"] + 1e-5).all()
    cosines = (friction * slip).sum(axis=1)[fast] / (sizes * np.linalg.norm(slip, axis=1))[fast]
    assert (cosines < -0.92).all()


def test_a_contact_within_other_systems_stays_one() -> None:
    system = tx.System(rates={z: vz, vz: N - GRAVITY}, constraints={"toe": Contact(z, N)}).renamed("left ")
    assert list(system.constraints) == ["left toe: gap", "left toe: complementarity"]
    ends = {"initial": {"left z": 0.0, "left vz": 0.0}}
    problem = Problem(tx.compile(system), tx.Minimize(tx.Time()), nodes=4, final_time=1.0, transcription=EULER, **ends)
    result = problem.solve(mesh_tolerance=np.inf)
    assert list(result.complementarity) == ["left toe: complementarity"]
    pair = tx.repeat(tx.System(rates={z: vz, vz: N - GRAVITY}, constraints={"toe": Contact(z, N)}), 2)
    falling = {"initial": {"z": np.array([0.0, 0.2]), "vz": np.zeros(2)}, "guess": {"N": np.full(2, 10.0)}}
    both = Problem(tx.compile(pair), tx.Minimize(tx.Time()), nodes=11, final_time=1.0, transcription=EULER, **falling)
    result = both.solve(mesh_tolerance=np.inf)
    assert result.solved, result.message
    assert 0.0 < max(result.complementarity.values()) < 1e-4
    np.testing.assert_allclose(result.xs["z"][-1], 0.0, atol=1e-4)


BAD: list[Any] = [
    (lambda: Contact(tx.State("p", (3,)), N), ShapeError, r"Contact expects a scalar gap, got shape \(3,\)"),
    (lambda: Contact(z, N, 0.5), ModelError, "expects a tx.trajectory.Friction"),
    (lambda: Contact(z, N, relaxation=0.0), ModelError, "relaxation must be a positive number, got 0.0"),
    (lambda: Friction(-0.1, force=f, velocity=v), ModelError, "coefficient must be a number not below zero"),
    (lambda: Friction(0.1, force=f, velocity=tx.State("w", (2,))), ShapeError, r"got \(\) and \(2,\)"),
]


@pytest.mark.parametrize(("make", "error", "text"), BAD, ids=range(len(BAD)))
def test_bad_contacts_are_refused(make: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        make()
