"""Comparisons as they are written: at a tie, and where a side is NaN, on every path."""

import functools
import pickle
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx

x, y = tx.State("x", (5,)), tx.State("y", (5,))
NAN = float("nan")
X, Y = np.array([1.0, 1.0, 2.0, NAN, NAN]), np.array([2.0, 1.0, 1.0, 1.0, NAN])
#: The condition, and where it holds: below, at a tie, above, with one NaN, with two.
HOLDS: dict[str, tuple[tx.Expr, list[int]]] = {
    "less": (x < y, [1, 0, 0, 0, 0]),
    "greater": (x > y, [0, 0, 1, 0, 0]),
    "at most": (x <= y, [1, 1, 0, 0, 0]),
    "not less": (~(x < y), [0, 1, 1, 1, 1]),
    "not at most": (~(x <= y), [0, 0, 1, 1, 1]),
    "not equal": (~(x == y), [1, 0, 1, 1, 1]),
    "not not": (~~(x < y), [1, 0, 0, 0, 0]),
    "of NumPy": (np.logical_not(np.greater(x, y)), [1, 1, 0, 1, 1]),
    "negated": (-x < -y, [0, 0, 1, 0, 0]),
}
WHOLE = {"none": ~tx.Any(x < y, x >= y), "some": tx.Any(~(x <= y)), "all": tx.All(~(x < y), y < 3.0)}


def system() -> tx.System:
    outputs = {name: tx.Where(condition, 1.0, 0.0) for name, (condition, _) in HOLDS.items()}
    outputs |= {f"{name} of all": tx.Cond(condition, 1.0, 0.0) for name, condition in WHOLE.items()}
    return tx.System(rates={x: 0.0 * x, y: 0.0 * y}, outputs=outputs)


def check(found: Mapping[str, Any]) -> None:
    for name, (_, holds) in HOLDS.items():
        np.testing.assert_array_equal(np.ravel(found[name]), holds, err_msg=name)
    for name, holds in (("none", 0), ("some", 1), ("all", 0)):
        np.testing.assert_array_equal(np.ravel(found[f"{name} of all"]), [holds], err_msg=name)


@pytest.mark.parametrize("backend", [tx.JAX(), tx.XLA(), tx.Native()], ids=str)
def test_ties_and_nan_on_arrays_and_scalars(backend: Any) -> None:
    dynamics = tx.compile(pickle.loads(pickle.dumps(system())), backend=backend)
    check(dynamics.outputs(0.0, {"x": X, "y": Y}))
    batch = jax.vmap(lambda x: dynamics.outputs(0.0, x))({"x": np.tile(X, (9, 1)), "y": np.tile(Y, (9, 1))})
    check({name: value[4] for name, value in batch.items()})


def test_ties_and_nan_in_casadi() -> None:
    pytest.importorskip("casadi")
    function = tx.compile(system()).to_casadi("outputs")
    found = function(0.0, X, Y)
    check({function.name_out(k): np.asarray(value) for k, value in enumerate(found)})


def test_how_they_print() -> None:
    s = tx.State("s")
    assert repr(~(s > 1.0)) == "~(1. < s)"
    assert (~(s < 1.0)).latex() == r"\lnot \left(s < 1\right)"
    assert repr(tx.Where(~(s < 1.0), s, 0.0).canonicalize()) == "Where(s < 1., 0., s)"


@functools.cache
def line() -> tx.Dynamics:
    s, c = tx.State("s"), tx.State("c")
    return tx.compile(tx.System(rates={s: 1.0 + 0.0 * s, c: tx.Where(s > 0.5, 1.0, 0.0)}))


@pytest.mark.parametrize("event", ["~(s < 0.75)", "All(s > 0.25, s >= 0.75)", "Any(s > 0.75, s < -1)"])
def test_an_event_of_a_condition_is_where_it_begins_to_hold(event: str) -> None:
    s = tx.State("s")
    condition = {
        "~(s < 0.75)": ~(s < 0.75),
        "All(s > 0.25, s >= 0.75)": tx.All(s > 0.25, s >= 0.75),
        "Any(s > 0.75, s < -1)": tx.Any(s > 0.75, tx.Stack(s, s) < -1.0),
    }[event]
    found = tx.integrate(line(), {"s": 0.0, "c": 0.0}, t1=1.0, dt=0.125, event=tx.Event(condition))
    np.testing.assert_allclose(found.ts[-1], 0.75, rtol=1e-12)
