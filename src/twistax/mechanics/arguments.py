"""Checks of the arguments of the functions of mechanics, in one place."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ..checks import listed, short
from ..errors import ModelError, ShapeError
from ..expr import Constant, Expr, to_expr
from ..expr.fields import ExprLike
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
        InputError: it is a quantity of another unit.
        ModelError: it is neither an expression nor numbers.
        ShapeError: it has another shape; `hint` says how to mend that.
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


def finite(owner: str, name: str, value: Expr) -> Expr:
    """The argument itself. Raises ModelError for numbers that are not finite."""
    if isinstance(value, Constant) and not np.isfinite(value.value).all():
        raise ModelError(f"{owner} expects {name} to be finite, got {short(value)}")
    return value


def of_kind(owner: str, name: str, value: object, kind: type) -> None:
    """Raise ModelError unless the argument `name` of `owner` is of a class."""
    if not isinstance(value, kind):
        raise ModelError(f"{owner} expects {name} to be of {kind.__name__}, got {short(value)}")


def pose(owner: str, name: str, value: ExprLike) -> Expr:
    """A pose (4, 4), rotation and position [R p; 0 1]; numbers are checked to be one.

    Raises:
        ModelError: neither an expression nor numbers, or numbers that are not a pose.
        ShapeError: another shape.
    """
    T = of_shape(owner, name, value, (4, 4))
    check_element(owner, name, T)
    return T


def constant(owner: str, name: str, value: Expr) -> Expr:
    """The argument itself. Raises ModelError where it depends on time, states or controls."""
    leaves = changing(value)
    if leaves:
        raise ModelError(
            f"{owner} expects {name} not to change with the motion, got {short(value)}, which depends on "
            f"{listed([leaf.name for leaf in leaves])}: its motion would be ignored.\n"
            "  fix: use a joint, such as joints.Prismatic, for a motion, or a Parameter for a choice"
        )
    return value


def matrix(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """T (4, 4) of a rotation and a position, as numbers."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def dataclass_repr(record: Any) -> str:
    """The repr of a dataclass, with the fields that differ from their defaults."""

    def usual(field: Any) -> str | None:
        if field.default_factory is not dataclasses.MISSING:
            return repr(field.default_factory())
        return None if field.default is dataclasses.MISSING else repr(field.default)

    texts = {field: repr(getattr(record, field.name)) for field in dataclasses.fields(record)}
    return f"{type(record).__name__}({', '.join(f'{f.name}={text}' for f, text in texts.items() if text != usual(f))})"
