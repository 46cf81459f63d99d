"""Functions applied entry by entry: powers, exponentials, size and sign."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from .arithmetic import Neg
from .fields import Operand
from .node import Expr
from .shapes import Entrywise


class Function(Entrywise):
    """Base of the functions of one operand, each of them given by a function of arrays."""

    operand: Operand
    abstract = True
    function: ClassVar[Callable[[jax.Array], Any]]
    cases = ({"operand": [1.0, -2.0, 0.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return type(self).function(values[0])


def square_root(x: jax.Array) -> jax.Array:
    """sqrt(x) with derivative 0 at x = 0, where the true one is infinite; NaN below."""
    zero = x == 0.0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, x)))


def absolute(x: jax.Array) -> jax.Array:
    """|x| with derivative 0 at x = 0; jnp.abs has 1 there."""
    return x * jnp.sign(x)


class Square(Entrywise):
    """x^2, entry by entry; the unit of x squared."""

    x: Operand
    precedence = 40
    cases = ({"x": [1.0, -2.0, 0.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return values[0] * values[0]

    def simplify(self) -> Expr:
        """(-x)^2 is x^2."""
        return Square(self.x.operand) if isinstance(self.x, Neg) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\left({operands[0]}\right)^{{2}}"


class Sqrt(Function):
    """Square root sqrt(x), entry by entry. At x = 0 the derivative is taken as 0; below 0 the value is NaN."""

    function = square_root
    cases = ({"operand": [1.0, 2.5, 0.1]},)
    kinks = ({"operand": [0.0]},)

    def to_latex(self, *operands: str) -> str:
        return rf"\sqrt{{{operands[0]}}}"


class Exp(Function):
    """Exponential e^x, entry by entry; x without unit. Of a twist: `tx.lie.SE3Exp`."""

    function = jnp.exp
    latex_name = r"\exp"

    def simplify(self) -> Expr:
        """e^(log x) is x."""
        return self.operand.operand if isinstance(self.operand, Log) else self


class Log(Function):
    """Natural logarithm log(x), entry by entry; x > 0 without unit. Of a pose: `tx.lie.SE3Log`."""

    function = jnp.log
    latex_name = r"\log"
    cases = ({"operand": [1.0, 2.5, 0.1]},)

    def simplify(self) -> Expr:
        """log(e^x) is x."""
        return self.operand.operand if isinstance(self.operand, Exp) else self


class Abs(Function):
    """Absolute value |x|, entry by entry. The derivative at 0 is taken as 0."""

    function = absolute
    cases = ({"operand": [1.0, -2.0, 0.5]},)
    kinks = ({"operand": [0.0]},)

    def simplify(self) -> Expr:
        """|-x| is |x|; the absolute value, square or root of something is not negative already."""
        if isinstance(self.operand, Neg):
            return Abs(self.operand.operand)
        return self.operand if isinstance(self.operand, (Abs, Square, Sqrt, Exp)) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\left|{operands[0]}\right|"


class Sign(Function):
    """Sign of x, entry by entry: 1, 0 or -1, without unit. The derivative is 0 everywhere, at the jump too."""

    function = jnp.sign
    keeps_order = False
    cases = ({"operand": [1.0, -2.0, 0.5]},)
    kinks = ({"operand": [0.0]},)
