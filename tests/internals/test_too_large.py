"""Derivatives that are too large for one program of scalars."""

import functools
import re
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.scalar.graph import TooLarge
from twistax.system import jacobian

V, mass = tx.State("V", (6,)), tx.State("mass")


g, a = tx.State("g", group=tx.SE3), tx.State("a", group=tx.SO3)


F, spare = tx.Control("F", (6,)), tx.Control("spare")


def test_explain_leaves_out_a_jacobian_that_is_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """As that of thirty links; all else is told."""

    def refused(*arguments: Any) -> Any:
        raise TooLarge("the function takes more than 200000 scalars")

    monkeypatch.setattr(jacobian, "columns_of", refused)
    y = tx.State("y", shape=(2,))
    shared = functools.reduce(lambda e, _: e + tx.Sin(e), range(40), y)
    explanation = tx.compile(tx.System(rates={y: shared})).explain()
    assert explanation.operations[1] == {"add": 80, "sin": 80}
    assert explanation.patterns == {}
    assert "the Jacobian is left out: it takes too many scalars" in str(explanation)
    assert "the Jacobian is left out" in explanation.picture()
    assert re.search(r"nodes of the rates: \d\.\de\+\d+ as written", str(explanation))
    with pytest.raises(tx.ModelError, match="no pattern to plot"):
        explanation.plot(None)


@pytest.mark.parametrize("backend", [tx.JAX(), tx.Native()], ids=str)
def test_a_jacobian_that_is_too_large_goes_column_by_column(backend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same blocks, on groups too."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, p = tx.Control("F", shape=(2, 3)), tx.Parameter("p", shape=(3,), value=[1.0, 2.0, 3.0])
    push = tx.Concat(F[0] * p, g[:3, :3].T @ F[1] + tx.Sin(g[:3, 3]))
    system = tx.System(rates={g: V, V: push - tx.lie.AdjointDual(V, V)})
    rng = np.random.default_rng(0)
    x = {"g": np.asarray(tx.lie.se3.exp(rng.normal(size=6))), "V": rng.normal(size=6)}
    given = (0.0, x, {"F": rng.normal(size=(2, 3))}, {"p": rng.normal(size=3)})
    kinds = ("u", "x", "params")
    expected = tx.compile(system).jacobian(*given, wrt=kinds)

    def refused(*arguments: Any) -> Any:
        raise TooLarge("the function takes more than 200000 scalars")

    monkeypatch.setattr(jacobian, "columns_of", refused)
    found = tx.compile(system, backend=backend).jacobian(*given, wrt=kinds)
    assert list(found) == list(expected)
    for kind in kinds:
        np.testing.assert_allclose(found[kind], expected[kind], rtol=1e-13, atol=1e-13)


def test_a_jacobian_too_large_for_one_program_goes_column_by_column(monkeypatch: pytest.MonkeyPatch) -> None:
    """With controls and parameters or without any: there may be nothing of a kind."""
    from twistax.scalar.graph import TooLarge
    from twistax.system.functions import Functions

    def too_large(*_: Any) -> Any:
        raise TooLarge("too many scalars")

    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    c, w = tx.Control("c"), tx.Control("w", shape=(3,))
    pose = np.eye(4)
    pose[:3, 3] = 1.0, -2.0, 0.5
    x = {"g": pose, "V": np.arange(6.0)}
    drag = -V * tx.linalg.Norm(g[:3, 3])
    driven = tx.System({g: V, V: drag * tx.Parameter("p", value=2.0) + tx.Concat(w * c, w)})
    for system, u in ((tx.System({g: V, V: drag}), None), (driven, {"c": 0.5, "w": np.array([1.0, 2.0, 3.0])})):
        for wrt in (("x", "u", "params"), ("u",)):
            expected = tx.compile(system).jacobian(0.0, x, u, wrt=wrt)
            with monkeypatch.context() as patched:
                patched.setattr(Functions, "rate_jacobian", too_large)
                found = tx.compile(system).jacobian(0.0, x, u, wrt=wrt)
            for kind in wrt:
                np.testing.assert_allclose(found[kind], expected[kind], atol=1e-12)
