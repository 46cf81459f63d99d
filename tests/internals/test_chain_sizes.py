"""How many scalar operations the dynamics of an arm take once zeros are gone and equal ones are one."""

from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import chain_models, forward_dynamics, inverse_dynamics, mass_matrix
from twistax.scalar.reader import scalarize


@pytest.mark.parametrize(("function", "most"), [(inverse_dynamics, 810), (forward_dynamics, 1402)])
def test_operations_of_the_panda(function: Any, most: int, unchecked: None) -> None:
    q, qd, x = (tx.State(name, shape=(7,)) for name in ("q", "qd", "x"))
    f = tx.lower(function(chain_models.panda(), q, qd, x))
    arrays = [jax.ShapeDtypeStruct((7,), np.float64)] * 3
    program = scalarize(lambda q, qd, x: [f(0.0, {"q": q, "qd": qd, "x": x})], *arrays)
    assert set(program.counts()) <= {"add", "sub", "mul", "div", "neg", "sin", "cos"}
    assert program.counts()["sin"] == program.counts()["cos"] == 6  # the first joint turns about the vertical
    assert program.operations <= most


def test_operations_of_the_mass_matrix(unchecked: None) -> None:
    q = tx.State("q", shape=(7,))
    f = tx.lower(mass_matrix(chain_models.panda(), q))
    program = scalarize(lambda q: [f(0.0, {"q": q})], jax.ShapeDtypeStruct((7,), np.float64))
    assert program.counts()["sin"] == program.counts()["cos"] == 6
    # Differences stand as x - y and as y - x: where they cancel neither is the other's negative, by the sign of zero.
    assert program.operations <= 491
