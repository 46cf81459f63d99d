"""`check_node` passes a node of a user's, and sees each error that makes one wrong."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.testing import LawError, check_node


class SquaredDistance(tx.Expr):
    """|a - b|^2 of two points."""

    a: tx.expr.fields.Operand
    b: tx.expr.fields.Operand
    takes = ((3,), (3,))
    gives = ()
    kinds = tx.kinds.OPEN
    cases = ({"a": [0.5, -1.0, 2.0], "b": [1.0, 2.0, 3.0]},)

    def evaluate(self, *values: Any) -> Any:
        d = values[0] - values[1]
        return d @ d


def test_a_node_of_users_passes() -> None:
    check_node(SquaredDistance)


class AnotherShape(SquaredDistance):
    gives = (3,)  # type: ignore[assignment]


class WithoutCases(SquaredDistance):
    cases = ()


class Promoting(SquaredDistance):
    def evaluate(self, *values: Any) -> Any:
        return jnp.asarray(super().evaluate(*values), jnp.float64)


class Simplified(SquaredDistance):
    def simplify(self) -> tx.Expr:
        return tx.Constant(0.0)


@jax.custom_jvp
def _half_right(a: Any, b: Any) -> Any:
    return jnp.sum((a - b) ** 2)


@_half_right.defjvp
def _(primals: Any, tangents: Any) -> Any:
    a, b = primals
    return _half_right(a, b), jnp.sum((a - b) * (tangents[0] - tangents[1]))


class HalfADerivative(SquaredDistance):
    function = staticmethod(_half_right)

    def evaluate(self, *values: Any) -> Any:
        return _half_right(*values)


class RootAtZero(SquaredDistance):
    cases = ()
    kinks = ({"a": [1.0, 2.0, 3.0], "b": [1.0, 2.0, 3.0]},)

    def evaluate(self, *values: Any) -> Any:
        return jnp.sqrt(super().evaluate(*values))


class Cancelling(SquaredDistance):
    cases = ({"a": [0.3, -1.1, 2.2], "b": [1.0, 2.0, 3.0]},)

    def evaluate(self, *values: Any) -> Any:
        return (super().evaluate(*values) + 1e5 / 3.0) - 1e5 / 3.0


class WrongError(SquaredDistance):
    def infer_shape(self, *shapes: Any) -> Any:
        return {((3,), (3,)): ()}[shapes]


class Unbalanced(SquaredDistance):
    formula = r"\left\| <0> - {<1>"


class Counted(SquaredDistance):
    def evaluate(self, *values: Any) -> Any:
        return super().evaluate(*values) if float(np.asarray(values[0])[0]) > 0.0 else values[0][0]


class WithoutRule(SquaredDistance):
    kinds = None


BROKEN: list[tuple[type[tx.Expr], str]] = [
    (AnotherShape, r"infer_shape says \(3,\), the value has \(\)"),
    (WithoutCases, "a node class has cases': there are none.*fix: give the class cases"),
    (Promoting, "the precision is that of the operands': operands of float32 give float64"),
    (Simplified, "canonicalize keeps the value"),
    (HalfADerivative, "the derivative is that of the values"),
    (RootAtZero, "derivatives are finite"),
    (Cancelling, "float32 is float64 to 100 round-offs"),
    (WrongError, "shapes that do not fit give ShapeError.*KeyError"),
    (Unbalanced, "the formula has pairs of parentheses"),
    (WithoutRule, "a node states a rule of kinds"),
    (Counted, "TracerArrayConversionError"),
]


@pytest.mark.parametrize(("node", "words"), BROKEN, ids=lambda value: getattr(value, "__name__", ""))
def test_an_error_is_seen(node: type[tx.Expr], words: str) -> None:
    with pytest.raises(LawError, match=f"(?s){words}"):
        check_node(node)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("wrong", [tx.Sin(1.0), dict], ids=["node", "class"])
def test_what_is_no_class_of_nodes_is_refused(wrong: Any) -> None:
    with pytest.raises(tx.InputError, match="check_node expects a node class"):
        check_node(wrong)
