"""What the functions of this floor accept, and the one place where it is checked."""

from __future__ import annotations

import numpy as np

from ..errors import ModelError, ShapeError
from ..expr import Constant, Expr, to_expr
from ..expr.fields import ExprLike

#: How far a constant may be from a pose. Matrices typed with four digits pass, a scaled one does not.
_NEARLY = 1e-4


def of_shape(owner: str, name: str, value: ExprLike, shape: tuple[int, ...], hint: str | None = None) -> Expr:
    """The argument `name` of `owner` as an expression of the shape expected.

    Raises:
        ModelError: it is neither an expression nor numbers.
        ShapeError: it has another shape; `hint` says how to mend that.
    """
    try:
        expr = to_expr(value)
    except ModelError as error:
        raise ModelError(f"{owner} expects {name} with shape {shape}: {error}") from None
    if expr.shape != shape:
        raise ShapeError(f"{owner} expects {name} with shape {shape}, got {expr.shape}", hint=hint)
    return expr


def pose(owner: str, name: str, value: ExprLike) -> Expr:
    """A pose (4, 4), rotation and position [R p; 0 1]; numbers are checked to be one.

    Raises:
        ModelError: neither an expression nor numbers, or numbers that are no pose.
        ShapeError: another shape.
    """
    T = of_shape(owner, name, value, (4, 4))
    if isinstance(T, Constant):
        R = T.value[:3, :3]
        off = max(np.max(np.abs(R.T @ R - np.eye(3))), np.max(np.abs(T.value[3] - [0.0, 0.0, 0.0, 1.0])))
        if not (off <= _NEARLY and np.isfinite(T.value).all() and np.linalg.det(R) > 0.0):
            raise ModelError(
                f"{owner} expects {name} to be a pose [R p; 0 1] with a rotation R, got\n{T.value}\n"
                "  fix: build it with tx.pose(position=, rotation= or euler= or quaternion=)"
            )
    return T
