"""What is compiled is kept for a number of uses."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import twistax as tx
from twistax.system.functions import Cache


def test_what_was_used_longest_ago_is_dropped() -> None:
    kept, made = Cache(2), []

    def get(key: str) -> str:
        return kept.get(key, lambda: made.append(key) or key)

    assert [get(key) for key in ("a", "b", "a", "c", "a", "b")] == ["a", "b", "a", "c", "a", "b"]
    assert made == ["a", "b", "c", "b"]
    assert kept.values() == ["a", "b"]


def test_none_is_kept_too() -> None:
    kept, made = Cache(2), []
    for _ in range(2):
        assert kept.get("a", lambda: made.append("a")) is None
    assert made == ["a"]


@pytest.mark.skipif(importlib.util.find_spec("llvmlite") is None, reason="native kernels need llvmlite")
def test_kernels_of_integrations_are_bounded() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}))
    dynamics.functions.steps = steps = Cache(2)
    for dtmax in (1.0, 1.1, 1.2, 1.0):
        control = tx.StepControl(dtmax=dtmax)
        sol = tx.integrate(dynamics, {"x": 1.0}, t1=0.5, rtol=1e-8, atol=1e-8, control=control)
        np.testing.assert_allclose(sol.xs["x"], np.exp(-0.5), rtol=1e-7)
    assert len(steps.values()) == 2
