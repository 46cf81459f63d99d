"""Functions applied entry by entry: powers, exponentials, size and sign."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from .arithmetic import Neg
from .fields import Operand
from .leaves import State
from .node import Example, Expr, Shape


class Entrywise(Expr):
    """Base of the functions of one operand: the result has the operand's shape."""

    abstract = True
    keeps_order = True

    def infer_shape(self, *shapes: Shape) -> Shape:
        return shapes[0]


def square_root(x: jax.Array) -> jax.Array:
    """sqrt(x) with derivative 0 at x = 0, where the true one is infinite; nan below."""
    zero = x == 0.0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, x)))


def absolute(x: jax.Array) -> jax.Array:
    """|x| with derivative 0 at x = 0; jnp.abs has 1 there."""
    return x * jnp.sign(x)


def entrywise_example(node: type[Expr], values: list[float], *, kinks: list[float] | None = None) -> list[Example]:
    """Cases of a function of one operand: at smooth places and, apart, at its kinks."""
    x, k = State("x", shape=(len(values),)), State("x", shape=(len(kinks or []) or 1,))
    cases = [Example(node(x), {"x": np.array(values)})]
    if kinks:
        cases.append(Example(node(k), {"x": np.array(kinks)}, smooth=False))
    return cases


class Square(Entrywise):
    """x^2, entry by entry; the unit of x squared."""

    x: Operand
    precedence = 40

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return values[0] * values[0]

    def simplify(self) -> Expr:
        """(-x)^2 is x^2."""
        return Square(self.x.operand) if isinstance(self.x, Neg) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\left({operands[0]}\right)^{{2}}"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


class Sqrt(Entrywise):
    """Square root sqrt(x), entry by entry. At x = 0 the derivative is taken as 0; below 0 the value is nan."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return square_root(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\sqrt{{{operands[0]}}}"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, 2.5, 0.1], kinks=[0.0])


class Exp(Entrywise):
    """Exponential e^x, entry by entry; x without unit. Of a twist: `tx.lie.SE3Exp`."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.exp(values[0])

    def simplify(self) -> Expr:
        """e^(log x) is x."""
        return self.operand.operand if isinstance(self.operand, Log) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\exp\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


class Log(Entrywise):
    """Natural logarithm log(x), entry by entry; x > 0 without unit. Of a pose: `tx.lie.SE3Log`."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.log(values[0])

    def simplify(self) -> Expr:
        """log(e^x) is x."""
        return self.operand.operand if isinstance(self.operand, Exp) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\log\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, 2.5, 0.1])


class Abs(Entrywise):
    """Absolute value |x|, entry by entry. The derivative at 0 is taken as 0."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return absolute(values[0])

    def simplify(self) -> Expr:
        """|-x| is |x|; the absolute value, square or root of something is not negative already."""
        if isinstance(self.operand, Neg):
            return Abs(self.operand.operand)
        return self.operand if isinstance(self.operand, (Abs, Square, Sqrt, Exp)) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\left|{operands[0]}\right|"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.5], kinks=[0.0])


class Sign(Entrywise):
    """Sign of x, entry by entry: 1, 0 or -1, without unit. The derivative is 0 everywhere, at the jump too."""

    operand: Operand
    keeps_order = False

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.sign(values[0])

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.5], kinks=[0.0])


__all__ = ["Abs", "Exp", "Log", "Sign", "Sqrt", "Square"]
