"""Circular and hyperbolic functions, entry by entry. Angles are in rad."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from .arithmetic import Neg
from .elementwise import Entrywise, entrywise_example, square_root
from .fields import Operand
from .leaves import State
from .node import Example, Expr, Shape
from .shapes import align, broadcast


class Sin(Entrywise):
    """Sine of an angle in rad, entry by entry."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.sin(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\sin\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


class Cos(Entrywise):
    """Cosine of an angle in rad, entry by entry."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.cos(values[0])

    def simplify(self) -> Expr:
        """cos(-x) is cos(x)."""
        return Cos(self.operand.operand) if isinstance(self.operand, Neg) else self

    def to_latex(self, *operands: str) -> str:
        return rf"\cos\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


class Tan(Entrywise):
    """Tangent of an angle in rad, entry by entry."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.tan(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\tan\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


def _leg(x: jax.Array) -> jax.Array:
    """sqrt(1 - x^2) with derivative 0 at 1 and -1."""
    return square_root((1.0 - x) * (1.0 + x))


class Asin(Entrywise):
    """Arcsine in rad, entry by entry, in [-pi/2, pi/2].

    At 1 and -1, where the true derivative is infinite, it is taken as 0; beyond, the value is nan.
    """

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.arctan2(values[0], _leg(values[0]))

    def to_latex(self, *operands: str) -> str:
        return rf"\arcsin\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [0.9, -0.3, 0.0], kinks=[1.0, -1.0])


class Acos(Entrywise):
    """Arccosine in rad, entry by entry, in [0, pi].

    At 1 and -1, where the true derivative is infinite, it is taken as 0; beyond, the value is nan.
    """

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.arctan2(_leg(values[0]), values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\arccos\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [0.9, -0.3, 0.0], kinks=[1.0, -1.0])


class Atan(Entrywise):
    """Arctangent in rad, entry by entry, in [-pi/2, pi/2]."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.arctan(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\arctan\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -20.0, 0.0])


class Atan2(Expr):
    """Angle of the point (x, y) in rad, entry by entry with broadcasting, in [-pi, pi].

    At the origin the value is 0 and the derivative is taken as 0.

    Attributes:
        y, x: the coordinates, in one unit.
    Raises:
        ShapeError: the shapes do not broadcast.
    """

    y: Operand
    x: Operand

    def infer_shape(self, *shapes: Shape) -> Shape:
        return broadcast(self, *shapes)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        y, x = align(*values)
        origin = (x == 0.0) & (y == 0.0)
        return jnp.arctan2(jnp.where(origin, 0.0, y), jnp.where(origin, 1.0, x))

    @classmethod
    def example(cls) -> list[Example]:
        y, x = State("y", shape=(3,)), State("x")
        return [
            Example(Atan2(y, x), {"y": np.array([1.0, -2.0, 0.0]), "x": 0.7}),
            Example(Atan2(y, x), {"y": np.array([1.0, -2.0, 0.5]), "x": -0.7}),
            Example(Atan2(y, x), {"y": np.zeros(3), "x": 0.0}, smooth=False),
        ]


class Sinh(Entrywise):
    """Hyperbolic sine, entry by entry."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.sinh(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\sinh\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


class Cosh(Entrywise):
    """Hyperbolic cosine, entry by entry."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.cosh(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\cosh\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


class Tanh(Entrywise):
    """Hyperbolic tangent, entry by entry."""

    operand: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.tanh(values[0])

    def to_latex(self, *operands: str) -> str:
        return rf"\tanh\left({operands[0]}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.0])


__all__ = ["Acos", "Asin", "Atan", "Atan2", "Cos", "Cosh", "Sin", "Sinh", "Tan", "Tanh"]
