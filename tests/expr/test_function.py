"""`tx.Function`: functions of arrays as nodes, and pytrees as parameters."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

x, u = tx.State("x", shape=(2,)), tx.Control("u", shape=(2,))
TREE = {"A": np.array([[0.1, 0.2], [-0.3, 0.1]]), "b": np.array([0.1, -0.2]), "steps": 3}
AT = {"x": np.array([0.3, -0.7])}


def affine(p: Any, y: jax.Array) -> jax.Array:
    return jnp.tanh(p["A"] @ y + p["b"]) * p["steps"]


def small_net() -> eqx.nn.MLP:
    return eqx.nn.MLP(2, 2, 4, 1, activation=jnp.tanh, key=jax.random.key(0))


def test_values_and_shapes() -> None:
    expr = tx.Function(lambda a, b: jnp.outer(a, b) @ b, shape=2, name="turn")(x, u)
    assert expr.shape == (2,)
    assert repr(expr) == "turn(x, u)"
    force = np.array([2.0, 3.0])
    np.testing.assert_allclose(tx.lower(expr)(0.0, AT, {"u": force}), AT["x"] * (force @ force), rtol=1e-14)


def test_equal_functions_are_one_node_and_others_are_not() -> None:
    def f(y: jax.Array) -> jax.Array:
        return y * y

    assert tx.Function(f)(x).key() == tx.Function(f, name="f")(x).key()
    assert tx.Function(f)(x).key() != tx.Function(lambda y: y * y)(x).key()
    assert tx.Function(small_net())(x).key() == tx.Function(small_net())(x).key()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weights_take_the_precision_of_the_operands(dtype: type) -> None:
    net = jax.tree.map(lambda leaf: leaf.astype(np.float64) if eqx.is_array(leaf) else leaf, small_net())
    value = tx.lower(tx.Function(net, (2,))(x))(0.0, {"x": AT["x"].astype(dtype)})
    assert value.dtype == dtype
    np.testing.assert_allclose(value, net(jnp.asarray(AT["x"])), rtol=1e-5)


def test_a_tree_goes_in_and_comes_back() -> None:
    weights = tx.ParameterTree("p", TREE)
    assert [parameter.name for parameter in weights.parameters] == ["p['A']", "p['b']"]
    rate = tx.Function(affine, (2,))(weights, x)
    dynamics = tx.compile(tx.System(rates={x: rate}))
    np.testing.assert_allclose(dynamics(0.0, AT)["x"], affine(TREE, AT["x"]), rtol=1e-14)
    other = {**TREE, "b": np.array([1.0, 2.0])}
    np.testing.assert_allclose(dynamics(0.0, AT, params=weights.values(other))["x"], affine(other, AT["x"]), rtol=1e-14)
    again = weights.tree({**weights.values(other), "mass": 2.0})
    np.testing.assert_array_equal(again["b"], other["b"])
    assert again["steps"] == 3


def test_a_gradient_by_a_module_is_a_module() -> None:
    net = small_net()
    weights = tx.ParameterTree("net", net)
    dynamics = tx.compile(tx.System(rates={x: -x + tx.Function(lambda m, y: m(y), (2,))(weights, x)}))

    def by_nodes(m: Any) -> jax.Array:
        return jnp.sum(dynamics(0.0, AT, params=weights.values(m))["x"] ** 2)

    got = eqx.filter_grad(by_nodes)(net)
    wanted = eqx.filter_grad(lambda m: jnp.sum((-AT["x"] + m(jnp.asarray(AT["x"]))) ** 2))(net)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), got, wanted)


@pytest.mark.parametrize(("dtype", "depth"), [(np.float64, 2), (np.float32, 5)])
def test_constant_weights_of_a_network_are_part_of_a_kernel(dtype: Any, depth: int) -> None:
    """4,740 and 17,220 numbers, in the precision of the call; the latter are too many for scalars."""
    pytest.importorskip("llvmlite")
    net, state = eqx.nn.MLP(4, 4, 64, depth, activation=jnp.tanh, key=jax.random.key(0)), tx.State("y", shape=(4,))
    dynamics = tx.compile(tx.System(rates={state: tx.Function(net)(state)}))
    assert dynamics.explain().without_kernel == {}
    y = jnp.linspace(-1.0, 1.0, 4, dtype=dtype)
    rates = jax.jit(lambda y: dynamics(0.0, {"y": y})["y"])
    assert "dot_general" not in rates.lower(y).as_text()
    assert "@twistax_" in rates.lower(y).as_text()
    np.testing.assert_allclose(rates(y), net(y.astype(float)), rtol=1e-12 if dtype is np.float64 else 1e-4)


def test_derivatives_of_its_own_are_those_of_the_function() -> None:
    @jax.custom_vjp
    def doubled(y: jax.Array) -> jax.Array:
        return jnp.sin(y)

    doubled.defvjp(lambda y: (jnp.sin(y), y), lambda y, g: (2.0 * jnp.cos(y) * g,))  # twice the true one
    value = tx.lower(tx.Function(doubled)(x))
    got = jax.jacrev(lambda y: value(0.0, {"x": y}))(jnp.asarray(AT["x"]))
    np.testing.assert_allclose(got, np.diag(2.0 * np.cos(AT["x"])), rtol=1e-14)


def test_the_jacobian_has_the_pattern_of_the_function() -> None:
    rates = tx.Function(lambda y, w: jnp.stack([jnp.sin(y[1]), w[0] * y[1]]))(x, u)
    dynamics = tx.compile(tx.System(rates={x: rates}))
    np.testing.assert_array_equal(dynamics.explain().patterns["x"], [[False, True], [False, True]])


def host(values: np.ndarray) -> np.ndarray:
    return np.sin(values)


@jax.custom_jvp
def table(y: jax.Array) -> jax.Array:
    return jax.pure_callback(host, jax.ShapeDtypeStruct(y.shape, y.dtype), y, vmap_method="broadcast_all")


table.defjvp(lambda y, dy: (table(y[0]), jnp.cos(y[0]) * dy[0]))


@pytest.mark.filterwarnings("ignore:rates that call the Function")
def test_python_outside_of_jax_runs_as_an_opaque_call() -> None:
    dynamics = tx.compile(tx.System(rates={x: -tx.Function(table)(x)}))
    same = tx.compile(tx.System(rates={x: -tx.Sin(x)}))
    np.testing.assert_allclose(dynamics(0.0, AT)["x"], same(0.0, AT)["x"], rtol=1e-14)
    np.testing.assert_allclose(dynamics.jacobian(0.0, AT)["x"], same.jacobian(0.0, AT)["x"], rtol=1e-14)

    def end(dynamics: tx.Dynamics, start: jax.Array) -> jax.Array:
        return tx.integrate(dynamics, {"x": start}, t1=1.0, dt=0.1).last["x"]

    for run in (end, jax.jacrev(end, argnums=1)):
        np.testing.assert_allclose(run(dynamics, AT["x"]), run(same, AT["x"]), rtol=1e-13)


def test_a_lost_kernel_is_one_line_of_warning_and_a_reason_in_explain() -> None:
    pytest.importorskip("llvmlite")
    wide = tx.Function(lambda y: jnp.sum(jnp.tanh(jnp.outer(jnp.ones(300), y)), axis=0) / 300.0, name="wide")
    with pytest.warns(RuntimeWarning, match="the Function 'wide' run by XLA.*more than 128 entries") as caught:
        dynamics = tx.compile(tx.System(rates={x: wide(x)}))
    assert len(caught) == 1
    assert "Function 'wide' runs by XLA, without a native kernel" in str(dynamics.explain())
    plain = tx.compile(tx.System(rates={x: tx.Function(jnp.sin)(x)}))  # which warns of nothing
    assert plain.explain().without_kernel == {}


@pytest.mark.parametrize(
    ("build", "error", "match"),
    [
        (lambda: tx.Function(3.0), tx.ModelError, "expects a function of arrays, got 3.0"),
        (lambda: tx.Function(eqx.nn.MLP), tx.ModelError, "got the class MLP"),
        (lambda: tx.Function(jnp.sin, shape=(0,)), tx.ModelError, "positive whole numbers"),
        (lambda: tx.Function(jnp.sin, name=""), tx.ModelError, "name"),
        (lambda: tx.Function(jnp.sin, (3,))(x), tx.ShapeError, r"'sin' expects a value of shape \(3,\), got \(2,\)"),
        (lambda: tx.Function(small_net())(x[0]), tx.ShapeError, r"'MLP' fails for operands of shapes \(\)"),
        (lambda: tx.Function(lambda y: float(y[0]))(x), tx.ModelError, "needs concrete values of its arguments"),
        (lambda: tx.Function(lambda y: y if y[0] > 0 else -y)(x), tx.ModelError, "jax.pure_callback"),
        (lambda: tx.Function(lambda y: (y, y))(x), tx.ModelError, "one array of real numbers"),
        (lambda: tx.Function(lambda y: y.astype(complex))(x), tx.ModelError, "one array of real numbers, got complex"),
        (lambda: tx.Function(jnp.sin)(x <= 0.0), tx.ModelError, "expects numbers, got the condition"),
        (lambda: -x + small_net(), tx.ModelError, r"tx.Function\(f, shape\)\(x\)"),
        (lambda: -x + small_net()(x), tx.ModelError, r"tx.Function\(f, shape\)\(x\)"),
        (lambda: -x + eqx.nn.MLP(2, 2, 4, 1, key=jax.random.key(0))(x), tx.ModelError, r"tx.Function\(f, shape\)"),
        (lambda: tx.ParameterTree("p", 3.0), tx.ModelError, "pytree with arrays of real numbers"),
        (lambda: tx.ParameterTree("", TREE), tx.ModelError, "needs a name"),
        (lambda: tx.ParameterTree("p", TREE).values({"A": TREE["A"]}), tx.ShapeError, r"\['b'\]\" is missing"),
        (lambda: tx.ParameterTree("p", TREE).values({**TREE, "b": np.ones(3)}), tx.ShapeError, r"expects shape \(2,\)"),
        (lambda: tx.ParameterTree("p", TREE).tree({}), tx.InputError, "is missing"),
    ],
)
def test_errors(build: Callable[[], Any], error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        build()


def test_traced_weights_are_refused() -> None:
    with pytest.raises(tx.ModelError, match=r"make the arrays a tx\.ParameterTree"):
        eqx.filter_grad(lambda m: jnp.sum(tx.lower(tx.Function(m)(x))(0.0, AT)))(small_net())
    with pytest.raises(tx.ModelError, match="build the system outside of the transformation"):
        jax.grad(lambda a: tx.ParameterTree("p", {"a": a}).tree()["a"])(1.0)
