"""Functionals of a whole path: integrals, extremes, and initial values."""

from __future__ import annotations

from typing import Any, ClassVar, NoReturn

import jax

from ...checks import short
from ...errors import ModelError
from ...expr import Expr, Inputs, Leaf, State, to_expr


class Functional(Leaf):
    """A functional of a whole path: a leaf that represents an unknown of the problem.

    Attributes:
        operand: the expression along the path.
    """

    operand: Expr
    abstract = True

    def __init__(self, operand: Any) -> None:
        try:
            expr = to_expr(operand)
        except ModelError as error:
            raise ModelError(f"{type(self).__name__} expects an expression: {error}") from None
        if expr.boolean:
            raise ModelError(f"{type(self).__name__} expects a numerical expression, got the condition {expr!r}")
        text = repr(expr)
        self._declare(f"{self.label}({text[1:-1] if expr.infix else text})", self._shape_of(expr), operand=expr)

    def _shape_of(self, expr: Expr) -> tuple[int, ...]:
        return expr.shape

    def static_key(self) -> tuple[Any, ...]:
        return (self.operand.key(),)

    def outline(self) -> list[tuple[str, Expr]]:
        return [("operand", self.operand)]

    def read(self, inputs: Inputs) -> jax.Array:
        self.check_in_system()

    def check_in_system(self) -> NoReturn:
        raise ModelError(
            f"{self!r} is a functional of a whole path, which is not defined here.\n"
            "  fix: use it in the objective or final= of a tx.trajectory.Problem"
        )


class Integral(Functional):
    """The integral over time of an expression of states, controls, parameters and time, from the start of the path.

    In `final=` and in the objective, it extends over the whole path; in `at=`, up to the node; in a phase, over that
    phase. Shape: that of the operand. Unit: the operand's times s.

    Raises: ModelError if the operand is a condition.
    """

    cases = ((lambda cls, **_: cls(State("x") * 2.0), {"Integral(x * 2.)": 0.7}),)

    def to_latex(self, *operands: str) -> str:
        return rf"\int {self.operand.latex()} \, dt"


class Extreme(Functional):
    """The largest or the smallest value of an expression along a path.

    Attributes:
        sign: 1 for the largest, -1 for the smallest.
    """

    sign: ClassVar[float]
    abstract = True

    def _shape_of(self, expr: Expr) -> tuple[int, ...]:
        expr.check_shape()
        return ()

    def to_latex(self, *operands: str) -> str:
        return rf"\{'max' if self.sign > 0.0 else 'min'}_t {self.operand.latex()}"


class Maximum(Extreme):
    """The largest value of an expression of states, controls, parameters and time along the path, over all entries.

    It is an upper bound s with $operand <= s$ at all points where path constraints are imposed. So minimise it, or
    bound it from above in `final=`; otherwise s may exceed the largest value. Shape: ().

    Raises: ModelError if the operand is a condition.
    """

    sign = 1.0
    cases = ((lambda cls, **_: cls(State("x")), {"Maximum(x)": 0.7}),)


class Minimum(Extreme):
    """The smallest value of an expression along the path; see `Maximum`. Shape: ().

    Maximise it, or bound it from below: otherwise the unknown may be less than the smallest value.

    Raises: ModelError if the operand is a condition.
    """

    sign = -1.0
    cases = ((lambda cls, **_: cls(State("x")), {"Minimum(x)": 0.7}),)


class Initial(Functional):
    """The value of a state at the start of the path: `final=[x == tx.trajectory.Initial(x)]` makes a path periodic.

    In a problem of several phases, it is the value at the start of the first phase, which must have this state. Shape:
    that of the state.

    Raises: ModelError if the argument is not a state.
    """

    operand: State
    cases = ((lambda cls, **_: cls(State("x", shape=(2,))), {"Initial(x)": [0.7, -0.2]}),)

    def __init__(self, operand: Any) -> None:
        if not isinstance(operand, State):
            raise ModelError(f"Initial expects a state, got {short(operand)}")
        super().__init__(operand)

    def makes_group_element(self, *operands: bool) -> bool:
        return self.operand.is_group_element

    def to_latex(self, *operands: str) -> str:
        return rf"{self.operand.latex()}\left(0\right)"
