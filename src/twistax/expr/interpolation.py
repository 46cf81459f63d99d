"""Tables: piecewise linear, cubic and bilinear interpolation."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import short
from ..errors import ModelError, ShapeError
from .bases import broadcast
from .fields import ExprLike, Operand
from .leaves import Constant
from .node import Expr, Shape


def segment(x: jax.Array, xp: jax.Array) -> jax.Array:
    """Number of the interval of xp in which x lies, the outer ones continued without end.

    All breakpoints are compared at once: for tables of ordinary size that is faster in a loop than a binary search.
    """
    return jnp.searchsorted(xp[1:-1], x, side="right", method="compare_all")


def fraction(x: jax.Array, xp: jax.Array, i: jax.Array) -> jax.Array:
    """How far x, kept inside the table, has come from breakpoint i to the next: between 0 and 1."""
    return (jnp.clip(x, xp[0], xp[-1]) - xp[i]) / (xp[i + 1] - xp[i])


class Linterp(Expr):
    """Piecewise linear interpolation of a table (xp, fp) at x, entry by entry. Outside the table its end values hold.

    Shapes: x of any shape s, xp (n,), fp (n, *k) -> (*s, *k). At a breakpoint the slope on its right is taken, at the
    ends half of it.

    Attributes:
        x: where to look, in the unit of xp.
        xp: breakpoints, strictly increasing, two or more.
        fp: values at the breakpoints; their unit is the result's. May be a Parameter, like xp.
    Raises:
        ShapeError: xp is no vector, or fp has another length.
        ModelError: xp is constant and does not increase.
    """

    x: Operand
    xp: Operand
    fp: Operand
    cases = (
        {"x": [0.5, 2.0, -1.0, 4.0], "xp": Constant([0.0, 1.0, 3.0]), "fp": Constant([1.0, -1.0, 2.0])},
        {"x": 0.5, "xp": Constant([0.0, 1.0, 3.0]), "fp": np.arange(6.0).reshape(3, 2) ** 2},
    )
    kinks = ({"x": [0.0, 1.0, 3.0], "xp": Constant([0.0, 1.0, 3.0]), "fp": Constant([1.0, -1.0, 2.0])},)

    def validate(self) -> None:
        _increasing_if_constant(self, "xp", self.xp)

    def infer_shape(self, *shapes: Shape) -> Shape:
        x, xp, fp = shapes
        _breakpoints(self, "xp", xp)
        if not fp or fp[0] != xp[0]:
            raise ShapeError(f"Linterp expects fp with a first axis of length {xp[0]} as xp has, got shape {fp}")
        return x + fp[1:]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        x, xp, fp = values
        i = segment(x, xp)
        weight = fraction(x, xp, i).reshape(x.shape + (1,) * (fp.ndim - 1))
        return (1.0 - weight) * fp[i] + weight * fp[i + 1]


_KNOTS, _TABLE = np.array([0.0, 1.0, 3.0, 4.0, 6.0]), np.array([1.0, -1.0, 2.0, 2.5, 0.0])


class Cinterp(Expr):
    """Piecewise cubic interpolation of a fixed table (xp, fp) at x. Outside the table the end cubics are continued.

    Shapes: x of any shape s, xp (n,), fp (n, *k) -> (*s, *k). In interval i the value is
    c_0i + c_1i t + c_2i t^2 + c_3i t^3 with t = x - xp_i.

    Attributes:
        x: where to look, in the unit of xp.
        xp, fp: the table, numbers; xp strictly increasing.
        method: "cubic" (not-a-knot spline, two continuous derivatives), "pchip" (keeps monotone data monotone) or
            "akima" (little overshoot); the latter two have one continuous derivative.
        coeffs: c, shape (4, n - 1, *k).
    Raises:
        ModelError: an unknown method, a table that is an expression, has shapes that do not match or does not increase.
    Source: SciPy's `CubicSpline`, `PchipInterpolator` and `Akima1DInterpolator` compute c.
    """

    x: Operand
    xp: np.ndarray
    fp: np.ndarray
    method: str = "cubic"
    cases = (
        {"x": [0.5, 5.0, -0.5], "xp": _KNOTS, "fp": _TABLE},
        {"x": 0.5, "xp": _KNOTS, "fp": np.stack([_TABLE, -2.0 * _TABLE], axis=1), "method": "akima"},
    )
    kinks = ({"x": [1.0, 3.0, 6.0], "xp": _KNOTS, "fp": _TABLE, "method": "pchip"},)

    def __init__(self, x: ExprLike, xp: Any, fp: Any, method: str = "cubic") -> None:
        super().__init__(x, _numbers("xp", xp), _numbers("fp", fp), method)

    def validate(self) -> None:
        _increasing("Cinterp", "xp", self.xp)
        if not (np.isfinite(self.xp).all() and np.isfinite(self.fp).all()):
            raise ModelError(f"Cinterp expects finite numbers, got xp {short(self.xp)} and fp {short(self.fp)}")
        if self.fp.ndim < 1 or len(self.fp) != len(self.xp):
            raise ModelError(
                f"Cinterp expects fp with a first axis of length {len(self.xp)}, got shape {self.fp.shape}"
            )
        _ = self.coeffs

    @property
    def coeffs(self) -> np.ndarray:
        """Coefficients by rising power, computed once."""
        if "_coeffs" not in self.__dict__:
            self.__dict__["_coeffs"] = _cubic_coefficients(self.xp, self.fp, self.method)
        return self.__dict__["_coeffs"]

    def infer_shape(self, *shapes: Shape) -> Shape:
        return shapes[0] + self.fp.shape[1:]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        (x,) = values
        xp, coeffs = jnp.asarray(self.xp, x.dtype), jnp.asarray(self.coeffs, x.dtype)
        i = segment(x, xp)
        t = (x - xp[i]).reshape(x.shape + (1,) * (self.fp.ndim - 1))
        constant, linear, quadratic, cubic = coeffs[:, i]
        return constant + t * (linear + t * (quadratic + t * cubic))

    def details(self) -> list[str]:
        return [f"{len(self.xp)} points", *([] if self.method == "cubic" else [f"method={self.method!r}"])]


def _cubic_coefficients(xp: np.ndarray, fp: np.ndarray, method: str) -> np.ndarray:
    from scipy import interpolate

    methods: dict[str, Any] = {
        "cubic": interpolate.CubicSpline,
        "pchip": interpolate.PchipInterpolator,
        "akima": interpolate.Akima1DInterpolator,
    }
    if method not in methods:
        raise ModelError(f"Cinterp expects method to be one of {', '.join(methods)}, got {method!r}")
    return np.ascontiguousarray(methods[method](xp, fp).c[::-1])


_GRID = {
    "xp": Constant([0.0, 1.0, 3.0]),
    "yp": Constant([0.0, 2.0]),
    "fp": Constant([[1.0, -1.0], [0.5, 2.0], [4.0, 3.0]]),
}


class Bilerp(Expr):
    """Bilinear interpolation of a table over a grid at (x, y), entry by entry. Outside the grid its edge values hold.

    Shapes: x and y broadcast to s, xp (n,), yp (m,), fp (n, m) -> s. On a grid line the slope on its right is taken,
    at the edges half of it.

    Attributes:
        x, y: where to look, in the units of xp and yp.
        xp, yp: grid lines, strictly increasing, two or more.
        fp: fp[i, j] is the value at (xp[i], yp[j]); its unit is the result's.
    Raises:
        ShapeError: xp or yp is no vector, fp is not (n, m), or x and y do not broadcast.
        ModelError: xp or yp is constant and does not increase.
    """

    x: Operand
    y: Operand
    xp: Operand
    yp: Operand
    fp: Operand
    cases = ({"x": [0.5, 2.0, 4.0], "y": 0.7} | _GRID,)
    kinks = ({"x": [0.0, 1.0, 3.0], "y": 2.0} | _GRID,)

    def validate(self) -> None:
        _increasing_if_constant(self, "xp", self.xp)
        _increasing_if_constant(self, "yp", self.yp)

    def infer_shape(self, *shapes: Shape) -> Shape:
        x, y, xp, yp, fp = shapes
        _breakpoints(self, "xp", xp)
        _breakpoints(self, "yp", yp)
        if fp != xp + yp:
            raise ShapeError(
                f"Bilerp expects fp with shape {xp + yp}, got {fp}", hint="fp[i, j] belongs to (xp[i], yp[j])"
            )
        return broadcast(self, x, y)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        x, y, xp, yp, fp = values
        shape = jnp.broadcast_shapes(x.shape, y.shape)
        x, y = jnp.broadcast_to(x, shape), jnp.broadcast_to(y, shape)
        i, j = segment(x, xp), segment(y, yp)
        s, t = fraction(x, xp, i), fraction(y, yp, j)
        low = (1.0 - t) * fp[i, j] + t * fp[i, j + 1]
        high = (1.0 - t) * fp[i + 1, j] + t * fp[i + 1, j + 1]
        return (1.0 - s) * low + s * high


def _breakpoints(node: Expr, name: str, shape: Shape) -> None:
    if len(shape) != 1 or shape[0] < 2:
        raise ShapeError(
            f"{type(node).__name__} expects {name} to be a vector of two or more breakpoints, got shape {shape}"
        )


def _increasing_if_constant(node: Expr, name: str, points: Expr) -> None:
    if isinstance(points, Constant) and points.value.ndim == 1:
        _increasing(type(node).__name__, name, points.value)


def _increasing(node: str, name: str, points: np.ndarray) -> None:
    if points.ndim != 1 or len(points) < 2 or not (np.diff(points) > 0).all():
        raise ModelError(f"{node} expects {name} to be two or more strictly increasing numbers, got {points}")


def _numbers(name: str, value: Any) -> np.ndarray:
    if isinstance(value, Expr) and not isinstance(value, Constant):
        raise ModelError(
            f"Cinterp expects {name} to be numbers, got the expression {value!r}.\n"
            "  fix: its coefficients are computed when it is built; tx.Linterp takes a table that changes between runs"
        )
    return (value if isinstance(value, Constant) else Constant(value)).value
