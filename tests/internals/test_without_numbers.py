"""Structures of expressions: equal for those that differ in numbers alone, whose numbers then give the right values."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from expr_cases import value_of

import twistax as tx
from twistax.expr import Expr
from twistax.expr.transformations.without_numbers import Structure

x, v = tx.State("x", shape=(2,)), tx.State("v")
VALUES: dict[str, Any] = {"x": np.array([0.3, -0.7]), "v": 0.4}


class Scaled(Expr):
    """A node of a user's, which may read the numbers of its operands where it is evaluated."""

    a: tx.expr.fields.Operand
    by: tx.expr.fields.Operand
    takes = ((), ())
    gives = ()

    def evaluate(self, *values: Any) -> Any:
        return values[0] * float(self.by.value)  # type: ignore[attr-defined]


def structure(*roots: Any) -> Structure:
    return Structure([tx.to_expr(root).canonicalize() for root in roots], lambda leaf: None)


#: Expressions of a number.
ALIKE: dict[str, Callable[[float], Any]] = {
    "a factor": lambda k: k * v,
    "a term": lambda k: v - k,
    "a divisor": lambda k: tx.Sin(v) / k + 1.0 / k,
    "constants folded": lambda k: (2.0 * k + 0.3) * v**3,
    "a vector beside zeros": lambda k: x @ np.array([[k, 0.0], [0.0, 0.7]]),
    "a norm": lambda k: tx.linalg.Norm(x - np.array([k, 0.25])),
    "within Vmap": lambda k: tx.Vmap(lambda p: k * (p @ x) ** 2, np.array([[k, 1.0], [2.0, 0.5], [0.1, k]])),
    "within a branch": lambda k: tx.Cond(v >= k, k * v, v / k),
    "a number alone": lambda k: k,
    "a base": lambda k: tx.to_expr(k) ** v,
}


@pytest.mark.parametrize("make", ALIKE.values(), ids=ALIKE.keys())
def test_other_numbers_are_the_same_structure_with_other_values(make: Callable[[float], Any]) -> None:
    one, other = structure(make(1.7)), structure(make(2.3))
    assert one.key == other.key
    assert one.numbers.shape == other.numbers.shape
    assert (one.numbers != other.numbers).any()
    (root,) = one.roots
    for own, number in ((one, 1.7), (other, 2.3)):
        hidden = {name: np.asarray(value) for name, value in one.params(own.numbers).items()}
        expected = value_of(tx.to_expr(make(number)), **VALUES)
        np.testing.assert_allclose(value_of(root, **VALUES, **hidden), expected, rtol=1e-14)


APART: dict[str, tuple[Any, Any]] = {
    "a zero": (v - 0.0, v - 0.1),
    "a one": (1.0 * v, 1.1 * v),
    "a zero in a matrix": (x @ np.diag([2.0, 3.0]), x @ np.array([[2.0, 0.1], [0.0, 3.0]])),
    "a zero or a one beside numbers": (np.array([2.0, 0.0]) * x, np.array([2.0, 1.0]) * x),
    "a shape": (v * np.array([[0.7, 0.6]]), v * np.array([[0.7], [0.6]])),
    "an exponent": (v**2, v**3),
    "an exponent that is not whole": (v**2.5, v**3.5),
    "a table": (tx.Linterp(v, [0.0, 1.0], [2.0, 3.0]), tx.Linterp(v, [0.0, 1.0], [2.0, 4.0])),
    "an index": (x[0], x[1]),
    "a leaf": (0.3 * v, 0.3 * x[0]),
    "a node that is not of this package": (Scaled(v, 2.0), Scaled(v, 3.0)),
    "a node's setting": (tx.Huber(v, 0.5), tx.Huber(v, 0.6)),
    "what is shared": (0.3 * v + tx.Sin(0.3 * v), 0.3 * v + tx.Sin(0.4 * v)),
    "an infinity": (tx.Min(v, 2.0), tx.Min(v, np.inf)),
}


@pytest.mark.parametrize(("one", "other"), APART.values(), ids=APART.keys())
def test_what_decides_the_operations_stays(one: Any, other: Any) -> None:
    assert structure(one).key != structure(other).key
    assert structure(one).key == structure(one + 0.0).key


def test_leaves_count_as_what_stands_for_them() -> None:
    """Names do not matter where places do."""
    w = tx.State("w")
    one, other = (Structure([0.3 * leaf], lambda leaf: ("state", 0, leaf.shape)) for leaf in (v, w))
    assert one.key == other.key
    assert structure(0.3 * v).key != structure(0.3 * w).key


def test_a_class_that_is_made_anew_is_another() -> None:
    def made(factor: float) -> Any:
        class Times(Expr):
            a: tx.expr.fields.Operand
            takes = ((),)
            gives = ()

            def evaluate(self, *values: Any) -> Any:
                return factor * values[0]

        return Times(v)

    assert structure(made(2.0)).key != structure(made(3.0)).key
