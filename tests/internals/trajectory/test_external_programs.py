"""Programs for solvers of others: derivatives, and multipliers by charts."""

import jax.numpy as jnp
import numpy as np
import pytest
from program_derivatives import assert_derivatives
from trajectory_systems import fastest_turn

import twistax as tx
from twistax.jax_inside import in_double
from twistax.trajectory.adapters.program import NonlinearProgram


@pytest.fixture
def turning() -> tx.trajectory.Problem:
    return fastest_turn()


def stated(problem: tx.trajectory.Problem, copies: bool) -> tuple[NonlinearProgram, np.ndarray]:
    """The program about a point with motion, and unknowns away from it, where charts are curved."""
    rng = np.random.default_rng(0)
    Rs = np.stack([np.asarray(tx.SO3.exp(jnp.asarray(a))) for a in 0.4 * rng.normal(size=(9, 3))])
    guess = {"R": Rs, "w": rng.normal(size=(9, 3)), "M": rng.uniform(-1.0, 1.0, size=(8, 3))}
    with in_double():
        started = problem.started(guess, final_time_guess=3.0)
        staged = problem.core(1e-6, started.point, started.instance).staged
        program = NonlinearProgram(staged, started.instance, with_copies=copies)
        start = program.start(started.point, started.instance, None)
    return program, start.x + 0.3 * rng.normal(size=program.size)


@pytest.mark.parametrize("copies", [False, True])
def test_derivatives_of_the_program_are_those_of_its_values(turning: tx.trajectory.Problem, copies: bool) -> None:
    program, x = stated(turning, copies)
    border, rng = program._copies[:, 0], np.random.default_rng(1)
    dx, multipliers = rng.normal(size=program.size), rng.normal(size=program.count)
    x[border], dx[border] = 3.2, 0.7
    assert_derivatives(program, x, dx, multipliers)


def test_multipliers_follow_the_charts(turning: tx.trajectory.Problem) -> None:
    """What a change of a node costs is the same in the charts about where it was and about where it is."""
    program, x = stated(turning, False)
    rng, h = np.random.default_rng(3), 1e-6
    multipliers = rng.normal(size=program.count)
    found = program.reached(x, np.zeros(program.size), multipliers)
    z, v = program._at(x)
    bases, d = program._staged.point(z).xs["R"], program._staged.tangents(v * program._curved)[0]
    before = -multipliers[program._row_places[0]]
    for k in range(1, 9):
        e, y = rng.normal(size=3), before[6 * k - 6 : 6 * k - 3]
        ahead, back = (np.asarray(tx.SO3.retract(bases[k], d[k, :3] + s * h * e)) for s in (1.0, -1.0))
        moved = np.asarray(tx.SO3.log(back.T @ ahead)) / (2.0 * h)
        assert found.dynamics[k - 1, :3] @ moved == pytest.approx(y @ e, abs=1e-7)
