"""Circular and hyperbolic functions, entry by entry. Angles are in rad."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from .arithmetic import Neg
from .elementwise import Function, square_root
from .fields import Operand
from .node import Expr
from .shapes import Entrywise, align


class Sin(Function):
    """Sine of an angle in rad, entry by entry."""

    function = jnp.sin
    latex_name = r"\sin"


class Cos(Function):
    """Cosine of an angle in rad, entry by entry."""

    function = jnp.cos
    latex_name = r"\cos"

    def simplify(self) -> Expr:
        """cos(-x) is cos(x)."""
        return Cos(self.operand.operand) if isinstance(self.operand, Neg) else self


class Tan(Function):
    """Tangent of an angle in rad, entry by entry."""

    function = jnp.tan
    latex_name = r"\tan"


def _leg(x: jax.Array) -> jax.Array:
    """sqrt(1 - x^2) with derivative 0 at 1 and -1."""
    return square_root((1.0 - x) * (1.0 + x))


class Asin(Function):
    """Arcsine in rad, entry by entry, in [-pi/2, pi/2].

    At 1 and -1, where the true derivative is infinite, it is taken as 0; beyond, the value is NaN.
    """

    latex_name = r"\arcsin"
    cases = ({"operand": [0.9, -0.3, 0.0]},)
    kinks = ({"operand": [1.0, -1.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.arctan2(values[0], _leg(values[0]))


class Acos(Function):
    """Arccosine in rad, entry by entry, in [0, pi].

    At 1 and -1, where the true derivative is infinite, it is taken as 0; beyond, the value is NaN.
    """

    latex_name = r"\arccos"
    cases = ({"operand": [0.9, -0.3, 0.0]},)
    kinks = ({"operand": [1.0, -1.0]},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return jnp.arctan2(_leg(values[0]), values[0])


class Atan(Function):
    """Arctangent in rad, entry by entry, in [-pi/2, pi/2]."""

    function = jnp.arctan
    latex_name = r"\arctan"
    cases = ({"operand": [1.0, -20.0, 0.0]},)


class Atan2(Entrywise):
    """Angle of the point (x, y) in rad, entry by entry with broadcasting, in [-pi, pi].

    At the origin the value is 0 and the derivative is taken as 0.

    Attributes:
        y, x: the coordinates, in one unit.
    Raises:
        ShapeError: the shapes do not broadcast.
    """

    y: Operand
    x: Operand
    keeps_order = False
    cases = ({"y": [1.0, -2.0, 0.0], "x": 0.7}, {"y": [1.0, -2.0, 0.5], "x": -0.7})
    kinks = ({"y": [0.0, 0.0, 0.0], "x": 0.0},)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        y, x = align(*values)
        origin = (x == 0.0) & (y == 0.0)
        return jnp.arctan2(jnp.where(origin, 0.0, y), jnp.where(origin, 1.0, x))


class Sinh(Function):
    """Hyperbolic sine, entry by entry."""

    function = jnp.sinh
    latex_name = r"\sinh"


class Cosh(Function):
    """Hyperbolic cosine, entry by entry."""

    function = jnp.cosh
    latex_name = r"\cosh"


class Tanh(Function):
    """Hyperbolic tangent, entry by entry."""

    function = jnp.tanh
    latex_name = r"\tanh"
