"""Derivatives of several phases as one problem."""

import functools
from typing import Any

import numpy as np
import pytest
from program_derivatives import assert_derivatives

import twistax as tx
from twistax.jax_inside import in_double
from twistax.trajectory import Phase, Problem
from twistax.trajectory.adapters.program import NonlinearProgram


@functools.cache
def rich() -> Problem:
    """Phases of other sizes, with time, a free parameter, a jump of a rotation, and an entry that starts free."""
    R, w, z = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.State("z")
    u, gain, t = tx.Control("u", shape=(3,)), tx.Parameter("gain", value=0.7), tx.Time()
    turning = tx.compile(
        tx.System(rates={R: w, w: u + tx.Sin(3.0 * t) * R[:, 0]}, constraints={"power": u @ w <= 9.0 + t * gain})
    )
    alone = tx.compile(tx.System(rates={z: 0.3 * z, R: gain * t * np.array([1.0, 2.0, -1.0]) + z * np.ones(3)}))
    jump = R @ tx.lie.SO3Exp(gain * w)
    once: dict[str, Any] = {"final_time": (0.05, 3.0)}
    return Problem(
        [
            Phase(turning, tx.Minimize(t * w[0] ** 2, running=u @ u), nodes=4, final=[w[1] <= 3.0], **once),
            Phase(alone, tx.Minimize(gain * t**2 + z * R[0, 1]), nodes=3, final=[R[0, 2] <= 9.0], **once),
        ],
        links=[{R: jump}],
        free={gain: (0.1, 5.0)},
    )


@pytest.mark.parametrize("seed", range(2))
def test_all_derivatives_of_joined_phases(seed: int) -> None:
    """Of all that solvers get: the objective, the dynamics, the jumps of joins, the rows of all phases."""
    problem, rng = rich(), np.random.default_rng(seed)
    with in_double():
        started = problem.started()
        staged = problem.core(1e-6, started.point, started.instance).staged
        program = NonlinearProgram(staged, started.instance, with_copies=False)
        x = program.start(started.point, started.instance, None).x
        border = program._copies[0]
        x += np.where(np.isin(np.arange(program.size), border), 0.0, 0.4 * rng.normal(size=program.size))
        x[border] = [0.12, 0.1, 0.7]
        assert_derivatives(program, x, rng.normal(size=program.size), rng.normal(size=program.count))
