"""Greatest, least and their smooth relatives, entry by entry."""

from __future__ import annotations

import functools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ModelError
from .arithmetic import rebuilt
from .elementwise import Entrywise, entrywise_example
from .fields import ExprLike, Operand, Operands
from .leaves import Constant, State
from .node import Example, Expr, Shape
from .shapes import align, broadcast


class Extremum(Expr):
    """Base of what combines two or more operands, entry by entry, and may be nested or folded in any order."""

    operands: Operands
    abstract = True
    associative = True
    keeps_order = True
    #: How two constants combine.
    combine: ClassVar[Any]
    #: Whether x with x is x.
    idempotent: ClassVar[bool] = True

    def __init__(self, *operands: ExprLike) -> None:
        super().__init__(*operands)

    def validate(self) -> None:
        if len(self.operands) < 2:
            raise ValueError(f"{type(self).__name__} requires two or more operands")

    def infer_shape(self, *shapes: Shape) -> Shape:
        return broadcast(self, *shapes)

    def simplify(self) -> Expr:
        """Constants fold into one, equal operands count once. Nested ones are flattened before."""
        constants = [o.value for o in self.operands if isinstance(o, Constant)]
        others = [o for o in self.operands if not isinstance(o, Constant)]
        if self.idempotent:
            others = list({o.key(): o for o in others}.values())
        if constants:
            others.append(Constant(functools.reduce(type(self).combine, constants)))
        return rebuilt(self, others, self.operands)

    @classmethod
    def example(cls) -> list[Example]:
        a, s = State("a", shape=(3,)), State("s")
        values = {"a": np.array([1.0, -2.0, 0.5]), "s": 0.25}
        return [Example(cls(a, s), values), Example(cls(a, a[::-1], -1.0), values | {"a": np.array([1.0, -3.0, 0.5])})]


class Max(Extremum):
    """Greatest of two or more operands, entry by entry with broadcasting, in one unit.

    Where several are greatest the derivative is shared: two operands take one half each.

    Raises:
        ShapeError: the shapes do not broadcast.
        ValueError: fewer than two operands.
    """

    combine = np.maximum

    def __init__(self, *operands: ExprLike) -> None:
        super().__init__(*operands)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return functools.reduce(lambda a, b: jnp.maximum(*align(a, b)), values)

    def to_latex(self, *operands: str) -> str:
        return rf"\max\left({', '.join(operands)}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        a = State("a", shape=(2,))
        return [*super().example(), Example(cls(a, 1.0), {"a": np.array([1.0, 1.0])}, smooth=False)]


class Min(Extremum):
    """Least of two or more operands, entry by entry with broadcasting, in one unit.

    Where several are least the derivative is shared: two operands take one half each.

    Raises:
        ShapeError: the shapes do not broadcast.
        ValueError: fewer than two operands.
    """

    combine = np.minimum

    def __init__(self, *operands: ExprLike) -> None:
        super().__init__(*operands)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return functools.reduce(lambda a, b: jnp.minimum(*align(a, b)), values)

    def to_latex(self, *operands: str) -> str:
        return rf"\min\left({', '.join(operands)}\right)"

    @classmethod
    def example(cls) -> list[Example]:
        a = State("a", shape=(2,))
        return [*super().example(), Example(cls(a, 1.0), {"a": np.array([1.0, 1.0])}, smooth=False)]


class LogSumExp(Extremum):
    """log(e^a + e^b + ...), entry by entry with broadcasting: a smooth maximum, above it by at most log(number).

    It does not overflow for large operands.

    Raises:
        ShapeError: the shapes do not broadcast.
        ValueError: fewer than two operands.
    """

    combine = np.logaddexp
    idempotent = False

    def __init__(self, *operands: ExprLike) -> None:
        super().__init__(*operands)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jax.nn.logsumexp(jnp.stack(jnp.broadcast_arrays(*align(*values))), axis=0)


class PositivePart(Entrywise):
    """max(x, 0), entry by entry. The derivative at 0 is taken as 1/2."""

    x: Operand

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.maximum(values[0], 0.0)

    def to_latex(self, *operands: str) -> str:
        return rf"\left({operands[0]}\right)_+"

    @classmethod
    def example(cls) -> list[Example]:
        return entrywise_example(cls, [1.0, -2.0, 0.5], kinks=[0.0])


class Huber(Entrywise):
    """Huber's penalty, entry by entry: x^2 / 2 for |x| <= delta, delta (|x| - delta / 2) beyond.

    Attributes:
        delta: where it turns from a parabola into a line, positive, in the unit of x.
    Raises:
        ModelError: delta is not a positive number.
    Source: Huber, Robust estimation of a location parameter (1964).
    """

    x: Operand
    delta: float = 0.25
    keeps_order = False

    def validate(self) -> None:
        _positive_number(self, "delta", self.delta)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        near = jnp.clip(values[0], -self.delta, self.delta)
        return near * (values[0] - 0.5 * near)

    @classmethod
    def example(cls) -> list[Example]:
        x = State("x", shape=(4,))
        return [Example(Huber(x, delta=0.5), {"x": np.array([0.1, -0.2, 2.0, -3.0])})]


class SmoothReLU(Entrywise):
    """sqrt(max(x, 0)^2 + c^2) - c, entry by entry: max(x, 0) with the kink rounded off.

    Computed as p^2 / (sqrt(p^2 + c^2) + c), p = max(x, 0), which loses no digits when x is small.

    Attributes:
        c: size of the rounding, positive, in the unit of x.
    Raises:
        ModelError: c is not a positive number.
    """

    x: Operand
    c: float = 1e-8

    def validate(self) -> None:
        _positive_number(self, "c", self.c)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        part = jnp.maximum(values[0], 0.0)
        return part * part / (jnp.sqrt(part * part + self.c * self.c) + self.c)

    @classmethod
    def example(cls) -> list[Example]:
        x = State("x", shape=(4,))
        values = {"x": np.array([0.3, -0.2, 2.0, 0.05])}
        return [Example(SmoothReLU(x, c=0.1), values), Example(SmoothReLU(x), {"x": np.zeros(4)}, smooth=False)]


def _positive_number(node: Expr, name: str, value: Any) -> None:
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not number or not 0.0 < value < np.inf:
        raise ModelError(f"{type(node).__name__} expects {name} to be a positive number, got {value!r}")


__all__ = ["Huber", "LogSumExp", "Max", "Min", "PositivePart", "SmoothReLU"]
