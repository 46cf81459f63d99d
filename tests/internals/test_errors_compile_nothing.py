"""An error of an integration compiles nothing."""

import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import pytest

import twistax as tx
from compilations import compilations
from twistax.integrators.loop import failures

RADAU = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)


def x_squared() -> tx.Dynamics:
    x, y = tx.State("x"), tx.State("y")
    return tx.compile(tx.System(rates={x: x * x, y: -y}))


def root() -> tx.Dynamics:
    x = tx.State("x")
    return tx.compile(tx.System(rates={x: tx.Sqrt(x)}))


def wall() -> tx.Dynamics:
    x = tx.State("x")
    return tx.compile(tx.System(rates={x: tx.Where(x >= 0.5, -1.0, 1.0)}))


def driven() -> tx.Dynamics:
    x, F = tx.State("x"), tx.Control("F")
    return tx.compile(tx.System(rates={x: F - x}))


def lost(t: jax.Array) -> dict[str, jax.Array]:
    return {"F": jnp.sqrt(0.75 - t)}


UP = {"x": 1.0, "y": 1.0}


CASES: dict[str, tuple[Callable[[], tx.Dynamics], dict[str, Any], dict[str, Any]]] = {
    "pole": (x_squared, UP, {"dt": 0.01}),
    "pole, saved": (x_squared, UP, {"dt": 0.01, "save_at": [0.5, 2.0]}),
    "pole, tolerances": (x_squared, UP, {"rtol": 1e-8}),
    "pole, Radau": (x_squared, UP, {"rtol": 1e-8, "method": RADAU, "save_at": [0.5, 2.0]}),
    "few steps": (x_squared, UP, {"rtol": 1e-8, "control": tx.StepControl(max_steps=4)}),
    "few steps, Radau": (x_squared, UP, {"rtol": 1e-8, "method": RADAU, "control": tx.StepControl(max_steps=4)}),
    "no rate": (root, {"x": -1.0}, {"dt": 0.1}),
    "no rate, Radau": (root, {"x": -1.0}, {"dt": 0.1, "method": RADAU}),
    "wall, Radau": (wall, {"x": 0.0}, {"steps": 7, "method": RADAU}),
    "control": (driven, {"x": 1.0}, {"dt": 0.1, "u": lost}),
}


@pytest.mark.parametrize("name", CASES)
def test_an_error_compiles_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make, start, options = CASES[name]
    seen, said = [], failures.failure

    def watched(*arguments: Any) -> tx.IntegrationError:
        with compilations() as programs:
            error = said(*arguments)
        seen.append(len(programs))
        return error

    monkeypatch.setattr(sys.modules["twistax.integrators.integrate"], "failure", watched)
    with compilations() as all_programs, pytest.raises(tx.IntegrationError):
        tx.integrate(make(), start, t1=2.0, **options)
    assert all_programs
    assert seen == [0]
