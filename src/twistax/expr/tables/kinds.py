"""Kinds of table lookup: the interval of each axis, the interpolating polynomials, and the extrapolation.

Intervals are found by loads from constant arrays: for an even axis, a multiplication gives a first guess of the
interval; other axes take as many bisection steps as the number of points has bits. So the cost grows with the number of
axes and hardly with the number of points.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError

if TYPE_CHECKING:
    from ...scalar.primitives.table_load import Table

#: From coordinates of one shape s to the values (*s, *k) there.
Lookup: TypeAlias = Callable[[Sequence[jax.Array]], jax.Array]

# ---- one axis --------------------------------------------------------------------------------------------------------


def _table(values: Any) -> Table:
    from ...scalar.primitives.table_load import Table  # not at import: it loads much of JAX that `import jax` does not

    return Table(values)


def _load(table: Table, place: jax.Array, dtype: Any, offset: int = 0) -> jax.Array:
    from ...scalar.primitives.table_load import load

    return load(table, place, dtype, offset)


class GridAxis:
    """The breakpoints of one axis."""

    def __init__(self, points: np.ndarray) -> None:
        self.points = points
        self._table, self._inner = _table(points), _table(points[1:-1])
        ideal = np.linspace(points[0], points[-1], len(points))
        #: How many intervals a unit has, where all are about equal.
        self._density = (len(points) - 1) / (points[-1] - points[0])
        self._even = bool((np.abs(points - ideal) * self._density < 0.25).all())

    def interval(self, x: jax.Array) -> jax.Array:
        """The index of the interval of x, that on the right of a breakpoint; the outermost intervals are unbounded."""
        count = len(self.points) - 2
        place = jnp.zeros(x.shape, jnp.int32)
        if not count:
            return place
        if self._even:
            # Half an interval low, so that round-off and uneven points leave it right or one too low.
            guess = (x - float(self.points[0])) * float(self._density) - 0.5
            place = jnp.clip(guess, 0.0, float(count - 1)).astype(jnp.int32)
        while not self._even and count > 1:
            half = count // 2
            place = jnp.where(x >= _load(self._inner, place, x.dtype, half - 1), place + half, place)
            count -= half
        return place + (x >= _load(self._inner, place, x.dtype)).astype(jnp.int32)

    def fraction(self, x: jax.Array, i: jax.Array) -> jax.Array:
        """The fraction of the distance from breakpoint i to the next: exactly 0 and 1 at these."""
        start, end = (_load(self._table, i, x.dtype, k) for k in (0, 1))
        return (x - start) / (end - start)

    def beyond(self, x: jax.Array, i: jax.Array) -> jax.Array:
        """x minus breakpoint i."""
        return x - _load(self._table, i, x.dtype)


def _spread(a: jax.Array, rest: tuple[int, ...]) -> jax.Array:
    """With an axis of length one for each of those that values have beyond the grid's."""
    return a.reshape(a.shape + (1,) * len(rest))


def _places(first: jax.Array, rest: tuple[int, ...]) -> jax.Array:
    """The places of the entries over these axes, which lie one after the other."""
    if not rest:
        return first
    offsets = np.arange(math.prod(rest), dtype=np.int32).reshape((1,) * first.ndim + rest)
    return _spread(first, rest) + offsets


def _weighted(
    table: Table, place: jax.Array, weights: Sequence[Sequence[jax.Array]], shape: tuple[int, ...]
) -> jax.Array:
    """sum_kl... w0_k w1_l ... table[place + (k, l, ...)], of a table of a shape whose last axes have no weights."""
    rest, strides = shape[len(weights) :], [math.prod(shape[axis + 1 :]) for axis in range(len(weights))]
    places, by_axis = _places(place, rest), [[_spread(w, rest) for w in of_axis] for of_axis in weights]

    def summed(axis: int, offset: int) -> jax.Array:
        if axis == len(by_axis):
            return _load(table, places, by_axis[0][0].dtype, offset)
        terms = (w * summed(axis + 1, offset + k * strides[axis]) for k, w in enumerate(by_axis[axis]))
        return functools.reduce(jnp.add, terms)

    return summed(0, 0)


def _at(starts: Sequence[jax.Array], shape: tuple[int, ...]) -> jax.Array:
    """The place of the entry at these indices of the first axes, in a table of a shape."""
    places = (start * np.int32(math.prod(shape[axis + 1 :])) for axis, start in enumerate(starts))
    return functools.reduce(jnp.add, places)


def linear(axes: Sequence[np.ndarray], values: np.ndarray) -> Lookup:
    """Linear along each axis; the outermost lines are continued."""
    lines, table = [GridAxis(points) for points in axes], _table(values)

    def lookup(xs: Sequence[jax.Array]) -> jax.Array:
        starts = [axis.interval(x) for axis, x in zip(lines, xs, strict=True)]
        parts = [axis.fraction(x, i) for axis, x, i in zip(lines, xs, starts, strict=True)]
        return _weighted(table, _at(starts, values.shape), [[1.0 - t, t] for t in parts], values.shape)

    return lookup


def pieces(points: np.ndarray, coefficients: np.ndarray) -> Lookup:
    """Polynomials by rising power, (p, n - 1, *k), of x minus the breakpoint on its left; the outermost ones are
    continued.
    """
    axis, ordered = GridAxis(points), np.moveaxis(coefficients, 0, 1)
    table, rest = _table(ordered), coefficients.shape[2:]
    powers, size = len(coefficients), math.prod(rest)

    def lookup(xs: Sequence[jax.Array]) -> jax.Array:
        (x,) = xs
        i = axis.interval(x)
        t, places = _spread(axis.beyond(x, i), rest), _places(i * np.int32(powers * size), rest)
        coefficients = [_load(table, places, x.dtype, k * size) for k in range(powers)]
        return functools.reduce(lambda total, c: c + t * total, reversed(coefficients))

    return lookup


class _Basis:
    """The four cubic B-splines that are not zero at a place of one axis, knots not-a-knot, ends continued.

    The first of them is A (r - x)^3 and the last B (x - l)^3 between knots l and r, and all add up to one.
    """

    def __init__(self, points: np.ndarray, knots: np.ndarray) -> None:
        from scipy.interpolate import BSpline

        count = len(points)
        basis = BSpline(knots, np.eye(count), 3)
        powers = [basis(knots[3:count], nu=p) / math.factorial(p) for p in range(4)]
        rows = [
            [*knots[k + 3 : k + 5], -powers[3][k, k], powers[3][k, k + 3], *(power[k, k + 1] for power in powers)]
            for k in range(count - 3)
        ]
        self._axis, self._table, self._last = GridAxis(points), _table(rows), count - 4

    def at(self, x: jax.Array) -> tuple[jax.Array, list[jax.Array]]:
        """The index of the first of them, and their values."""
        # The second and the last point but one are no knots.
        start = jnp.clip(self._axis.interval(x) - 1, 0, self._last)
        left, right, down, up, *coefficients = (_load(self._table, 8 * start, x.dtype, k) for k in range(8))
        s, rest = x - left, right - x
        first, last = down * rest * rest * rest, up * s * s * s
        second = functools.reduce(lambda total, c: c + s * total, reversed(coefficients))
        return start, [first, second, 1.0 - first - second - last, last]


def spline(axes: Sequence[np.ndarray], values: np.ndarray) -> Lookup:
    """Cubic with two continuous derivatives; the outermost polynomials are continued."""
    from scipy.interpolate import CubicSpline, make_interp_spline

    if len(axes) == 1:
        return pieces(axes[0], np.ascontiguousarray(CubicSpline(axes[0], values).c[::-1]))
    coefficients, bases = values, []
    for k, points in enumerate(axes):
        fitted = make_interp_spline(points, np.moveaxis(coefficients, k, 0))
        coefficients = np.moveaxis(fitted.c, 0, k)
        bases.append(_Basis(points, fitted.t))
    table = _table(coefficients)

    def lookup(xs: Sequence[jax.Array]) -> jax.Array:
        starts, weights = zip(*(basis.at(x) for basis, x in zip(bases, xs, strict=True)), strict=True)
        return _weighted(table, _at(starts, values.shape), weights, values.shape)

    return lookup


# ---- what users choose -----------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Linear:
    """Linear interpolation along each axis: continuous. The derivative at a breakpoint is the slope on its right."""

    fewest = 2

    def lookup(self, axes: Sequence[np.ndarray], values: np.ndarray) -> Lookup:
        return linear(axes, values)


@dataclasses.dataclass(frozen=True)
class MonotoneCubic:
    """Cubic interpolation along one axis with one continuous derivative, monotone wherever the data are.

    It does not extend to several axes: its slopes are not linear in the values, so a tensor product would depend on the
    order of the axes, and would not be monotone.

    Source: F. Fritsch, J. Butland, A method for constructing local monotone piecewise cubic interpolants (1984), the
    weighted harmonic means of SciPy's `PchipInterpolator`, which computes the coefficients.
    """

    fewest = 2

    def lookup(self, axes: Sequence[np.ndarray], values: np.ndarray) -> Lookup:
        from scipy.interpolate import PchipInterpolator

        if len(axes) > 1:
            raise ModelError(
                f"MonotoneCubic interpolates along one axis, got {len(axes)}: a tensor product would "
                "depend on the order of the axes, and would not be monotone.\n"
                "  fix: tx.tables.Linear() or tx.tables.BSpline()"
            )
        try:
            with np.errstate(all="ignore"):
                coefficients = np.ascontiguousarray(PchipInterpolator(axes[0], values).c[::-1])
        except ValueError:  # of slopes that are not finite
            coefficients = np.array(np.nan)
        if not np.isfinite(coefficients).all():
            raise ModelError(
                "MonotoneCubic expects values whose differences and slopes are finite numbers, got values up to "
                f"{np.max(np.abs(values)):.3g} on points as near as {np.min(np.diff(axes[0])):.3g}.\n"
                "  fix: pass values and points in larger units"
            )
        return pieces(axes[0], coefficients)


@dataclasses.dataclass(frozen=True)
class BSpline:
    """Cubic interpolation with two continuous derivatives, a tensor product of not-a-knot splines; useful for
    optimisation.

    It interpolates all values, and may overshoot between them. Each axis needs at least four points.

    Source: C. de Boor, A Practical Guide to Splines (1978), chapters IX and XVII; SciPy computes the coefficients.
    """

    fewest = 4

    def lookup(self, axes: Sequence[np.ndarray], values: np.ndarray) -> Lookup:
        return spline(axes, values)


@dataclasses.dataclass(frozen=True)
class Clamped:
    """Constant outside of the table, with the value at the nearest edge. The derivative at the edge is half of that
    inside.
    """

    def taken(self, x: jax.Array, points: np.ndarray) -> jax.Array:
        """The coordinate at which the table is evaluated."""
        return jnp.clip(x, float(points[0]), float(points[-1]))


@dataclasses.dataclass(frozen=True)
class Extrapolated:
    """Outside of the table the polynomials of the outermost intervals are continued."""

    def taken(self, x: jax.Array, points: np.ndarray) -> jax.Array:
        """The coordinate at which the table is evaluated."""
        return x


@dataclasses.dataclass(frozen=True)
class Refused:
    """Outside of the table the value and the derivative are NaN, and an integration ends with an error."""

    def taken(self, x: jax.Array, points: np.ndarray) -> jax.Array:
        """The coordinate at which the table is evaluated."""
        # A factor: where(..., x, nan) would have the slope zero outside.
        return x * jnp.where((x >= float(points[0])) & (x <= float(points[-1])), 1.0, jnp.nan)
