"""The model of a sensor: an expression, the group of its values, and the covariance of its errors."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..checks import number, reals, short
from ..errors import KindError, ModelError, ShapeError
from ..expr import Constant, Expr, Leaf, Noise, Parameter, State, declares, leaves_of, postorder, to_expr
from ..groups import SE3, SO3, Euclidean, Group
from ..units import Quantity


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Measurement:
    """A measurement $z = h(x) Exp(v)$ with zero-mean errors v; on $R^m$ it is $z = h(x) + v$.

    The residual of a filter is $Log(h(x)^-1 z)$, in the tangent space of the values.

    Args:
        name: the name, unique among the measurements of a filter.
        value: the expression h of states, controls, parameters and `tx.Noise`.
        covariance: covariance of v, in squares of the unit of the value, or of rad for angles: a number, an array (m,)
            of variances of the tangent's entries, or a symmetric positive definite matrix (m, m). Numbers, a Parameter
            or an expression.
        period: time between samples in s. A Noise of density S in the value has the covariance $S S^T / period$.
        group: the group of the values. By default SO3 or SE3 if the expression is a rotation or a pose, else $R^m$.
    Raises:
        ShapeError: the covariance has another shape; the value does not have the shape of the group.
        KindError: units of the value that do not fit each other, or a covariance with another unit than its square.
        ModelError: the covariance is not symmetric positive definite; there is neither a covariance nor a Noise; a
            Noise has no period; the value is a condition.

    Example: `tx.Measurement("gps", g[:3, 3], covariance=4.0)`, in m2.

    Source: Sola, Deray, Atchuthan, A micro Lie theory for state estimation in robotics (2018), sec. IV.
    """

    name: str
    value: Expr
    covariance: Expr | None
    period: float | None
    group: Group
    noises: tuple[Noise, ...]

    def __init__(
        self, name: str, value: Any, *, covariance: Any = None, period: float | None = None, group: Group | None = None
    ) -> None:
        if not isinstance(name, str) or not name:
            raise ModelError(f"Measurement needs a name: a non-empty string, got {name!r}")
        place = f"Measurement {name!r}"
        expr = to_expr(value)
        if expr.boolean:
            raise ModelError(f"{place} expects a numerical expression, got the condition {expr!r}")
        group = _group(place, expr, group)
        noises = tuple(leaf for leaf in leaves_of(expr) if isinstance(leaf, Noise))
        if period is not None:
            number(f"{place}: period", period, "a positive number of s", lambda T: 0.0 < T < np.inf, ModelError)
        if noises and period is None:
            raise ModelError(
                f"{place} has the continuous noise {noises[0].name!r}, so it needs the time between its samples.\n"
                "  fix: pass period=..., in s"
            )
        if covariance is None and not noises:
            raise ModelError(
                f"{place} expects the covariance of its errors.\n"
                "  fix: pass covariance=..., or use a tx.Noise in the value"
            )
        checked = None if covariance is None else covariance_of(f"{place}: covariance", covariance, group.dimension)
        _check_units(place, expr, checked, group)
        fields = {"name": name, "value": expr, "covariance": checked, "period": period}
        for field, content in {**fields, "group": group, "noises": noises}.items():
            object.__setattr__(self, field, content)


def _check_units(place: str, value: Expr, covariance: Expr | None, group: Group) -> None:
    """Raise KindError where units do not fit each other, or the covariance has not the square of that of the value."""
    roots = {place: value} | ({} if covariance is None else {f"{place}: covariance": covariance})
    nodes = postorder(*roots.values())
    if not any(map(declares, nodes)):
        return
    from ..expr.kinds.inference import infer_kinds  # most measurements do without

    known = infer_kinds(roots, {}, [node for node in nodes if isinstance(node, Leaf)], nodes)
    unit, squared = known.unit(value), None if covariance is None else known.unit(covariance)
    if group.flat and unit is not None and squared is not None and squared != unit**2:
        raise KindError(
            f"{place}: covariance expects the unit {unit**2}, the square of that of the value, got {squared}"
        )


def _group(place: str, value: Expr, group: Group | None) -> Group:
    if group is None:
        if isinstance(value, State):
            return value.group
        known: dict[tuple[int, ...], Group] = {(3, 3): SO3, (4, 4): SE3}
        return known[value.shape] if value.is_group_element else Euclidean(value.shape)
    if not isinstance(group, Group):
        raise ModelError(f"{place}: group must be tx.SO3, tx.SE3 or another Group, got {group!r}")
    if group.shape != value.shape:
        raise ShapeError(f"{place} on {group.name} expects a value of shape {group.shape}, got {value.shape}")
    return group


def covariance_of(place: str, value: Any, size: int) -> Expr:
    """A covariance as an expression, checked if its value is known. Raises ShapeError, ModelError."""
    expr = to_expr(value if isinstance(value, (Expr, Quantity)) else reals(place, value, ModelError))
    if expr.shape not in ((), (size,), (size, size)):
        raise ShapeError(f"{place} expects a number, shape ({size},) or ({size}, {size}), got {expr.shape}")
    known = expr.value if isinstance(expr, (Constant, Parameter)) else None
    if known is not None:
        check_definite(place, np.asarray(known, float), size, ModelError)
    return expr


def check_definite(place: str, value: np.ndarray, size: int, error: type[Exception], *, semi: bool = False) -> None:
    """Raise the error unless a numeric matrix is symmetric and positive definite, or semidefinite."""
    matrix = np.asarray(value, float)
    if matrix.ndim < 2:
        matrix = np.diag(np.broadcast_to(matrix, (size,)))
    if not np.isfinite(matrix).all():
        raise error(f"{place} expects finite numbers, got {short(value)}")
    size_of_entries = np.abs(matrix).max(initial=0.0)
    if np.abs(matrix - matrix.T).max(initial=0.0) > 1e-6 * size_of_entries:
        raise error(f"{place} expects a symmetric matrix, got {short(value)}.\n  fix: (P + P.T) / 2")
    # Entries of a covariance have units of their own: only the correlations can be compared with 1.
    deviations = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
    scale = np.where(deviations > 0.0, deviations, 1.0)
    least = np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min(initial=np.inf)
    if least < -1e-6 if semi else least <= 0.0:
        kind = "positive semidefinite" if semi else "positive definite"
        raise error(
            f"{place} expects a {kind} matrix, got {short(value)}, with a correlation matrix of least "
            f"eigenvalue {least:.3g}"
        )
