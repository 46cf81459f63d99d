"""`tx.lower`: one signature, values, precision, purity, and every transformation of JAX."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

x, m = tx.State("x", (3,)), tx.State("m", (2, 3))
g = tx.State("g", group=tx.SE3)
u, p, t = tx.Control("u"), tx.Parameter("p", value=[1.0, 2.0, 3.0]), tx.Time()
CURVE = tx.Sin(u * x) * p + t
X, M = np.array([0.3, -1.0, 2.0]), np.arange(6.0).reshape(2, 3)
ARGUMENTS = (0.5, {"x": X}, {"u": 2.0})
WANTED = np.sin(2.0 * X) * np.array([1.0, 2.0, 3.0]) + 0.5


def test_value_of_one_expression() -> None:
    np.testing.assert_allclose(tx.lower(CURVE)(*ARGUMENTS), WANTED, rtol=1e-15)


def test_dicts_tuples_and_lists_keep_their_form() -> None:
    function = tx.lower({"b": (CURVE, u), "a": [m @ x, 2.0, np.ones(2)]})
    found = function(0.5, {"x": X, "m": M}, {"u": 2.0})
    assert jax.tree.structure(found) == jax.tree.structure({"a": [0, 0, 0], "b": (0, 0)})
    np.testing.assert_allclose(found["b"][0], WANTED, rtol=1e-15)
    np.testing.assert_allclose(found["a"][0], M @ X, rtol=1e-15)
    assert float(found["a"][1]) == 2.0


def test_matrix_and_pose_states() -> None:
    pose = tx.pose(position=[1.0, 2.0, 3.0], euler=[0.1, 0.2, 0.3])
    found = tx.lower((m.T, g[:3, :3] @ x + g[:3, 3]))(0.0, {"m": M, "g": pose, "x": X})
    np.testing.assert_array_equal(found[0], M.T)
    np.testing.assert_allclose(found[1], pose[:3, :3] @ X + pose[:3, 3], rtol=1e-15)


def test_every_transformation_applies() -> None:
    """The cubic f(x) = sum p_i x_i^3 has known derivatives."""
    function = tx.lower(tx.linalg.Sum(p * x**3))

    def f(z: Any) -> jax.Array:
        return function(0.0, {"x": z})

    def everything(z: jax.Array) -> dict[str, jax.Array]:
        return {
            "value": f(z),
            "grad": jax.grad(f)(z),
            "jacfwd": jax.jacfwd(f)(z),
            "jacrev": jax.jacrev(f)(z),
            "hessian": jax.hessian(f)(z),
            "vmap": jax.vmap(f)(jnp.stack([z, 2.0 * z])),
            "scan": jax.lax.scan(lambda carry, _: (carry + f(z), None), jnp.zeros(()), None, length=3)[0],
        }

    found, P = jax.jit(everything)(X), np.array([1.0, 2.0, 3.0])
    value = np.sum(P * X**3)
    for name in ("grad", "jacfwd", "jacrev"):
        np.testing.assert_allclose(found[name], 3.0 * P * X**2, rtol=1e-14)
    np.testing.assert_allclose(found["hessian"], np.diag(6.0 * P * X), rtol=1e-14)
    np.testing.assert_allclose(found["vmap"], [value, 8.0 * value], rtol=1e-14)
    np.testing.assert_allclose(found["scan"], 3.0 * value, rtol=1e-14)
    np.testing.assert_allclose(found["value"], f(X), rtol=1e-14)


def test_derivatives_reach_time_controls_and_parameters() -> None:
    function = tx.lower(tx.linalg.Sum(CURVE))
    values = (0.5, {"x": X}, {"u": 2.0}, {"p": np.ones(3)})
    by_time, by_state, by_control, by_parameter = jax.grad(function, argnums=(0, 1, 2, 3))(*values)
    assert float(by_time) == pytest.approx(3.0)
    np.testing.assert_allclose(by_state["x"], 2.0 * np.cos(2.0 * X), rtol=1e-14)
    np.testing.assert_allclose(by_control["u"], np.sum(X * np.cos(2.0 * X)), rtol=1e-14)
    np.testing.assert_allclose(by_parameter["p"], np.sin(2.0 * X), rtol=1e-14)


# ---- precision -----------------------------------------------------------------------------------------------------

F32, F64 = np.float32, np.float64


@pytest.mark.parametrize(
    ("time", "state", "control", "parameter", "wanted"),
    [
        (0.5, F64(1.0), F64(1.0), F64(1.0), F64),
        (0.5, F32(1.0), 1.0, 1.0, F32),
        (F64(0.5), F32(1.0), F64(1.0), F64(1.0), F32),
        (F32(0.5), F64(1.0), F32(1.0), F32(1.0), F64),
        (1, 1, 1, 1, F64),
        (0.5, 1.0, F32(1.0), F64(1.0), F32),
        (0.5, 1.0, 1.0, F32(1.0), F32),
        (F32(0.5), 1.0, 1.0, 1.0, F32),
        (0.5, 1.0, 1.0, 1.0, F64),
    ],
)
def test_precision_is_that_of_the_state(time: Any, state: Any, control: Any, parameter: Any, wanted: Any) -> None:
    """x comes first, then u, params and t; numbers without a precision follow, constants and defaults always do."""
    y, c = tx.State("y"), tx.Parameter("c", value=0.1)
    function = tx.lower((y * u + t + np.pi, tx.Parameter("d", value=0.3) * c, tx.Constant(np.ones(2))))
    values = function(time, {"y": state}, {"u": control}, {"c": parameter})
    assert {value.dtype for value in values} == {np.dtype(wanted)}
    assert not any(value.weak_type for value in values)


def test_lists_count_as_numbers() -> None:
    assert tx.lower(x + u)(0.0, {"x": [1, 2, 3]}, {"u": 0.5}).dtype == F64


def test_constants_keep_their_digits_in_double_and_are_rounded_once_in_single() -> None:
    third = tx.lower(tx.Constant(1.0) / 3.0 * u)
    assert float(third(0.0, {}, {"u": F64(1.0)})) == 1.0 / 3.0
    assert third(0.0, {}, {"u": F32(1.0)}) == F32(1.0 / 3.0)


# ---- purity and size -----------------------------------------------------------------------------------------------


def test_the_function_is_pure() -> None:
    """The same arguments give the same value; the arguments and the tree stay as they were; no value is kept."""
    values = {"x": X.copy()}
    function, key = tx.lower(CURVE), CURVE.key()
    first = function(0.5, values, {"u": 2.0})
    function(9.0, {"x": 7.0 * X}, {"u": -1.0}, {"p": np.zeros(3)})
    np.testing.assert_array_equal(function(0.5, values, {"u": 2.0}), first)
    np.testing.assert_array_equal(values["x"], X)
    assert CURVE.key() == key
    with jax.checking_leaks():
        jax.jit(function)(0.5, values, {"u": 2.0})
        function(0.5, values, {"u": 2.0})


def test_a_tree_may_be_lowered_inside_of_a_traced_function() -> None:
    found = jax.jit(lambda z: tx.lower(2.0 * x + np.ones(3))(0.0, {"x": z}))(X)
    np.testing.assert_allclose(found, 2.0 * X + 1.0)


def test_equal_structures_are_computed_once_whatever_objects_they_are() -> None:
    parts = [tx.Sin(tx.State("x", (3,)) * 2.0) for _ in range(5)]
    names = [e.primitive.name for e in jax.make_jaxpr(tx.lower(parts))(0.0, {"x": X}).jaxpr.eqns]
    assert names.count("sin") == 1


# ---- mistakes ------------------------------------------------------------------------------------------------------


def test_a_parameter_without_a_value() -> None:
    mass = tx.Parameter("mass")
    with pytest.raises(
        tx.InputError, match=r"(?s)Parameter 'mass' has no value.*params=\{'mass': \.\.\.\} of shape \(\)"
    ):
        tx.lower(mass * x)(0.0, {"x": X})
    np.testing.assert_allclose(tx.lower(mass * x)(0.0, {"x": X}, params={"mass": 2.0}), 2.0 * X)


def test_nothing_to_lower() -> None:
    for nothing in ((), {}, []):
        with pytest.raises(tx.ModelError, match="there is no expression in"):
            tx.lower(nothing)


def test_a_shape_that_does_not_fit_is_found_at_once() -> None:
    with pytest.raises(tx.ShapeError, match="MatMul incompatible shapes"):
        tx.lower(m @ m)


@pytest.mark.parametrize(
    "other", [tx.State("x", (2,)), tx.State("x"), tx.State("x", (3, 3))], ids=lambda leaf: str(leaf.shape)
)
def test_two_states_of_one_name(other: tx.State) -> None:
    with pytest.raises(tx.ModelError, match=r"two States are named 'x' and differ"):
        tx.lower((x, other))


def test_two_parameters_of_one_name_and_different_values() -> None:
    with pytest.raises(tx.ModelError, match=r"two Parameters are named 'p'"):
        tx.lower(p + tx.Parameter("p", value=np.zeros(3)))


def test_a_state_a_control_and_a_parameter_may_share_a_name() -> None:
    """They come in different dicts."""
    three = tx.State("y") + 10.0 * tx.Control("y") + 100.0 * tx.Parameter("y")
    assert float(tx.lower(three)(0.0, {"y": 1.0}, {"y": 2.0}, {"y": 3.0})) == 321.0


def test_leaves_may_be_called_like_time_or_a_constant() -> None:
    odd = tx.State("t") + 2.0 * tx.State("constant") + t
    assert float(tx.lower(odd)(5.0, {"t": 1.0, "constant": 10.0})) == 26.0


def test_chains_that_end_the_process_in_xla_are_refused_where_they_are_compiled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from twistax.scalar import backends

    monkeypatch.setattr(backends, "_LONGEST_CHAIN", 1500)
    s = tx.State("s")
    e: tx.Expr = s
    for k in range(1501):
        e = tx.Sin(e) if k % 2 else tx.Cos(e)
    function = tx.lower(e)
    with pytest.raises(tx.ModelError, match=r"(?s)chain of more than 1,500.*XLA would crash.*fix: .*lax\.scan"):
        jax.jit(lambda s: function(0.0, {"s": s}))(0.3)
    shorter = tx.lower(e.children()[0])
    expected = 0.3
    for k in range(1500):
        expected = np.sin(expected) if k % 2 else np.cos(expected)
    np.testing.assert_allclose(jax.jit(lambda s: shorter(0.0, {"s": s}))(0.3), expected, rtol=1e-12)
    np.testing.assert_allclose(function(0.0, {"s": 0.3}), np.cos(expected), rtol=1e-12)


def test_a_large_expression_is_compiled_by_itself() -> None:
    """Its nodes run once, when it is traced; a small one runs node by node in each call."""
    calls = []

    def counted(y: jax.Array) -> jax.Array:
        calls.append(None)
        return jnp.sin(y)

    def runs(length: int) -> int:
        x = tx.State("x")
        expr = tx.Function(counted, ())(x)
        for k in range(length):
            expr = tx.Cos(expr) + x * float(k)
        function = tx.lower(expr)
        function(0.0, {"x": 0.3})
        first = len(calls)
        function(0.0, {"x": 0.4})
        return len(calls) - first

    assert runs(2) == 1
    assert runs(150) == 0
