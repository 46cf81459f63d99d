"""Checks of the arguments of the functions of mechanics."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import listed, number, short
from ..errors import ModelError, ShapeError
from ..expr import Constant, Expr, Parameter, canonicalize_all, to_expr
from ..expr.fields import ExprLike
from ..expr.graph import leaves_of, substitute
from ..expr.lie.base import check_element
from ..expr.transformations.rate import changing
from ..units import Quantity, same_unit


def of_shape(
    owner: str,
    name: str,
    value: ExprLike,
    shape: tuple[int, ...],
    hint: str | None = None,
    unit: Quantity | None = None,
) -> Expr:
    """The argument `name` of `owner` as an expression of an expected shape.

    Raises:
        InputError: its unit is not the expected one.
        ModelError: it is neither an expression nor numbers.
        ShapeError: its shape is another one; `hint` is a remedy for the message.
    """
    if unit is not None:
        same_unit(f"{owner}: {name}", value, unit)
    try:
        expr = to_expr(value)
    except ModelError as error:
        raise ModelError(f"{owner} expects {name} with shape {shape}: {error}") from None
    if expr.shape != shape:
        raise ShapeError(f"{owner} expects {name} with shape {shape}, got {expr.shape}", hint=hint)
    return expr


def scalar(
    owner: str,
    name: str,
    value: ExprLike,
    what: str = "a finite number",
    holds: Callable[[float], Any] = np.isfinite,
) -> Expr:
    """The argument `name` of `owner`, a number or a scalar expression.

    Raises:
        ModelError: it is neither, or a condition; or its value, with the default values of Parameters, does not satisfy
            `holds`, which `what` describes.
        ShapeError: it is not a scalar.
    """
    place = f"{owner}: {name}"
    if not isinstance(value, Expr):
        return to_expr(number(place, value, what, holds, ModelError))
    if value.check_shape() != ():
        raise ShapeError(f"{owner} expects a scalar {name}, got shape {value.shape}", at=repr(value))
    if value.boolean:
        raise ModelError(f"{place} must be {what}, got the condition {value!r}")
    known = known_value(value)
    if known is not None:
        number(place, float(known), what, holds, ModelError)
    return value


def finite(owner: str, name: str, value: Expr) -> Expr:
    """The argument itself. Raises ModelError for numbers that are not finite."""
    if isinstance(value, Constant) and not np.isfinite(value.value).all():
        raise ModelError(f"{owner} expects {name} to be finite, got {short(value)}")
    return value


def known_value(value: ExprLike) -> NDArray[np.float64] | None:
    """The numbers of an expression, with the default values of Parameters; None if they are not known or not finite."""
    expr = to_expr(value)
    known: dict[str, Expr] = {
        leaf.key(): Constant(np.asarray(leaf.value, dtype=np.float64))
        for leaf in leaves_of(expr)
        if isinstance(leaf, Parameter) and leaf.value is not None
    }
    (constant,) = canonicalize_all([substitute(expr, known)])
    return np.asarray(constant.value, dtype=np.float64) if isinstance(constant, Constant) else None


def of_kind(owner: str, name: str, value: object, kind: type) -> None:
    """Raise ModelError unless the argument `name` of `owner` is of a class."""
    if not isinstance(value, kind):
        raise ModelError(f"{owner} expects {name} to be of {kind.__name__}, got {short(value)}")


def pose(owner: str, name: str, value: ExprLike) -> Expr:
    """A pose (4, 4) of rotation and position, [R p; 0 1]. Numbers are checked to be a pose.

    Raises:
        ModelError: neither an expression nor numbers, or numbers that are not a pose.
        ShapeError: another shape.
    """
    T = of_shape(owner, name, value, (4, 4))
    check_element(owner, name, T)
    return T


def constant(owner: str, name: str, value: Expr) -> Expr:
    """The argument itself. Raises ModelError if it depends on time, states or controls."""
    leaves = changing(value)
    if leaves:
        raise ModelError(
            f"{owner} expects {name} to be constant during the motion, got {short(value)}, which depends "
            f"on {listed([leaf.name for leaf in leaves])}.\n"
            "  fix: use a joint, such as joints.Prismatic, for a motion, or a Parameter for a value to be chosen"
        )
    return value


def matrix(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The homogeneous matrix T (4, 4) of a rotation and a position, as numbers."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def dataclass_repr(record: Any) -> str:
    """The repr of a dataclass, with only the fields that differ from their defaults."""

    def usual(field: Any) -> str | None:
        if field.default_factory is not dataclasses.MISSING:
            return repr(field.default_factory())
        return None if field.default is dataclasses.MISSING else repr(field.default)

    texts = {field: repr(getattr(record, field.name)) for field in dataclasses.fields(record)}
    return f"{type(record).__name__}({', '.join(f'{f.name}={text}' for f, text in texts.items() if text != usual(f))})"
