"""NumPy functions and arrays, and JAX arrays, that meet expressions."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import value_of

from twistax import expr as tx
from twistax.errors import ModelError

x, y, s = tx.State("x", shape=(3,)), tx.State("y", shape=(3,)), tx.State("s")
A = tx.State("A", shape=(3, 3))
X, Y, S, M = np.array([0.3, -0.4, 0.8]), np.array([0.5, 0.1, -0.9]), 0.7, np.arange(9.0).reshape(3, 3) + 2.0 * np.eye(3)
VALUES = {"x": X, "y": Y, "s": S, "A": M}

UFUNCS: list[Callable[..., Any]] = [
    np.sin, np.cos, np.tan, np.arcsin, np.arccos, np.arctan, np.sinh, np.cosh, np.tanh, np.exp, np.square, np.absolute,
    np.fabs, np.sign, np.negative, np.positive, np.reciprocal, np.deg2rad, np.rad2deg, np.radians, np.degrees,
]  # fmt: skip
PAIRS: list[Callable[..., Any]] = [
    np.add, np.subtract, np.multiply, np.divide, np.true_divide, np.maximum, np.minimum,
    np.arctan2, np.logaddexp, np.less_equal, np.greater_equal, np.equal, np.matmul,
]  # fmt: skip


@pytest.mark.parametrize("ufunc", UFUNCS, ids=lambda f: f.__name__)
def test_ufuncs_of_one_operand(ufunc: Callable[..., Any]) -> None:
    np.testing.assert_allclose(value_of(ufunc(x), x=X), ufunc(X), rtol=1e-14)


@pytest.mark.parametrize("ufunc", PAIRS, ids=lambda f: f.__name__)
def test_ufuncs_of_two_operands(ufunc: Callable[..., Any]) -> None:
    for a, b in ((x, y), (x, Y), (X, y)):
        expr = ufunc(a, b)
        assert isinstance(expr, tx.Expr)
        np.testing.assert_allclose(value_of(expr, x=X, y=Y), ufunc(X, Y), rtol=1e-14)


def test_power_root_and_logarithm() -> None:
    positive = np.abs(X)
    for function in (np.sqrt, np.log):
        np.testing.assert_allclose(value_of(function(x), x=positive), function(positive), rtol=1e-14)
    np.testing.assert_allclose(value_of(np.power(x, 3), x=X), X**3, rtol=1e-14)
    np.testing.assert_allclose(value_of(np.float_power(x, 1.5), x=positive), positive**1.5, rtol=1e-14)


FUNCTIONS: list[tuple[str, Callable[..., Any], tuple[Any, ...]]] = [
    ("dot", np.dot, (x, y)),
    ("dot of a matrix", np.dot, (A, x)),
    ("dot of a number", np.dot, (s, x)),
    ("vdot", np.vdot, (x, y)),
    ("inner", np.inner, (x, y)),
    ("cross", np.cross, (x, y)),
    ("outer", np.outer, (x, y)),
    ("trace", np.trace, (A,)),
    ("transpose", np.transpose, (A,)),
    ("diag", np.diag, (x,)),
    ("sum", np.sum, (A,)),
    ("all", np.all, (x <= y,)),
    ("any", np.any, (x <= y,)),
    ("norm", np.linalg.norm, (x,)),
    ("norm 1", np.linalg.norm, (x, 1)),
    ("norm inf", np.linalg.norm, (A, np.inf)),
    ("norm of a matrix", np.linalg.norm, (A,)),
    ("inv", np.linalg.inv, (A,)),
    ("solve", np.linalg.solve, (A, x)),
    ("concatenate", np.concatenate, ([x, y, np.ones(2)],)),
    ("concatenate axis 1", lambda *a: np.concatenate(a, axis=1), (A, A)),
    ("stack", np.stack, ([x, y],)),
    ("hstack", np.hstack, ([A, A],)),
    ("vstack", np.vstack, ([A, x],)),
    ("block", np.block, ([[A, A], [A, np.eye(3)]],)),
    ("where", np.where, (x <= y, x, 0.0)),
    ("clip", np.clip, (x, -0.1, 0.5)),
    ("clip below", lambda a: np.clip(a, -0.1, None), (x,)),
    ("interp", np.interp, (x, np.array([-1.0, 0.0, 2.0]), np.array([0.0, 3.0, 1.0]))),
    ("shape", np.shape, (A,)),
    ("ndim", np.ndim, (A,)),
    ("size", np.size, (A,)),
]


def numbers(argument: Any) -> Any:
    if isinstance(argument, tx.Expr):
        return value_of(argument, **VALUES)
    return [numbers(a) for a in argument] if isinstance(argument, list) else argument


@pytest.mark.parametrize(("function", "arguments"), [f[1:] for f in FUNCTIONS], ids=[f[0] for f in FUNCTIONS])
def test_functions(function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    built, expected = function(*arguments), function(*map(numbers, arguments))
    found = value_of(built, **VALUES) if isinstance(built, tx.Expr) else built
    np.testing.assert_allclose(found, expected, rtol=1e-13)


@pytest.mark.parametrize("array", [np.asarray, jnp.asarray], ids=["numpy", "jax"])
def test_arrays_on_either_side(array: Callable[..., Any]) -> None:
    m, v = array(M), array(Y)
    for expr, expected in (
        (m @ x, M @ X),
        (x @ m, X @ M),
        (v + x, Y + X),
        (x + v, X + Y),
        (v - x, Y - X),
        (x - v, X - Y),
        (v * x, Y * X),
        (v / x, Y / X),
        (x / v, X / Y),
        (array(2.0) ** x, 2.0**X),
        (v <= x, Y <= X),
        (v >= x, Y >= X),
        (v == x, Y == X),
        (x <= v, X <= Y),
    ):
        assert isinstance(expr, tx.Expr)
        np.testing.assert_allclose(value_of(expr, x=X), expected, rtol=1e-14)


def test_numpy_numbers_mix() -> None:
    for number in (np.float64(2.0), np.float32(2.0), np.int64(2), 2, np.array(2.0), jnp.float32(2.0)):
        np.testing.assert_allclose(value_of(number * x, x=X), 2.0 * X)
        np.testing.assert_allclose(value_of(x / number, x=X), X / 2.0)


@pytest.mark.parametrize(
    ("attempt", "sentence"),
    [
        (lambda: np.cbrt(x), r"np\.cbrt is not available for expressions"),
        (lambda: np.add.reduce(x), r"np\.add\.reduce is not available"),
        (lambda: np.sin(x, where=np.ones(3, bool)), r"np\.sin does not accept keyword arguments"),
        (lambda: np.not_equal(x, y), "np.not_equal is not available"),
        (lambda: np.linalg.eig(A), r"np\.linalg\.eig is not available for expressions"),
        (lambda: np.sum(A, axis=0), r"np\.sum with expressions"),
        (lambda: np.fft.fft(x), r"np\.fft\.fft is not available"),
        (lambda: np.transpose(A, (0, 1)), "accepts matrices"),
        (lambda: np.stack([x, y], axis=1), "accepts axis 0 only"),
        (lambda: np.concatenate([x, y], axis=1), "accepts axis 0"),
        (lambda: np.asarray(x), "has no value yet"),
        (lambda: np.array([x, y]), "has no value yet"),
        (lambda: float(s), "float"),
    ],
)
def test_what_is_not_supported_says_so(attempt: Callable[[], Any], sentence: str) -> None:
    with pytest.raises(TypeError, match=sentence):
        attempt()


def test_traced_values_are_no_constants() -> None:
    import jax

    with pytest.raises(ModelError, match="traced JAX value"):
        jax.jit(lambda a: value_of(a * x, x=X))(1.0)
