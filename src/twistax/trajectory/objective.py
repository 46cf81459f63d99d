"""What a trajectory shall be best at."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from ..errors import ModelError, ShapeError
from ..expr import Expr, to_expr

__all__ = ["Maximize", "Minimize", "Objective"]


@dataclasses.dataclass(frozen=True, eq=False)
class Objective:
    """J = phi(T, x(T)) + integral of l(t, x, u) dt, to be minimised or maximised.

    Args:
        final: phi, a scalar expression of states, parameters and `tx.Time()` (which is the final time there).
        running: l, a scalar expression of states, controls, parameters and time.
        smoothing: weight of sum |u_(k+1) - u_k|^2, each control measured in its scale, against the objective measured
            by its steepest slope at the guess. A small value (the default) picks one of many nearly equal controls
            and removes chatter; it costs that fraction of optimality.

    Raises:
        ModelError: neither final nor running, or a negative smoothing.
        ShapeError: an expression that is not a scalar.
    """

    final: Expr | None
    running: Expr | None
    smoothing: float

    #: +1 to minimise, -1 to maximise.
    sign: ClassVar[float] = 1.0

    def __init__(self, final: Any = None, *, running: Any = None, smoothing: float = 1e-3) -> None:
        kind = type(self).__name__
        if final is None and running is None:
            raise ModelError(f"{kind} needs an expression of the final state, or running=..., or both")
        if not smoothing >= 0.0:
            raise ModelError(f"{kind}: smoothing must be zero or positive, got {smoothing}")
        for name, value in (("final", final), ("running", running)):
            expr = None if value is None else to_expr(value)
            if expr is not None and expr.shape != ():
                raise ShapeError(
                    f"{kind} expects a scalar {name} expression, got shape {expr.shape}",
                    at=repr(expr),
                    hint="index it, or take tx.linalg.Sum or tx.linalg.Norm of it",
                )
            object.__setattr__(self, name, expr)
        object.__setattr__(self, "smoothing", float(smoothing))


class Minimize(Objective):
    """Minimise phi(T, x(T)) + integral of l(t, x, u) dt. See `Objective` for the arguments."""


class Maximize(Objective):
    """Maximise phi(T, x(T)) + integral of l(t, x, u) dt. See `Objective` for the arguments."""

    sign = -1.0
