"""Chunks of a sweep: which are computed, and on how many devices."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from test_sweep import COUNT, EXPECTED, MEMBERS, run
from twistax.monte_carlo.sweeps import _Plan


def test_a_sweep_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    compute = _Plan.compute

    def counted(plan: Any, k: int) -> Any:
        calls.append(k)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return compute(plan, k)

    monkeypatch.setattr(_Plan, "compute", counted)
    with pytest.raises(KeyboardInterrupt):
        tx.sweep(run, MEMBERS, chunk=4, directory=tmp_path)
    assert calls == [0, 1, 2, 3]
    (tmp_path / "000001.npz").write_bytes(b"cut short")
    (tmp_path / "000002.npz").write_bytes(b"")
    np.savez(tmp_path / "000004.npz", np.ones(4))
    np.savez(tmp_path / "000006.npz", np.ones((4, 3)), np.ones((3,)), np.ones(3, int))
    calls[:] = [-1] * 10
    found = tx.sweep(run, MEMBERS, chunk=4, directory=tmp_path)
    assert calls[10:] == [0, 1, 2, 3, 4, 5, 6, 7]  # the first one to compare
    np.testing.assert_allclose(found.values["sum"], EXPECTED["sum"], rtol=1e-14)
    calls[:] = [-1] * 10
    again = tx.sweep(run, MEMBERS, chunk=4, directory=tmp_path)
    assert calls[10:] == [0]
    np.testing.assert_array_equal(again.values["all"], found.values["all"])


def test_another_number_of_devices_goes_on(tmp_path: Path) -> None:
    """Chunks are those that were asked for, whatever batch the devices share."""
    plan = _Plan(run, None, MEMBERS, COUNT, 0, 4, jax.local_devices())
    assert plan.setup()["chunk"] == 4
    assert [len(plan.compute(k)[-1]) for k in range(plan.chunks)] == [4] * 7 + [1]
