"""Elementwise functions. Angles are in rad."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from ..bases import Entrywise, align
from ..fields import Operand, positive
from ..kinds import rules
from ..moved import earlier_classes
from ..node import Expr
from .arithmetic import Neg

__getattr__ = earlier_classes(__name__)

_ANY, _POSITIVE = {"operand": [1.0, -2.0, 0.0]}, {"operand": [1.0, 2.5, 0.1]}
_NOT_ZERO, _ZERO = {"operand": [1.0, -2.0, 0.5]}, {"operand": [0.0]}


class ElementwiseFunction(Entrywise):
    """Base class of functions of one operand, each defined by a function of arrays."""

    operand: Operand
    abstract = True
    cases = (_ANY,)
    #: Whether f(-x) is f(x).
    even: ClassVar[bool] = False

    def simplify(self) -> Expr:
        """An even function of -x is that of x."""
        return type(self)(self.operand.operand) if self.even and isinstance(self.operand, Neg) else self


def square_root(x: jax.Array) -> jax.Array:
    """sqrt(x) with derivative 0 at x = 0, where the true derivative is infinite; NaN for negative x."""
    zero = x == 0.0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, x)))


def absolute(x: jax.Array) -> jax.Array:
    """|x| with derivative 0 at x = 0; jnp.abs has 1 there."""
    return x * jnp.sign(x)


class Square(Entrywise):
    """$x^2$, entry by entry; the unit of x squared."""

    x: Operand
    kinds = rules.SQUARE
    formula = r"\left(<0>\right)^{2}"
    precedence = 40
    cases = ({"x": [1.0, -2.0, 0.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return values[0] * values[0]

    def simplify(self) -> Expr:
        """(-x)^2 is x^2."""
        return Square(self.x.operand) if isinstance(self.x, Neg) else self


class Sqrt(ElementwiseFunction):
    """Square root sqrt(x), entry by entry. At x = 0 the derivative is taken as 0; below 0 the value is NaN."""

    kinds = rules.ROOT
    function = square_root
    formula = r"\sqrt{<0>}"
    cases = (_POSITIVE,)
    kinks = (_ZERO,)


class Exp(ElementwiseFunction):
    """Exponential $e^x$, entry by entry; x has no unit. For a twist use `tx.lie.SE3Exp`."""

    kinds = rules.NUMBERS
    function = jnp.exp
    latex_name = r"\exp"

    def simplify(self) -> Expr:
        """e^(log x) is x."""
        return self.operand.operand if isinstance(self.operand, Log) else self


class Log(ElementwiseFunction):
    """Natural logarithm log(x), entry by entry; x > 0 has no unit. For a pose use `tx.lie.SE3Log`."""

    kinds = rules.NUMBERS
    function = jnp.log
    latex_name = r"\log"
    cases = (_POSITIVE,)

    def simplify(self) -> Expr:
        """log(e^x) is x."""
        return self.operand.operand if isinstance(self.operand, Exp) else self


class Abs(ElementwiseFunction):
    """Absolute value |x|, entry by entry. The derivative at 0 is defined as 0."""

    kinds = rules.SIZE
    function = absolute
    even = True
    formula = r"\left|<0>\right|"
    cases = (_NOT_ZERO,)
    kinks = (_ZERO,)

    def simplify(self) -> Expr:
        """The absolute value of a square, a root or an absolute value is that value."""
        return self.operand if isinstance(self.operand, (Abs, Square, Sqrt, Exp)) else super().simplify()


class Sign(ElementwiseFunction):
    """Sign of x, entry by entry: 1, 0 or -1, without unit. The derivative is 0 everywhere, at the jump too."""

    kinds = rules.SIGN
    function = jnp.sign
    keeps_order = False
    cases = (_NOT_ZERO,)
    kinks = (_ZERO,)


class Sin(ElementwiseFunction):
    """Sine of an angle in rad, entry by entry."""

    kinds = rules.NUMBERS
    function = jnp.sin
    latex_name = r"\sin"


class Cos(ElementwiseFunction):
    """Cosine of an angle in rad, entry by entry."""

    kinds = rules.NUMBERS
    function = jnp.cos
    even = True
    latex_name = r"\cos"


class Tan(ElementwiseFunction):
    """Tangent of an angle in rad, entry by entry."""

    kinds = rules.NUMBERS
    function = jnp.tan
    latex_name = r"\tan"


def _leg(x: jax.Array) -> jax.Array:
    """sqrt(1 - x^2) with derivative 0 at 1 and -1."""
    return square_root((1.0 - x) * (1.0 + x))


class Asin(ElementwiseFunction):
    """Arcsine in rad, entry by entry, in [-pi/2, pi/2].

    At 1 and -1, where the true derivative is infinite, it is taken as 0; beyond, the value is NaN.
    """

    kinds = rules.NUMBERS
    latex_name = r"\arcsin"
    cases = ({"operand": [0.9, -0.3, 0.0]},)
    kinks = ({"operand": [1.0, -1.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.arctan2(values[0], _leg(values[0]))


class Acos(ElementwiseFunction):
    """Arccosine in rad, entry by entry, in [0, pi].

    At 1 and -1, where the true derivative is infinite, it is taken as 0; beyond, the value is NaN.
    """

    kinds = rules.NUMBERS
    latex_name = r"\arccos"
    cases = ({"operand": [0.9, -0.3, 0.0]},)
    kinks = ({"operand": [1.0, -1.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.arctan2(_leg(values[0]), values[0])


class Atan(ElementwiseFunction):
    """Arctangent in rad, entry by entry, in [-pi/2, pi/2]."""

    kinds = rules.NUMBERS
    function = jnp.arctan
    latex_name = r"\arctan"
    cases = ({"operand": [1.0, -20.0, 0.0]},)


class Atan2(Entrywise):
    """Angle of the point (x, y) in rad, entry by entry with broadcasting, in [-pi, pi].

    At the origin, for all signs of its zeros, the value is 0 and the derivative is taken as 0.

    Attributes:
        y, x: the coordinates, in one unit.
    Raises: ShapeError if the shapes do not broadcast.
    """

    y: Operand
    x: Operand
    kinds = rules.RATIO
    keeps_order = False
    cases = ({"y": [1.0, -2.0, 0.0], "x": 0.7}, {"y": [1.0, -2.0, 0.5], "x": -0.7})
    kinks = ({"y": [0.0, 0.0, 0.0], "x": 0.0},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        y, x = align(*values)
        origin = (x == 0.0) & (y == 0.0)
        return jnp.arctan2(jnp.where(origin, 0.0, y), jnp.where(origin, 1.0, x))


class Sinh(ElementwiseFunction):
    """Hyperbolic sine, entry by entry."""

    kinds = rules.NUMBERS
    function = jnp.sinh
    latex_name = r"\sinh"


class Cosh(ElementwiseFunction):
    """Hyperbolic cosine, entry by entry."""

    kinds = rules.NUMBERS
    function = jnp.cosh
    latex_name = r"\cosh"


class Tanh(ElementwiseFunction):
    """Hyperbolic tangent, entry by entry."""

    kinds = rules.NUMBERS
    function = jnp.tanh
    latex_name = r"\tanh"


class PositivePart(Entrywise):
    """max(x, 0), entry by entry. The derivative at 0 is taken as 1/2."""

    x: Operand
    kinds = rules.ALIKE
    formula = r"\left(<0>\right)_+"
    cases = ({"x": [1.0, -2.0, 0.5]},)
    kinks = ({"x": [0.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.maximum(values[0], 0.0)


class Huber(Entrywise):
    """Huber's penalty, entry by entry: $x^2 / 2$ for $|x| <= delta$, $delta (|x| - delta / 2)$ beyond.

    Attributes:
        delta: the boundary between the parabola and the line, positive, in the unit of x.
    Raises: ModelError if delta is not a positive number.
    Source: Huber, Robust estimation of a location parameter (1964).
    """

    x: Operand
    delta: float = 0.25
    kinds = rules.SQUARE
    cases = ({"x": [0.1, -0.2, 2.0, -3.0], "delta": 0.5},)
    keeps_order = False

    def validate(self) -> None:
        positive(self, "delta", self.delta)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        near = jnp.clip(values[0], -self.delta, self.delta)
        return near * (values[0] - 0.5 * near)


class SmoothReLU(Entrywise):
    """$sqrt(max(x, 0)^2 + c^2) - c$, entry by entry: a smooth approximation of max(x, 0).

    Computed as $p^2 / (sqrt(p^2 + c^2) + c)$ with $p = max(x, 0)$, without cancellation for small x. Values are scaled
    before they are squared, so that they do not overflow.

    Attributes:
        c: width of the smoothing, positive, in the unit of x.
    Raises: ModelError if c is not a positive number.
    """

    x: Operand
    c: float = 1e-8
    kinds = rules.ALIKE
    cases = ({"x": [0.3, -0.2, 2.0, 0.05], "c": 0.1},)
    kinks = ({"x": [0.0, 0.0]},)

    def validate(self) -> None:
        positive(self, "c", self.c)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        part = jnp.maximum(values[0], 0.0)
        # The result does not depend on the size, so neither does its derivative. Of the largest numbers 1 / x is
        # subnormal, which XLA drops; of a quarter of them it is not.
        size = jax.lax.stop_gradient(jnp.maximum(0.25 * part, 0.25 * self.c))
        p, c = part / size, self.c / size
        return size * (p * (p / (jnp.sqrt(p * p + c * c) + c)))
