"""Stiff equations in extended precision: Radau IIA of nine stages, order 17.

Stages and what they must satisfy are held in the longest float NumPy has; Newton's corrections, which only have to be
roughly right, are solved for in doubles. Nothing here uses the package's integrators.

Source: Hairer and Wanner, Solving Ordinary Differential Equations II, sections IV.5 and IV.8.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .arrays import Array

__all__ = ["collocated", "radau"]

_STAGES = 9
#: Rounds of Newton's method; it gains two or more digits in each.
_ROUNDS = 40
#: A step over the one before while a transient dies away.
_GROWTH = 1.3


def collocated(rate: Callable[[Any, Array], Array], y0: Array, duration: float, steps: int, fastest: float) -> Array:
    """y(duration) of y' = rate(t, y), in the precision of y0.

    Args:
        steps: how many there would be without the short ones at the start.
        fastest: rate of the fastest transient, 1/s. The first step is a tenth of its time.
    Raises:
        ArithmeticError: Newton's method does not converge.
    """
    y, t = y0, y0.dtype.type(0)
    for h in _lengths(y0.dtype.type(duration), steps, fastest):
        y, t = _step(rate, t, y, h), t + h
    return y


def _lengths(duration: Any, steps: int, fastest: float) -> Iterator[Any]:
    """Lengths of steps from a tenth of the fastest time up to duration / steps, and equal ones from there."""
    longest, left = duration / steps, duration
    h = min(longest, duration.dtype.type(0.1) / fastest)
    while h < longest:
        yield h
        left, h = left - h, _GROWTH * h
    count = int(np.ceil(left / longest))
    yield from (left / count for _ in range(count))


def _step(rate: Callable[[Any, Array], Array], t: Any, y: Array, h: Any) -> Array:
    """One step: the stages z_i = h sum_j a_ij rate(t + c_j h, y + z_j) as deviations from y, the last one the end."""
    c, a = radau(_STAGES)
    inverse = np.linalg.inv(np.eye(_STAGES * y.size) - np.kron((h * a).astype(float), _jacobian(rate, t, y)))
    z, last = np.zeros((_STAGES, y.size), y.dtype), np.inf
    for _ in range(_ROUNDS):
        found = np.stack([rate(t + node * h, y + stage) for node, stage in zip(c, z)])
        wrong = z - h * (a @ found)
        change = (inverse @ wrong.astype(float).ravel()).reshape(z.shape)
        z = z - change
        size = float(np.max(np.abs(change) / np.maximum(1.0, np.abs(y + z).astype(float))))
        # Small and no longer falling: what is left is round-off, which stiffness makes larger.
        if size == 0.0 or (size < 1e-13 and size > 0.5 * last):
            return y + z[-1]
        last = size
    raise ArithmeticError(f"Newton's method does not converge in the step of {float(h):g} s from t = {float(t):g} s")


def _jacobian(rate: Callable[[Any, Array], Array], t: Any, y: Array) -> Array:
    """By central differences."""
    columns = []
    for i in range(y.size):
        d = np.zeros_like(y)
        d[i] = 1e-6 * max(1.0, abs(float(y[i])))
        columns.append((rate(t, y + d) - rate(t, y - d)) / (2 * d[i]))
    return np.stack(columns, axis=1).astype(float)


@functools.cache
def radau(stages: int) -> tuple[Array, Array]:
    """Nodes c (n,) and weights a (n, n) of Radau IIA in extended precision.

    The nodes in [-1, 1] are the roots of P_n - P_(n-1), found by Newton's method. An interpolant in Legendre
    polynomials through them has the coefficients (2 j + 1) / 2 sum_i w_i P_j(x_i) f_i, since the rule is exact for the
    products of two polynomials of degree n - 1, and is integrated term by term.
    """
    x = np.sort(np.roots(np.polynomial.legendre.leg2poly([0] * (stages - 1) + [-1, 1])[::-1]).real)
    x = x.astype(np.longdouble)
    for _ in range(4):
        p, slope = _legendre(stages, x)
        x[:-1] -= ((p[-1] - p[-2]) / (slope[-1] - slope[-2]))[:-1]
        x[-1] = 1
    p, _ = _legendre(stages, x)
    w = (1 + x) / (stages * p[stages - 1]) ** 2
    degrees = np.arange(stages)[:, None]
    coefficients = (2 * degrees + 1) / np.longdouble(2) * p[:stages] * w
    # The integral of P_j from -1 to x is (P_(j+1) - P_(j-1)) / (2 j + 1), with P_(-1) = -1.
    below = np.concatenate([-np.ones((1, stages), np.longdouble), p[: stages - 1]])
    integrals = (p[1:] - below) / (2 * degrees + 1)
    return (1 + x) / 2, integrals.T @ coefficients / 2


def _legendre(degree: int, x: Array) -> tuple[Array, Array]:
    """P_0 to P_degree at x, and their derivatives: (degree + 1, n) each."""
    p, slope = [np.ones_like(x), x], [np.zeros_like(x), np.ones_like(x)]
    for j in range(1, degree):
        p.append(((2 * j + 1) * x * p[j] - j * p[j - 1]) / (j + 1))
        slope.append(slope[j - 1] + (2 * j + 1) * p[j])
    return np.stack(p), np.stack(slope)
