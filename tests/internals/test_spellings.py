"""Expressions taken for arrays: every error gives a spelling, and the spelling is right."""

import copy
import functools
import itertools
import math
import operator
import pickle
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import value_of

import twistax as tx
from twistax.expr.spellings import CODE, PROSE, spelled

V, F, s = tx.State("V", shape=(6,)), tx.Control("F", shape=(6,)), tx.State("s")
M = tx.State("M", shape=(3, 3))
NUMBERS = {
    "V": np.array([0.3, -0.4, 0.8, 1.5, -2.0, 0.1]),
    "F": np.arange(6.0),
    "M": np.arange(9.0).reshape(3, 3) + np.eye(3),
}
NAMES = {
    "tx": tx,
    "np": np,
    "functools": functools,
    "itertools": itertools,
    "operator": operator,
    "low": -0.5,
    "high": 0.5,
}
#: Methods that are asked of a matrix; with what arguments; those that NumPy has no method for.
OF_MATRICES = {"diagonal", "trace", "transpose", "swapaxes", "mT", "inv", "ravel", "flatten", "flat"}
ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "clip": (-0.5, 0.5), "take": ([0, 2],), "reshape": ((2, 3),), "swapaxes": (0, 1), "dot": (NUMBERS["F"],)
}  # fmt: skip
OTHERS: dict[str, Callable[[np.ndarray], Any]] = {
    "vdot": lambda a: a @ NUMBERS["F"],
    "outer": lambda a: np.outer(a, NUMBERS["F"]),
    "norm": np.linalg.norm,
    "inv": np.linalg.inv,
    "ptp": np.ptp,
    "choose": lambda a: a[[0, 2]],
    "compress": lambda a: a[[0, 2]],
    "repeat": lambda a: np.concatenate([a, a]),
    "tile": lambda a: np.concatenate([a, a]),
    "resize": lambda a: a.reshape(2, 3),
    "flat": np.ravel,
    "mT": np.transpose,
    "squeeze": lambda a: a[0],
    "conj": lambda a: a,
    "view": lambda a: a,
}


def attribute_error(x: Any, name: str) -> str:
    with pytest.raises(AttributeError) as caught:
        getattr(x, name)
    assert isinstance(caught.value, tx.OperationError)
    return str(caught.value)


@pytest.mark.parametrize("name", CODE)
def test_the_code_that_is_named_gives_what_the_method_gives(name: str) -> None:
    x, text = (M.T, "M") if name in OF_MATRICES else (-V, "V")
    fix = attribute_error(x, name).partition("\n  fix: ")[2]
    assert fix == spelled(name, repr(x))
    if name in ("all", "any"):
        code, numbers = str(spelled(name, "(V <= 0.2)")), NUMBERS["V"] <= 0.2
    else:
        code, numbers = str(spelled(name, text)), NUMBERS[text]
    found = eval(code, NAMES | {"V": V, "M": M, "y": F})
    expected = OTHERS[name](numbers) if name in OTHERS else getattr(numbers, name)
    if callable(expected):
        expected = expected(*ARGUMENTS.get(name, ()))
    value = value_of(found, **NUMBERS) if isinstance(found, tx.Expr) else found
    np.testing.assert_allclose(value, expected, rtol=1e-14)


@pytest.mark.parametrize("name", ["max", "min"])
@pytest.mark.parametrize("bounds", [{}, {"min": -1.0, "max": 1.0}])
def test_bounds_of_leaves_are_no_methods(name: str, bounds: dict[str, float]) -> None:
    """Called as a method each gives the spelling that other expressions give; read as a value it is the bound."""
    for kind in (tx.State, tx.Control):
        x = kind("x", shape=(2,), **bounds)
        for call in ("x.max()", "x.max(axis=0)", "x.max(0, keepdims=True)"):
            words = rf"x.{name}: an expression is not an array(.|\n)*fix: tx.{name.title()}\(\*x\)"
            with pytest.raises(AttributeError, match=words):
                eval(call.replace("max", name), {"x": x})
        bound = {"max": x.max, "min": x.min}[name]
        assert getattr(x, name) is bound
        assert hasattr(x, name)
        assert (bound is None) == (not bounds)
        with pytest.raises(tx.ImmutableError):
            setattr(x, name, 3.0)
        copied = pickle.loads(pickle.dumps(x))
        np.testing.assert_array_equal(x.replace(scale=1.0).max, copied.max)


@pytest.mark.parametrize("name", ["max", "min", "prod", "cumsum", "cumprod", "sum", "mean", "ptp"])
def test_methods_of_all_entries_of_matrices_and_scalars(name: str) -> None:
    for x, text, value in ((M.T, "M.T", NUMBERS["M"].T), (-s, "(-s)", np.float64(-0.7))):
        fix = attribute_error(x, name).partition("\n  fix: ")[2]
        found = eval(str(spelled(name, text, x.ndim)), NAMES | {"M": M, "s": s})
        assert fix == spelled(name, repr(x), x.ndim)
        expected = np.ptp(value) if name == "ptp" else getattr(value, name)()
        result = value_of(found, s=0.7, M=NUMBERS["M"])
        np.testing.assert_allclose(np.squeeze(result), np.squeeze(expected), rtol=1e-14)


@pytest.mark.parametrize(
    "name", [n for n in dir(np.ndarray) if not n.startswith("_") and n not in ("T", "shape", "ndim")]
)
def test_no_public_attribute_of_arrays_is_without_a_spelling(name: str) -> None:
    rare = {"base", "byteswap", "ctypes", "device", "flags", "getfield", "strides", "to_device"}
    assert name in rare or name in CODE or name in PROSE
    if name not in rare:
        assert "\n  fix: " in attribute_error(-V, name)
        assert not hasattr(-V, name)


@pytest.mark.parametrize("name", ["sin", "sqrt", "exp", "where"])
def test_functions_of_numpy_as_methods(name: str) -> None:
    assert f"fix: np.{name}(V)" in attribute_error(V, name)


@pytest.mark.parametrize("name", ["cross", "arctan2", "maximum"])
def test_functions_of_numpy_of_two_arguments_as_methods(name: str) -> None:
    assert f"fix: np.{name}(V, ...)" in attribute_error(V, name)


def test_attributes_are_asked_of_expressions_without_a_shape() -> None:
    assert not hasattr(V + M, "mean")
    assert not hasattr(V + M, "transform")
    assert "fix: tx.Max(*(V + M))" in attribute_error(V + M, "max")


def test_what_nothing_has_is_no_attribute() -> None:
    for name in ("foo", "_foo", "__array_interface__", "__cuda_array_interface__", "_repr_png_", "_ipython_display_"):
        assert not hasattr(V, name)
        with pytest.raises(AttributeError, match=f"'State' object has no attribute '{name}'"):
            getattr(V, name)


ASKED: list[tuple[str, Callable[[], Any]]] = [
    ("sin", lambda: jnp.sin(V)),
    ("norm", lambda: jnp.linalg.norm(V)),
    ("where", lambda: jnp.where(V > 0.0, V, 0.0)),
    ("dot", lambda: jnp.dot(V, V)),
    ("sum", lambda: jnp.sum(V)),
    ("mean", lambda: jnp.mean(V)),
    ("maximum", lambda: jnp.maximum(V, 0.0)),
    ("clip", lambda: jnp.clip(V, 0.0, 1.0)),
    ("cross", lambda: jnp.cross(V[:3], V[3:])),
    ("solve", lambda: jnp.linalg.solve(jnp.eye(6), V)),
    ("array", lambda: jnp.array(V)),
    ("array of a list", lambda: jnp.array([s, s])),
    ("concatenate", lambda: jnp.concatenate([V, V])),
    ("einsum", lambda: jnp.einsum("i,i", V, V)),
    ("zeros_like", lambda: jnp.zeros_like(V)),
    ("reshape", lambda: jnp.reshape(V, (2, 3))),
    ("jit", lambda: jax.jit(lambda a: a)(V)),
    ("vmap", lambda: jax.vmap(jnp.sin)(V)),
    ("grad", lambda: jax.grad(jnp.sin)(s)),
    ("at", lambda: jnp.zeros(6).at[0].set(s)),
]


@pytest.mark.parametrize("attempt", [a[1] for a in ASKED], ids=[a[0] for a in ASKED])
def test_functions_of_jax_name_those_of_numpy(attempt: Callable[[], Any]) -> None:
    words = r"expects arrays, got the expression .*\n  fix: use NumPy, np.sin\(x\), .* tx.Sin\(x\)"
    with pytest.raises(tx.ModelError, match=words):
        attempt()


def test_operators_of_jax_arrays_leave_it_to_expressions() -> None:
    array = jnp.arange(6.0)
    for found in (array + V, array * V, jnp.eye(6) @ V, array <= V, array == V, jnp.float32(2.0) ** V, array / V):
        assert isinstance(found, tx.Expr)
    assert not hasattr(V, "__jax_array__")  # to whoever else asks


@pytest.mark.parametrize(
    ("attempt", "words"),
    [
        (lambda: math.sin(s), r"float\(s\): .*\n  fix: math.sin\(x\) is written tx.Sin\(x\)"),
        (lambda: math.atan2(s, 1.0), r"math.sin\(x\) is written tx.Sin\(x\)"),
        (lambda: float(s), "float"),
        (lambda: int(s), "int"),
        (lambda: complex(s), "expressions are real"),
        (lambda: round(s), "tx.Linterp"),
        (lambda: math.floor(s), "tx.Linterp"),
        (lambda: divmod(s, 2.0), "tx.Atan2"),
        (lambda: len(s), r"s is a scalar .*\n  fix: tx.Stack"),
        (lambda: list(s), r"s is a scalar .*\n  fix: tx.Stack"),
        (lambda: bool(s), r"no truth value .*\n  fix: use tx.Where"),
        (lambda: max(s, 1.0), r"tx.Where, tx.Max, tx.Min"),
        (lambda: f"{s:.2f}", "with the format '.2f'"),
        (lambda: np.mean(V), r"np.mean is not available for expressions.\n  fix: tx.linalg.Sum\(x\) / np.size\(x\)"),
        (lambda: np.max(V), r"fix: tx.Max\(\*x\)"),
        (lambda: np.max(M), r"fix: tx.Max\(\*tx.Concat\(\*x\)\)"),
        (lambda: np.reshape(V, (2, 3)), r"fix: tx.Stack"),
        (lambda: np.array([s, s]), r"tx.Stack"),
    ],
)
def test_conversions_and_functions_give_a_spelling(attempt: Callable[[], Any], words: str) -> None:
    with pytest.raises(tx.OperationError, match="(?s)" + words):
        attempt()


def test_copies_pickles_and_texts_are_as_before() -> None:
    e = tx.Sin(V) + F
    assert copy.copy(e) is copy.deepcopy(e) is e
    assert pickle.loads(pickle.dumps(e)).key() == e.key()
    assert f"{e}" == str(e) == repr(e)
    assert e._repr_latex_().startswith("$")
    assert jax.tree.leaves({"a": e})[0] is e


def test_no_text_is_made_for_an_attribute_without_spelling(monkeypatch: pytest.MonkeyPatch) -> None:
    """`hasattr` asks often, and the text of a large expression takes long."""
    expr, made = V + F, list[str]()
    monkeypatch.setattr(type(expr), "__repr__", lambda self: made.append("text") or "V + F")
    assert not hasattr(expr, "transform")
    assert made == []
    assert not hasattr(expr, "dtype")
    assert made
