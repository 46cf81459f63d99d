"""Norms as second-order cones: |a| <= b becomes a.a <= b^2 and b >= 0, which is twice differentiable. If b is a
variable, the form |a|^2 / b <= b keeps the multiplier finite as b goes to zero.

Roots of squares are treated as norms. For magnitudes of entries, |a| <= b becomes a <= b and -a <= b.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from ...expr import (
    Abs,
    Add,
    Constant,
    Control,
    Div,
    Dot,
    Expr,
    MatMul,
    Mul,
    Neg,
    Norm,
    Parameter,
    Power,
    Sqrt,
    State,
    Sub,
    leaves_of,
)
from ..transcription.point_values import PointValues

#: A coefficient and its factor.
Term = tuple[float, Expr]


def without_norms(residual: Expr) -> list[Expr]:
    """Smooth rows (<= 0 each) that are equivalent to residual <= 0 if the residual has one norm, as a linear term; else
    the residual itself.

    c |a| + r <= 0 with c > 0 becomes a.a - b^2 <= 0 and -b <= 0 with b = -r / c, or a.a / b - b <= 0 if b is a variable
    with the limit b >= 0. With c < 0 and a constant r, it becomes b^2 - a.a <= 0. With magnitudes of entries and c > 0,
    it becomes c a + r <= 0 and -c a + r <= 0.
    """
    terms = linear_terms(residual)
    sizes = [(factor, part) for factor, part in terms if isinstance(part, Abs)]
    if len(sizes) == 1 and sizes[0][0] > 0.0:
        ((factor, size),) = sizes
        rest = sum_of([term for term in terms if term[1] is not size])
        (operand,) = size.children()
        return [(rest + side * factor * operand).canonicalize() for side in (1.0, -1.0)]
    norms = [term for term in terms if is_norm(term[1])]
    if residual.shape != () or len(norms) != 1 or norms[0][0] == 0.0:
        return [residual]
    ((factor, norm),) = norms
    bound = sum_of([(-coefficient / factor, part) for coefficient, part in terms if part is not norm]).canonicalize()
    number = float(bound.value) if isinstance(bound, Constant) else None
    if factor < 0.0 and (number is None or number < 0.0):
        return [residual]
    if factor > 0.0 and _is_never_negative(bound):
        return [bound_row(norm, bound)]
    squares = _square(norm) - bound * bound if factor > 0.0 else bound * bound - _square(norm)
    sides = [] if number is not None and number >= 0.0 else [-bound]
    return [row.canonicalize() for row in (squares, *sides)]


def bound_rows(s: Control, size: Expr) -> list[Expr]:
    """Smooth rows (<= 0 each) that are equivalent to size <= s for non-negative s."""
    return [bound_row(size, s)] if is_norm(size) else without_norms((size - s).canonicalize())


def _is_never_negative(bound: Expr) -> bool:
    """Whether an expression is a positive multiple of a scalar state or control whose lower limit is not negative."""
    terms = linear_terms(bound)
    return len(terms) == 1 and terms[0][0] > 0.0 and _has_limit_at_zero(terms[0][1])


def _has_limit_at_zero(leaf: Expr) -> bool:
    return isinstance(leaf, (State, Control)) and leaf.shape == () and leaf.min is not None and float(leaf.min) >= 0.0


def bound_row(size: Expr, s: Expr) -> Expr:
    """A residual that is <= 0 if and only if size <= s, for s > 0: |a|^2 / s - s for a norm.

    Its multiplier stays finite as s goes to zero. The multiplier of |a|^2 - s^2 grows like 1 / s, and Newton steps only
    halve s.
    Source: H. Y. Benson, R. J. Vanderbei, Solving problems with semidefinite and related constraints using
    interior-point methods for nonlinear programming, Mathematical Programming 95 (2003), section 2.
    """
    return (_square(size) / s - s if is_norm(size) else size - s).canonicalize()


def norm_bound(row: Expr) -> tuple[str, float] | None:
    """The name of s in a row |a|^2 / (c s) - c s from `bound_row`, and c; None for any other row."""
    terms = linear_terms(row)
    if len(terms) != 2:
        return None
    (factor, quotient), (negative, s) = terms
    if not isinstance(quotient, Div) or not isinstance(s, (State, Control)):
        return None
    below = linear_terms(quotient.children()[1])
    if factor <= 0.0 or len(below) != 1 or below[0][0] != -negative or below[0][1].key() != s.key() or s.shape != ():
        return None
    return s.name, -negative


def values_of(sizes: Sequence[Expr], us: Mapping[str, Any], params: Mapping[str, Any]) -> list[np.ndarray]:
    """(rows, ...) values of expressions of controls and parameters, for each row of the controls."""
    rows = max((len(values) for values in us.values()), default=1)
    values = PointValues.of(sizes)(np.zeros(rows), {}, us, params)
    ends = np.cumsum([math.prod(size.shape) for size in sizes])
    parts = zip(np.split(values, ends[:-1], axis=1), sizes, strict=True)
    return [part.reshape(rows, *size.shape) for part, size in parts]


def bounds_along(
    bounds: Mapping[str, Expr], us: Mapping[str, np.ndarray], params: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    """The values of the bounded norms, by the name of the bounding control, along controls with a row for each interval
    or node.
    """
    values = {}
    for name, size in bounds.items():
        read = {leaf.name for leaf in leaves_of(size) if isinstance(leaf, Control)}
        (values[name],) = values_of([size], {leaf: us[leaf] for leaf in read}, params)
    return values


def is_mixed(size: Expr, smooth: Collection[str]) -> bool:
    """Whether an expression reads both piecewise constant and continuous controls, so that no bound of it is tight."""
    return len({leaf.name in smooth for leaf in leaves_of(size) if isinstance(leaf, Control)}) > 1


def above(values: np.ndarray) -> np.ndarray:
    """Initial values of bounds, slightly above the bounded values."""
    bounds: np.ndarray = values + 0.1 * (values.max() or 1.0)
    return bounds


def sizes_in(running: Expr | None, sign: float) -> tuple[Expr | None, list[Control], list[Expr]]:
    """A running cost in which norms and magnitudes of controls, which are not differentiable at zero, are replaced by
    bounds.

    Returns the cost, a control s for each such norm, and the norm. Piecewise constant controls make such a norm
    constant over an interval, so its bound s is one number there. At a minimum, s = |a|.
    """
    if running is None:
        return None, [], []
    kept: list[Term] = []
    bounds: dict[str, tuple[Control, Expr]] = {}
    for factor, part in linear_terms(running.canonicalize()):
        if is_size(part) and sign * factor > 0.0:
            part, _ = bounds.setdefault(part.key(), (Control(f"bound on {part!r}", min=0.0), part))
        kept.append((factor, part))
    controls, sizes = [bound for bound, _ in bounds.values()], [size for _, size in bounds.values()]
    return sum_of(kept).canonicalize() if bounds else running, controls, sizes


def linear_terms(expr: Expr, factor: float = 1.0) -> list[Term]:
    """The terms of a sum, each with its coefficient."""
    if isinstance(expr, Add):
        return [term for part in expr.terms for term in linear_terms(part, factor)]
    if isinstance(expr, Sub):
        left, right = expr.children()
        return [*linear_terms(left, factor), *linear_terms(right, -factor)]
    if isinstance(expr, Neg):
        return linear_terms(expr.children()[0], -factor)
    if isinstance(expr, (Mul, Div)):
        parts = expr.children()
        numbers = [p for p in parts if isinstance(p, Constant) and p.shape == ()]
        rest = [p for p in parts if all(p is not n for n in numbers)]
        if isinstance(expr, Div) and (not numbers or numbers[0] is not parts[1]):
            return [(factor, expr)]
        if len(rest) == 1:
            size = float(np.prod([float(n.value) for n in numbers]))
            return linear_terms(rest[0], factor / size if isinstance(expr, Div) else factor * size)
    return [(factor, expr)]


def sum_of(terms: list[Term]) -> Expr:
    """The expression of a list of terms."""
    total: Expr = Constant(0.0)
    for factor, part in terms:
        total = total + factor * part
    return total


def is_norm(expr: Expr) -> bool:
    """Whether it is the Euclidean norm of a vector, or the root of its square."""
    if isinstance(expr, Sqrt) and expr.shape == ():
        (operand,) = expr.children()
        return all(factor > 0.0 and _is_square(part) for factor, part in linear_terms(operand))
    return isinstance(expr, Norm) and expr.ord == "fro" and len(expr.operand.shape) == 1


def is_size(expr: Expr) -> bool:
    """Whether it is a norm or a magnitude of controls, possibly scaled by parameters."""
    leaves = list(leaves_of(expr))
    of_controls = all(isinstance(leaf, (Control, Parameter, Constant)) for leaf in leaves)
    of_controls = of_controls and any(isinstance(leaf, Control) for leaf in leaves)
    return of_controls and (is_norm(expr) or (isinstance(expr, Abs) and expr.shape == ()))


def _is_square(expr: Expr) -> bool:
    """Whether it is a square in a usual form: x**2, x * x, a @ a."""
    parts = expr.children()
    if isinstance(expr, Power):
        return isinstance(parts[1], Constant) and parts[1].shape == () and float(parts[1].value) == 2.0
    return isinstance(expr, (Dot, MatMul, Mul)) and len(parts) == 2 and parts[0].key() == parts[1].key()


def _square(norm: Expr) -> Expr:
    (operand,) = norm.children()
    if isinstance(norm, Sqrt):
        return operand
    return Dot(operand, operand)
