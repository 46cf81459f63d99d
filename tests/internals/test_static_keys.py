"""Keys of static fields: values that differ have other ones."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx
from twistax.expr.fields import freeze
from twistax.system.inputs import cast

s, v = tx.State("s"), tx.State("v", shape=(3,))


A, B = tx.State("A", shape=(2, 2)), tx.State("B", shape=(2, 2))


X = {"A": np.array([[1.0, 2.0], [3.0, 4.0]]), "B": np.array([[5.0, 6.0], [7.0, 8.0]])}


def test_static_fields_of_any_type() -> None:
    def function(scale: float) -> Callable[[float], float]:
        return lambda x: scale * x

    values = [
        None, True, 1, 1.0, np.float32(1.0), np.int32(1), "1", b"1", 1j, (1,), [2], {"a": 1}, {"a": 2}, {1}, {1, 2},
        slice(1), ..., np.array([1.0]), np.array([1]), np.array([1.0], np.float32), jnp.array([2.0]), np.array([None]),
        function(1.0), function(2.0), np.array(["1"]), object(), tx.SE3, tx.SO3, tx.LINEAR_FIRST, tx.ANGULAR_FIRST,
        float, int,
    ]  # fmt: skip
    keys = [repr(freeze(value)) for value in values]
    assert len(set(keys)) == len(keys)
    assert keys == [repr(freeze(value)) for value in values]


def test_what_is_called_counts_by_identity() -> None:
    def scaled(by: float) -> Callable[..., float]:
        def function(a: float, v: float) -> float:
            return by * a * v

        return function

    one, two = scaled(1.0), scaled(100.0)
    assert freeze(functools.partial(one, 2.0)) == freeze(functools.partial(one, 2.0))
    assert freeze(functools.partial(one, 2.0)) != freeze(functools.partial(one, 3.0))
    assert freeze(functools.partial(one, 2.0)) != freeze(functools.partial(two, 2.0))
    assert freeze(jax.random.key(0)) == freeze(jax.random.key(0)) != freeze(jax.random.key(1))
    assert freeze(np.float64(0.5)) == freeze(0.5)


def test_an_address_used_again_is_another_object() -> None:
    keys = {repr(freeze(lambda x, k=k: k * x)) for k in range(100)}  # each one is gone before the next is made
    assert len(keys) == 100


class Picked(tx.Expr):
    """Entries of a matrix by an index that is static."""

    x: tx.expr.fields.Operand
    index: Any

    def infer_shape(self, *shapes: Any) -> Any:
        return np.zeros(shapes[0])[self.index].shape

    def evaluate(self, *values: Any) -> Any:
        return values[0][np.asarray(self.index) if isinstance(self.index, list) else self.index]


def test_a_list_is_no_tuple_and_a_mask_counts() -> None:
    """As an index a list takes rows, a tuple an entry."""
    rows, entry = Picked(A, index=[0, 1]), Picked(A, index=(0, 1))
    found = tx.lower((rows, entry))(0.0, {"A": X["A"]})
    np.testing.assert_array_equal(found[0], X["A"])
    assert found[1] == X["A"][0, 1]
    masks = [freeze(np.ma.array([1.0, 2.0], mask=[False, last])) for last in (False, True)]
    assert masks[0] != masks[1]


def test_an_array_of_jax_in_another_precision_stays_one() -> None:
    found = cast("p", jnp.asarray([1.0, np.inf]), np.dtype(np.float32), on_host=True)
    assert isinstance(found, jax.Array)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, [1.0, np.inf])
