"""A solve reads from the disk what an earlier one had XLA compile; a file that is no such code is not used."""

from pathlib import Path

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.lowering import on_disk
from twistax.lowering.native import cache

pytest.importorskip("llvmlite")
pytest.importorskip("casadi")


def problem() -> tx.trajectory.Problem:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
    return tx.trajectory.Problem(dynamics, tx.Minimize(tx.Time()), nodes=5, final_time=(0.5, 6.0), **ends)


def loaded(own: tx.trajectory.Problem) -> bool:
    (solver,) = own._solvers.values()
    return isinstance(solver.steps._parts.stride, on_disk._Loaded)


def test_second_problem_is_read_from_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWISTAX_CACHE", str(tmp_path))
    one, other = problem(), problem()
    by = {"solver": tx.trajectory.IPOPT()}
    first, second = one.solve(**by), other.solve(**by)
    assert not loaded(one)
    assert loaded(other)
    assert first.cost == second.cost
    np.testing.assert_array_equal(first.us["u"], second.us["u"])
    # What passes the checksum, and is no code all the same.
    real = cache.kept
    monkeypatch.setattr(on_disk.cache, "kept", lambda key: real(key) and b"no code")
    third = problem()
    assert third.solve(**by).cost == first.cost
    assert not loaded(third)


def test_programs_that_drop_other_arguments_are_not_mixed_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their texts are equal: 2 a of (a, b), and 2 b."""
    monkeypatch.setenv("TWISTAX_CACHE", str(tmp_path))
    arguments = np.float64(1.0), np.float64(100.0)
    for keep in (False, True):
        for function, expected in ((lambda a, b: 2.0 * a, 2.0), (lambda a, b: 2.0 * b, 200.0)):
            program = jax.jit(function, keep_unused=keep).trace(*arguments)
            assert float(on_disk.compiled(program, program.lower(), 0)(*arguments)) == expected
