"""Greatest, least and their smooth relatives, entry by entry."""

from __future__ import annotations

import functools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from .arithmetic import rebuilt
from .fields import ExprLike, Operand, Operands, positive
from .leaves import Constant, State
from .node import Example, Expr
from .shapes import Entrywise, align


class Extremum(Entrywise):
    """Base of what combines two or more operands, entry by entry, and may be nested or folded in any order."""

    operands: Operands
    fewest = 2
    abstract = True
    associative = True
    #: How two constants combine.
    combine: ClassVar[Any]
    #: Whether x with x is x.
    idempotent: ClassVar[bool] = True

    def __init__(self, *operands: ExprLike) -> None:
        super().__init__(*operands)

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
        return [
            Example(cls(a, s), values),
            Example(cls(a, a[::-1], -1.0), values | {"a": np.array([1.0, -3.0, 0.5])}),
            Example(cls(a, 1.0), values | {"a": np.ones(3)}, smooth=False),
        ]


class Max(Extremum):
    """Greatest of two or more operands, entry by entry with broadcasting, in one unit.

    Where several are greatest the derivative is shared: two operands take one half each.

    Raises:
        ShapeError: the shapes do not broadcast.
        ValueError: fewer than two operands.
    """

    combine = np.maximum
    latex_name = r"\max"

    def __init__(self, *operands: ExprLike) -> None:
        super().__init__(*operands)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return functools.reduce(lambda a, b: jnp.maximum(*align(a, b)), values)


class Min(Extremum):
    """Least of two or more operands, entry by entry with broadcasting, in one unit.

    Where several are least the derivative is shared: two operands take one half each.

    Raises:
        ShapeError: the shapes do not broadcast.
        ValueError: fewer than two operands.
    """

    combine = np.minimum
    latex_name = r"\min"

    def __init__(self, *operands: ExprLike) -> None:
        super().__init__(*operands)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return functools.reduce(lambda a, b: jnp.minimum(*align(a, b)), values)


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
    cases = ({"x": [1.0, -2.0, 0.5]},)
    kinks = ({"x": [0.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.maximum(values[0], 0.0)

    def to_latex(self, *operands: str) -> str:
        return rf"\left({operands[0]}\right)_+"


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
    cases = ({"x": [0.1, -0.2, 2.0, -3.0], "delta": 0.5},)
    keeps_order = False

    def validate(self) -> None:
        positive(self, "delta", self.delta)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        near = jnp.clip(values[0], -self.delta, self.delta)
        return near * (values[0] - 0.5 * near)


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
    cases = ({"x": [0.3, -0.2, 2.0, 0.05], "c": 0.1},)
    kinks = ({"x": [0.0, 0.0]},)

    def validate(self) -> None:
        positive(self, "c", self.c)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        part = jnp.maximum(values[0], 0.0)
        return part * part / (jnp.sqrt(part * part + self.c * self.c) + self.c)
