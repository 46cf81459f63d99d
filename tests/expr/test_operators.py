"""What expressions refuse, and the sentences they refuse with."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from twistax import expr as tx
from twistax.errors import ShapeError

s = tx.State("s")
x, q = tx.State("x", shape=(3,)), tx.State("q", shape=(4,))
A, P = tx.State("A", shape=(3, 3)), tx.State("P", shape=(2, 3))


@pytest.mark.parametrize(
    ("attempt", "sentence"),
    [
        (lambda: bool(x), "State has no truth value"),
        (lambda: bool(x <= 1.0), "the comparison x <= 1. has no truth value"),
        (lambda: 0.0 <= x <= 1.0, "has no truth value"),
        (lambda: x and s, "truth value"),
        (lambda: ~x, "Not expects conditions"),
        (lambda: x != 1.0, "!= has no meaning"),
        (lambda: 1.0 in x, "'in' has no meaning"),
        (lambda: (x < 1.0) ^ (x > 0.0), r"\^ has no meaning"),
        (lambda: 0.0 < x < 1.0, r"join conditions by tx.All\(a, b\)"),
        (lambda: len(s), "s is a scalar and has no length"),
        (lambda: list(s), "s is a scalar"),
        (lambda: x[s], "an index is fixed when the expression is built"),
        (lambda: x[True], "got a truth value"),
        (lambda: x[1.0], "whole numbers"),
        (lambda: x["a"], "whole numbers"),
        (lambda: x[np.array([0.5])], "whole numbers or a mask"),
        (lambda: tx.Solve(A), "Solve(A, b)".replace("(", r"\(").replace(")", r"\)")),
        (lambda: tx.Sin(x, x), "Sin"),
        (lambda: tx.Sin(operant=x), "Sin"),
        (lambda: tx.Where(x, 1.0, 2.0), "Where expects conditions such as x <= 5"),
        (lambda: tx.Cond(s, 1.0, 2.0), "Cond expects conditions"),
        (lambda: tx.All([x]), "All expects conditions"),
    ],
)
def test_type_errors(attempt: Callable[[], Any], sentence: str) -> None:
    with pytest.raises(TypeError, match=sentence):
        attempt()


@pytest.mark.parametrize(
    ("attempt", "sentence"),
    [
        (lambda: tx.Max(x), "Max requires two or more operands"),
        (lambda: tx.LogSumExp(x), "LogSumExp requires two or more"),
        (lambda: tx.Concat(), "Concat requires one or more exprs"),
        (lambda: tx.Stack([]), "Stack requires one or more rows"),
        (lambda: tx.All([]), "All requires one or more predicates"),
        (lambda: tx.Any([]), "Any requires one or more predicates"),
        (lambda: tx.Block([]), "Block expects at least one row"),
        (lambda: tx.Block([[x], [x, x]]), r"same number of blocks, got \[1, 2\]"),
        (lambda: tx.Huber(x, delta=0.0), "Huber expects delta to be a positive number, got 0.0"),
        (lambda: tx.SmoothReLU(x, c=-1.0), "SmoothReLU expects c to be a positive number"),
        (lambda: tx.Norm(x, 0.5), "Norm expects ord to be"),
        (lambda: tx.Norm(x, "nuc"), "Norm expects ord to be"),
        (
            lambda: tx.Linterp(s, [0.0, 0.0, 1.0], [1.0, 2.0, 3.0]),
            "Linterp expects xp to be two or more finite, strictly",
        ),
        (
            lambda: tx.Bilerp(s, s, [0.0, 1.0], [1.0, 0.0], np.eye(2)),
            "Bilerp expects yp to be two or more finite, strictly",
        ),
        (
            lambda: tx.Cinterp(s, [0.0, 2.0, 1.0], [1.0, 2.0, 3.0]),
            "Cinterp expects xp to be two or more finite, strictly",
        ),
        (lambda: tx.Cinterp(s, [0.0, 1.0], [1.0, 2.0, 3.0]), "Cinterp expects fp with a first axis of length 2"),
        (lambda: tx.Cinterp(s, [0.0, 1.0, 2.0], [1.0, 2.0, 3.0], method="quintic"), "one of cubic, pchip, akima"),
        (lambda: tx.Cinterp(s, x, [1.0, 2.0, 3.0]), "Cinterp expects xp to be numbers"),
        (lambda: x + "a", "a Constant expects real numbers"),
        (lambda: x * (1.0 + 2.0j), "a Constant expects real numbers, got complex128"),
        (lambda: x + None, "a Constant expects real numbers, got None"),
        (lambda: x + [[1.0], [1.0, 2.0]], "a Constant expects real numbers"),
    ],
)
def test_value_errors(attempt: Callable[[], Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        attempt()


@pytest.mark.parametrize(
    ("expr", "sentence"),
    [
        (x + q, r"Add shapes not broadcastable: \(3,\) and \(4,\)"),
        (x - q, r"Sub shapes not broadcastable"),
        (x * q, r"Mul shapes not broadcastable"),
        (x / q, r"Div shapes not broadcastable"),
        (x**q, r"Power shapes not broadcastable"),
        (x <= q, r"Inequality shapes not broadcastable"),
        (tx.Max(x, q), r"Max shapes not broadcastable"),
        (tx.Atan2(x, q), r"Atan2 shapes not broadcastable"),
        (tx.Where(x <= 0.0, x, q), r"Where shapes not broadcastable"),
        (tx.Cond(s <= 0.0, x, q), r"Cond shapes not broadcastable"),
        (tx.Cond(x <= 0.0, x, x), r"Cond expects predicate with shape \(\), got \(3,\)"),
        (A @ q, r"MatMul incompatible shapes: \(3, 3\) @ \(4,\)"),
        (tx.State("T", (4, 4)) @ x, r"(?s)MatMul incompatible shapes: \(4, 4\) @ \(3,\).*tx.lie.Act\(T, p\)"),
        (A @ s, r"MatMul expects vectors or matrices, got \(3, 3\) @ \(\)"),
        (tx.Solve(P, x), r"Solve expects A to be a square matrix, got shape \(2, 3\)"),
        (tx.Solve(A, q), r"Solve expects b with shape \(3,\) or \(3, k\), got \(4,\)"),
        (tx.Inv(P), r"Inv expects operand to be a square matrix, got shape \(2, 3\)"),
        (tx.Trace(P), r"Trace expects operand to be a square matrix"),
        (tx.Diag(A), r"Diag expects a vector, got shape \(3, 3\)"),
        (tx.Cross(q, x), r"Cross expects left with shape \(3,\), got \(4,\)"),
        (tx.Dot(q, x), r"Dot expects two vectors of equal length, got shapes \(4,\) and \(3,\)"),
        (tx.Outer(A, x), r"Outer expects two vectors"),
        (tx.Norm(A, 3.5), r"Norm with ord=3.5 is not defined for shape \(3, 3\)"),
        (tx.QDCM(x), r"QDCM expects q with shape \(4,\), got \(3,\)"),
        (tx.SSM(q), r"SSM expects w with shape \(3,\), got \(4,\)"),
        (tx.SSMP(q), r"SSMP expects w with shape \(3,\), got \(4,\)"),
        (tx.QuaternionProduct(q, x), r"QuaternionProduct expects q with shape \(4,\), got \(3,\)"),
        (tx.Concat(x, A), r"Concat expects operands of one rank"),
        (tx.Concat(A, tx.Constant(np.ones((2, 2)))), r"Concat expects operands that agree in all axes but axis 0"),
        (tx.Stack([x, q]), r"Stack expects rows of one shape, got row 0 with shape \(3,\) and row 1 with shape \(4,\)"),
        (tx.Hstack([A, P]), r"Hstack expects operands that agree in all axes but axis 1"),
        (tx.Vstack([A, q]), r"Vstack expects operands that agree in all axes but axis 0"),
        (tx.Block([[A, x]]), r"Block expects equal heights in row 0, got \[3, 1\]"),
        (tx.Block([[A], [q]]), r"Block expects equal widths in column 0, got \[3, 4\]"),
        (s[0], r"Index expects an index into shape \(\), got \[0\]"),
        (x[3], r"Index expects an index into shape \(3,\), got \[3\]"),
        (x[0, 0], r"Index expects an index into shape \(3,\), got \[0, 0\]"),
        (A[:, -4], r"Index expects an index into shape \(3, 3\), got \[:, -4\]"),
        (x[3:], r"Index expects at least one entry, got none of shape \(3,\) at \[3:\]"),
        (tx.Linterp(s, A, x), r"Linterp expects xp to be a vector of two or more breakpoints, got shape \(3, 3\)"),
        (tx.Linterp(s, x, q), r"Linterp expects fp with a first axis of length 3 as xp has, got shape \(4,\)"),
        (tx.Bilerp(s, s, x, q, A), r"Bilerp expects fp with shape \(3, 4\), got \(3, 3\)"),
    ],
    ids=lambda value: repr(value)[:50] if isinstance(value, tx.Expr) else "",
)
def test_shape_errors(expr: tx.Expr, sentence: str) -> None:
    with pytest.raises(ShapeError, match=sentence) as caught:
        (2.0 * tx.Norm(expr) if not expr.boolean else expr).check_shape()
    assert isinstance(caught.value, ValueError)
    assert type(expr).__name__ in str(caught.value.at)


def test_a_shape_error_says_where_and_how_to_mend_it() -> None:
    wrong = 1.0 + tx.Norm(tx.Solve(A, x - tx.Cross(x, q)))
    with pytest.raises(ShapeError) as caught:
        wrong.check_shape()
    sentence, place = str(caught.value).splitlines()
    assert sentence == "Cross expects right with shape (3,), got (4,)"
    assert place == f"  at: Add.terms[1] -> Norm.operand -> Solve.b -> Sub.right -> Cross in {wrong!r}"
    mendable = tx.Sin(A @ s)
    with pytest.raises(ShapeError) as caught:
        mendable.check_shape()
    assert str(caught.value).splitlines()[-1] == "  fix: use * to multiply by a scalar"


def test_an_error_is_found_again() -> None:
    """A failed check leaves nothing behind."""
    wrong = x + q
    for _ in range(2):
        with pytest.raises(ShapeError, match="not broadcastable"):
            wrong.check_shape()


def test_operators_build_the_right_nodes() -> None:
    assert [type(e) for e in (x + 1, 1 - x, x * 2, 2 / x, A @ x, -x, x**2, 2**x, abs(x), x[0], A.T)] == [
        tx.Add, tx.Sub, tx.Mul, tx.Div, tx.MatMul, tx.Neg, tx.Power, tx.Power, tx.Abs, tx.Index, tx.Transpose,
    ]  # fmt: skip
    assert +x is x
    assert len(x) == 3
    assert [repr(part) for part in x] == ["x[0]", "x[1]", "x[2]"]
    assert x.shape == (3,)
    assert (A.ndim, s.ndim) == (2, 0)
    reversed_sides = x >= 1.0
    assert repr(reversed_sides) == "1. <= x"
    assert hash(x) == id(x)


@pytest.mark.parametrize("kind", [tx.fields.Operand, "Operand", "fields.Operand"])
def test_operands_are_told_by_class_and_by_name(kind: Any) -> None:
    """Annotations are classes, or text where a module says `from __future__ import annotations`."""
    own = type("Own", (tx.Expr,), {"__annotations__": {"x": kind, "k": int}, "abstract": True})
    assert [(field.name, field.operand) for field in own._fields] == [("x", True), ("k", False)]
    assert own(x, k=2).children() == [x]
