"""Compiled systems as CasADi functions: values, shapes, names, and derivatives by CasADi itself."""

from __future__ import annotations

import sys
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from export_systems import MASS, TABLE_POINTS, body, point, tables

import twistax as tx


@pytest.fixture
def casadi() -> Any:
    return pytest.importorskip("casadi", reason="casadi is not installed (extra twistax[casadi])")


def named(given: tuple[Any, ...]) -> dict[str, Any]:
    t, *dicts = given
    return {"t": t, **{name: np.asarray(v) for values in dicts for name, v in values.items()}}


def test_values_names_and_shapes(casadi: Any) -> None:
    dynamics, given = body(), point(3)
    function = dynamics.to_casadi(("rates", "outputs", "constraints"), name="body")
    assert function.name() == "body"
    assert function.name_in() == ["t", "g", "V", "wrench", "b.rake", "M", "gain"]
    assert function.name_out() == ["rate_g", "rate_V", "turn", "speed", "inequality", "equality"]
    assert function.size_in("g") == (4, 4)
    assert function.size_out("turn") == (3, 3)
    found = {name: np.array(value) for name, value in function(**named(given)).items()}
    t, x, u, params = given
    arrays = [{name: jnp.asarray(v) for name, v in values.items()} for values in (x, u, params)]
    expected: dict[str, Any] = {}
    for family in ("rates", "outputs", "constraints"):
        expected |= dynamics.functions.as_written(family, jnp.asarray(t), *arrays)
    for name, value in found.items():
        own = np.asarray(expected[name.removeprefix("rate_")])
        own = own if own.ndim == 2 else own.reshape(-1, 1)
        np.testing.assert_allclose(value, own, rtol=1e-12, atol=1e-13, err_msg=name)


def test_tables_of_vectors_and_in_maps(casadi: Any) -> None:
    own, (x, M) = tables(), (tx.State("x", shape=(3,)), tx.State("M", shape=(3, 2)))
    outputs = {f"o{k}": e for k, (e, _) in enumerate(own.values())}
    dynamics = tx.compile(tx.System({x: 0.0 * x, M: 0.0 * M}, outputs))
    function, fp = dynamics.to_casadi("outputs"), dynamics.parameters[0].value
    for at in TABLE_POINTS:
        found = function(t=0.0, x=at[0], M=at[1], fp=fp)
        for k, (name, (_, value)) in enumerate(own.items()):
            expected = np.atleast_2d(value(*at).T).T  # a vector is a column
            np.testing.assert_allclose(np.array(found[f"o{k}"]), expected, rtol=1e-12, atol=1e-13, err_msg=name)


def test_derivatives_of_casadi(casadi: Any) -> None:
    """By entries, brought to tangents, beside `Dynamics.jacobian`'s."""
    R, w, u = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Control("u", shape=(2,))
    J = np.array([1.0, 2.0, 3.5])
    torque = R.T @ np.array([0.2, -0.1, 0.4]) + tx.Concat(u, tx.Sin(u[0] * w[1])) - tx.linalg.Cross(w, J * w)
    dynamics = tx.compile(tx.System(rates={R: w, w: torque / J}))
    x = {"R": np.asarray(tx.lie.so3.exp(np.array([0.3, -1.0, 0.5]))), "w": np.array([0.4, -0.3, 1.2])}
    given = {**x, "u": np.array([0.7, -0.2])}

    function = dynamics.to_casadi()
    partials = function.jacobian()(**given, t=0.0, **{f"out_{name}": 0 for name in function.name_out()})
    by_R, by_w, by_u = (np.array(partials[f"jac_rate_w_{name}"]) for name in ("R", "w", "u"))
    expected = dynamics.jacobian(0.0, x, {"u": given["u"]})
    same = {"rtol": 1e-13, "atol": 1e-14}
    np.testing.assert_allclose(by_w, expected["x"][3:, 3:], **same)
    np.testing.assert_allclose(by_u, expected["u"][3:], **same)
    # The entries of a matrix count column by column in CasADi.
    along = np.stack([(x["R"] @ np.asarray(tx.lie.so3.hat(e))).T.reshape(-1) for e in np.eye(3)], axis=1)
    np.testing.assert_allclose(by_R @ along, expected["x"][3:, :3], **same)


def test_what_is_left_out_is_not_a_number(casadi: Any) -> None:
    dynamics, given = body(), named(point(3))
    function = dynamics.to_casadi()
    with_own = function(**{name: value for name, value in given.items() if name != "gain"})
    np.testing.assert_array_equal(with_own["rate_V"], function(**(given | {"gain": 1.5}))["rate_V"])
    without = function(**{name: value for name, value in given.items() if name != "M"})
    assert np.isnan(np.array(without["rate_V"])).all()
    assert np.isfinite(np.array(function(**(given | {"M": MASS}))["rate_V"])).all()


def test_derivatives_know_what_is_left_out_too(casadi: Any) -> None:
    """CasADi's own default, zero, would make a slope zero without a word."""
    x, k, v = tx.State("x", shape=(2,)), tx.Parameter("k", value=3.0), tx.Parameter("v", shape=(2,))
    slopes = tx.compile(tx.System(rates={x: k * v * x})).to_casadi().jacobian()
    np.testing.assert_array_equal(np.diag(np.array(slopes(x=[1, 2], v=[1, 1])["jac_rate_x_x"])), [3.0, 3.0])
    assert np.isnan(np.diag(np.array(slopes(x=[1, 2])["jac_rate_x_x"]))).all()


def test_structural_zeros_stay(casadi: Any) -> None:
    x = tx.State("x", shape=(3,))
    function = tx.compile(tx.System(rates={x: tx.Concat(0.0, x[0] * x[1], 2.0)})).to_casadi()
    assert function.sparsity_out("rate_x").nnz() == 2


def test_names_that_meet_are_refused(casadi: Any) -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}, outputs={"x": 2.0 * x}))
    assert dynamics.to_casadi().name_out() == ["rate_x"]
    with pytest.raises(tx.ModelError, match="two have the name 'x'"):
        dynamics.to_casadi("outputs")
    with pytest.raises(tx.ModelError, match="families among rates, outputs, constraints, corrections, got 'rate'"):
        dynamics.to_casadi("rate")
    with pytest.raises(tx.InputError, match=r"name expects letters, digits and single underscores, .* got 'two words'"):
        dynamics.to_casadi(name="two words")


def test_without_casadi_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    x = tx.State("x")
    with pytest.raises(tx.ModelError, match=r"pip install 'twistax\[casadi\]'"):
        tx.compile(tx.System(rates={x: -x})).to_casadi()
