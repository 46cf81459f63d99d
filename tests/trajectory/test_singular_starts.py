"""Starts at which rates are not finite, against the exact solution of a power-limited start."""

from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.trajectory import Collocation, Phase, Problem, Status

NODES = 11
x, v, power = tx.State("x"), tx.State("v"), tx.Control("power", min=0.0, max=1.0)
AT_REST = {x: 0.0, v: 0.0}
LEAVES: dict[Any, Any] = {v: np.linspace(0.0, 1.0, NODES)}
GAUSS, RADAU = Collocation(tx.tableaus.GAUSS_LEGENDRE6), Collocation(tx.tableaus.RADAU_IIA5)


def farthest(rate: tx.Expr, **options: Any) -> Problem:
    """As far as possible in a second from rest, or where `options` say."""
    dynamics = tx.compile(tx.System(rates={x: v, v: rate}))
    chosen: dict[str, Any] = {"nodes": NODES, "final_time": 1.0, "initial": AT_REST}
    return Problem(dynamics, tx.Maximize(x), **chosen | options)


@pytest.mark.parametrize(("transcription", "error"), [(GAUSS, 1e-3), (RADAU, 2e-3)])
def test_collocation_starts_where_the_power_over_the_speed_is_infinite(transcription: Any, error: float) -> None:
    result = farthest(power / v, transcription=transcription, guess=LEAVES).solve()
    assert result.solved
    # v^2 / 2 = t, x = 2/3 sqrt(2) t^1.5; a root is no polynomial, so the first interval has an error.
    assert result.cost == pytest.approx(np.sqrt(8.0) / 3.0, rel=error)
    np.testing.assert_allclose(result.xs["v"][1:], np.sqrt(2.0 * result.ts[1:]), rtol=0.03)
    np.testing.assert_allclose(result.us["power"], 1.0, atol=1e-5)


def test_a_later_substep_does_not_begin_there() -> None:
    transcription = Collocation(tx.tableaus.GAUSS_LEGENDRE6, substeps=2)
    result = farthest(power / v, transcription=transcription, guess=LEAVES).solve()
    assert result.solved
    assert result.cost == pytest.approx(np.sqrt(8.0) / 3.0, rel=5e-4)


def test_a_speed_in_a_plane() -> None:
    w, force = tx.State("w", shape=(2,)), tx.Control("force", shape=(2,), min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={w: force / tx.linalg.Norm(w)}))
    guess = {w: np.stack([np.linspace(0.0, 1.0, NODES), np.linspace(0.0, 0.5, NODES)], axis=1)}
    ends: Any = {"initial": {w: [0.0, 0.0]}, "nodes": NODES, "final_time": 1.0, "guess": guess | {force: [0.5, 0.5]}}
    result = Problem(dynamics, tx.Maximize(w[0]), transcription=RADAU, **ends).solve()
    assert result.solved
    assert result.cost == pytest.approx(np.sqrt(2.0), rel=0.05)


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        (power / v, r"\(power / v\) is inf at node 0, where power is 0.5, v is 0\. For a singular start use .*RADAU"),
        (power - tx.Log(v), r"Log\(v\) is -inf at node 0, where v is 0\."),
        (power + v**0.5, r"the slope of \(v \*\* 0.5\) is not finite at node 0, where v is 0\."),
        (power + 1e-3 / (v * v), r"is inf at node 0, where v is 0\."),
    ],
)
def test_what_is_not_finite_is_named(rate: Any, words: str) -> None:
    result = farthest(rate).solve()
    assert result.status is Status.NON_FINITE
    assert pytest.approx(0.0) == result.xs["v"][0]
    assert len(result.message) < 400
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(result.message)


def test_later_phases_are_named() -> None:
    dynamics = tx.compile(tx.System(rates={x: v, v: power / (v - 1.0)}))
    first = Phase(dynamics, nodes=4, final_time=1.0, initial=AT_REST, name="first")
    last = Phase(dynamics, tx.Maximize(x), nodes=4, final_time=1.0, guess={v: 1.0}, name="last")
    message = Problem([first, last]).solve().message
    assert "last: (power / (v - 1.)) is inf at node 0, where power is 0.5, v is 1. " in message
