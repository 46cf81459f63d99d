"""Tables: interpolation of numbers over any number of axes, and of tables that change between runs over one or two
axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import short
from ...errors import ModelError, ShapeError
from ..bases import Variadic, broadcast
from ..fields import ExprLike, Operand, Operands
from ..kinds import array_rules, rules
from ..leaves import Constant
from ..node import Expr, Shape
from .kinds import BSpline, Clamped, Extrapolated, Linear, Lookup, MonotoneCubic, Refused, linear, pieces

_KNOTS, _TABLE = np.array([0.0, 1.0, 3.0, 4.0, 6.0]), np.array([1.0, -1.0, 2.0, 2.5, 0.0])
_EVEN = np.linspace(-1.0, 1.0, 5)


class Interp(Variadic, init=False):
    """Interpolation of a table of numbers over a grid of any number of axes, entry by entry.

    Shapes: d coordinates that broadcast to s, axes of n_1, ..., n_d points, values (n_1, ..., n_d, *k) -> (*s, *k).
    Values are loaded from constant arrays, also in kernels, in C and in CasADi. The cost grows with the number of axes,
    $2^d$ loads for linear and $4^d$ for cubic interpolation, and hardly with the number of points. The interval on an
    axis with approximately equal steps is found by a multiplication, on another one by bisection.

    Attributes:
        at: the coordinates, one or more, in the units of their axes.
        axes: the points of each axis, strictly increasing numbers; a single axis need not be in a list.
        values: values[i, j, ...] is the value at (axes[0][i], axes[1][j], ...); numbers, whose unit is that of the
            result.
        kind: `tx.tables.Linear()`, `MonotoneCubic()` of one axis, or `BSpline()`.
        outside: the extrapolation: `tx.tables.Clamped()`, `Extrapolated()`, or `Refused()`, which gives NaN; or a list
            of one for each axis.
    Raises:
        ShapeError: the coordinates do not broadcast.
        ModelError: an axis that does not increase or has too few points; values of another shape; a table that is an
            expression or not finite; another kind; `MonotoneCubic()` with more than one axis.
    """

    at: Operands
    axes: Any
    values: Any
    kind: Any = Linear()
    outside: Any = Clamped()
    listed = True
    if TYPE_CHECKING:

        def __init__(
            self, *at: ExprLike | Sequence[ExprLike], axes: Any, values: Any, kind: Any = ..., outside: Any = ...
        ) -> None: ...

    kinds = rules.OPEN
    cases = (
        {"at": [[0.5, 5.0, -0.5]], "axes": _KNOTS, "values": _TABLE},
        {
            "at": [[0.5, -0.3], 2.0],
            "axes": (_EVEN, _KNOTS),
            "values": np.outer(_EVEN**2, _TABLE),
            "kind": BSpline(),
            "outside": Extrapolated(),
        },
        {"at": [0.3], "axes": _EVEN, "values": np.stack([_TABLE, _TABLE**2], 1), "kind": MonotoneCubic()},
    )
    kinks = ({"at": [[0.0, 1.0, 6.0]], "axes": _KNOTS, "values": _TABLE, "outside": (Refused(),)},)

    def validate(self) -> None:
        alone = not isinstance(self.axes, (list, tuple)) or not any(map(np.ndim, self.axes))
        axes = [self.axes] if alone and not isinstance(self.axes, Expr) else self.axes
        self.axes = tuple(_numbers("Interp", f"axes[{k}]", points) for k, points in enumerate(axes))
        self.values = _numbers("Interp", "values", self.values)
        if len(self.axes) != len(self.at):
            raise ModelError(f"Interp expects an axis for each coordinate, got {len(self.at)} and {len(self.axes)}")
        if not isinstance(self.kind, (Linear, MonotoneCubic, BSpline)):
            raise ModelError(
                f"Interp expects kind to be tx.tables.Linear(), MonotoneCubic() or BSpline(), got {self.kind!r}"
            )
        for k, points in enumerate(self.axes):
            _increasing("Interp", f"axes[{k}]", points)
            if len(points) < self.kind.fewest:
                raise ModelError(
                    f"Interp by {self.kind!r} expects {self.kind.fewest} or more points, axes[{k}] has {len(points)}"
                )
        lengths = tuple(map(len, self.axes))
        if self.values.shape[: len(lengths)] != lengths or not np.isfinite(self.values).all():
            raise ModelError(
                f"Interp expects values, finite numbers, with first axes of length {lengths}, "
                f"got shape {self.values.shape}: {short(self.values)}"
            )
        if isinstance(self.outside, list):
            self.outside = tuple(self.outside)
        if not all(isinstance(outside, (Clamped, Extrapolated, Refused)) for outside in self._outsides):
            raise ModelError(
                "Interp expects outside to be tx.tables.Clamped(), Extrapolated() or Refused(), or a list of one for "
                f"each axis, got {self.outside!r}"
            )
        self._read()

    @property
    def _outsides(self) -> tuple[Any, ...]:
        if not isinstance(self.outside, tuple):
            return (self.outside,) * len(self.axes)
        return self.outside if len(self.outside) == len(self.axes) else (None,)

    def _read(self) -> Lookup:
        return _once(self, lambda: self.kind.lookup(self.axes, self.values))

    def infer_shape(self, *shapes: Shape) -> Shape:
        return broadcast(self, *shapes) + self.values.shape[len(self.axes) :]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        shape = jnp.broadcast_shapes(*(x.shape for x in values))
        taken = (outside.taken(x, points) for outside, x, points in zip(self._outsides, values, self.axes, strict=True))
        return self._read()([jnp.broadcast_to(x, shape) for x in taken])

    def details(self) -> list[str]:
        lines = [f"{' x '.join(str(len(points)) for points in self.axes)} points"]
        return lines + [f"{name}={choice!r}" for name, choice in self._choices() if choice is not None]

    def _choices(self) -> list[tuple[str, Any]]:
        kind, outside = (None if type(a) in (Linear, Clamped) else a for a in (self.kind, self.outside))
        return [("kind", kind), ("outside", outside)]


def _once(node: Expr, make: Callable[[], Lookup]) -> Lookup:
    """The lookup of a table of numbers, made once."""
    if "_lookup" not in node.__dict__:
        node.__dict__["_lookup"] = make()
    return node.__dict__["_lookup"]


class _OnGrid(Expr):
    """Base of piecewise linear tables: its operands are the coordinates, the points of their axes, and the values."""

    kinds = array_rules.TABLE
    abstract = True

    def validate(self) -> None:
        count = len(self.children()) // 2
        for name, points in list(zip(self.child_names(), self.children(), strict=True))[count:-1]:
            if isinstance(points, Constant) and points.value.ndim == 1:
                _increasing(type(self).__name__, name, points.value)

    def evaluate(self, *values: jax.Array) -> jax.Array:
        count = len(values) // 2
        axes, fp = values[count:-1], values[-1]
        shape = jnp.broadcast_shapes(*(x.shape for x in values[:count]))
        inside = [jnp.clip(jnp.broadcast_to(x, shape), p[0], p[-1]) for x, p in zip(values[:count], axes, strict=True)]
        table = [operand for operand in self.children()[count:] if isinstance(operand, Constant)]
        if len(table) > count:
            return _once(self, lambda: linear([points.value for points in table[:-1]], table[-1].value))(inside)
        # All breakpoints are compared at once: for tables of ordinary size that is faster in a loop than halving.
        starts = [
            jnp.searchsorted(p[1:-1], x, side="right", method="compare_all") for x, p in zip(inside, axes, strict=True)
        ]
        parts = [(x - p[i]) / (p[i + 1] - p[i]) for x, p, i in zip(inside, axes, starts, strict=True)]
        weights = [part.reshape(shape + (1,) * (fp.ndim - count)) for part in parts]

        def along(axis: int, *places: jax.Array) -> jax.Array:
            """The value on the line, or in the plane, of the axes from this one on."""
            if axis == count:
                return fp[places]
            i, weight = starts[axis], weights[axis]
            return (1.0 - weight) * along(axis + 1, *places, i) + weight * along(axis + 1, *places, i + 1)

        return along(0)


class Linterp(_OnGrid):
    """Piecewise linear interpolation of a table (xp, fp) at x, entry by entry, constant outside of the table.

    Shapes: x of any shape s, xp (n,), fp (n, *k) -> (*s, *k). The derivative at a breakpoint is the slope on its right,
    and at the ends half of the slope inside.

    Attributes:
        x: the coordinate, in the unit of xp.
        xp: breakpoints, strictly increasing, two or more.
        fp: values at the breakpoints; their unit is that of the result. Like xp, it may be a Parameter.
    Raises:
        ShapeError: xp is not a vector, or fp has another length.
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

    def infer_shape(self, *shapes: Shape) -> Shape:
        x, xp, fp = shapes
        _breakpoints(self, "xp", xp)
        if not fp or fp[0] != xp[0]:
            raise ShapeError(f"Linterp expects fp with a first axis of length {xp[0]} as xp has, got shape {fp}")
        return x + fp[1:]


class Cinterp(Expr):
    """Piecewise cubic interpolation of a fixed table (xp, fp) at x.

    Outside of the table the outermost cubics are continued.

    Shapes: x of any shape s, xp (n,), fp (n, *k) -> (*s, *k). In interval i the value is
    $c_0i + c_1i t + c_2i t^2 + c_3i t^3$ with $t = x - xp_i$.

    Attributes:
        x: the coordinate, in the unit of xp.
        xp, fp: the table, numbers; xp strictly increasing.
        method: "cubic" (not-a-knot spline, two continuous derivatives), "pchip" (preserves monotonicity) or "akima"
            (little overshoot); the latter two have one continuous derivative.
        coeffs: c, shape (4, n - 1, *k).
    Raises:
        ModelError: an unknown method; a table that is an expression, whose shapes do not match, or that does not
            increase.
    Source: SciPy's `CubicSpline`, `PchipInterpolator` and `Akima1DInterpolator` compute c.
    """

    x: Operand
    xp: np.ndarray
    fp: np.ndarray
    method: str = "cubic"
    kinds = rules.OPEN
    cases = (
        {"x": [0.5, 5.0, -0.5], "xp": _KNOTS, "fp": _TABLE},
        {"x": 0.5, "xp": _KNOTS, "fp": np.stack([_TABLE, -2.0 * _TABLE], axis=1), "method": "akima"},
    )
    kinks = ({"x": [1.0, 3.0, 6.0], "xp": _KNOTS, "fp": _TABLE, "method": "pchip"},)

    def __init__(self, x: ExprLike, xp: Any, fp: Any, method: str = "cubic") -> None:
        super().__init__(x, _numbers("Cinterp", "xp", xp), _numbers("Cinterp", "fp", fp), method)

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
        return _once(self, lambda: pieces(self.xp, self.coeffs))(values)

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


class Bilerp(_OnGrid):
    """Bilinear interpolation of a table over a grid at (x, y), entry by entry, constant outside of the grid.

    Shapes: x and y broadcast to s, xp (n,), yp (m,), fp (n, m) -> s. The derivative on a grid line is the slope on its
    right, and at the edges half of the slope inside.

    Attributes:
        x, y: the coordinates, in the units of xp and yp.
        xp, yp: grid lines, strictly increasing, two or more.
        fp: fp[i, j] is the value at (xp[i], yp[j]); its unit is that of the result.
    Raises:
        ShapeError: xp or yp is not a vector, fp is not (n, m), or x and y do not broadcast.
        ModelError: xp or yp is constant and does not increase.
    """

    x: Operand
    y: Operand
    xp: Operand
    yp: Operand
    fp: Operand
    cases = ({"x": [0.5, 2.0, 4.0], "y": 0.7} | _GRID,)
    kinks = ({"x": [0.0, 1.0, 3.0], "y": 2.0} | _GRID,)

    def infer_shape(self, *shapes: Shape) -> Shape:
        x, y, xp, yp, fp = shapes
        _breakpoints(self, "xp", xp)
        _breakpoints(self, "yp", yp)
        if fp != xp + yp:
            raise ShapeError(
                f"Bilerp expects fp with shape {xp + yp}, got {fp}", hint="fp[i, j] belongs to (xp[i], yp[j])"
            )
        return broadcast(self, x, y)


def _breakpoints(node: Expr, name: str, shape: Shape) -> None:
    if len(shape) != 1 or shape[0] < 2:
        raise ShapeError(
            f"{type(node).__name__} expects {name} to be a vector of two or more breakpoints, got shape {shape}"
        )


def _increasing(node: str, name: str, points: np.ndarray) -> None:
    if points.ndim != 1 or len(points) < 2 or not np.isfinite(points).all() or not (np.diff(points) > 0).all():
        raise ModelError(f"{node} expects {name} to be two or more finite, strictly increasing numbers, got {points}")


def _numbers(node: str, name: str, value: Any) -> np.ndarray:
    if isinstance(value, Expr) and not isinstance(value, Constant):
        raise ModelError(
            f"{node} expects {name} to be numbers, got the expression {value!r}.\n"
            "  fix: its table is fixed at construction; for a table that changes between runs use "
            "tx.Linterp or tx.Bilerp"
        )
    return (value if isinstance(value, Constant) else Constant(value)).value
