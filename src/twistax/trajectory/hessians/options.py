"""Approximations of a problem's second derivatives."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, ClassVar, Protocol, runtime_checkable

from ...errors import TrajectoryError
from ...expr import Expr
from ..transcription.kernels import ExtraHessian
from ..transcription.shooting import Shooting
from .gauss_newton import SquaresHessian, SumOfSquares


@runtime_checkable
class Hessian(Protocol):
    """The interface of `Problem(hessian=...)`.

    Attributes:
        by_updates: whether updates during the search provide second derivatives.
    """

    by_updates: ClassVar[bool]

    def squares(self, shooting: Shooting) -> ExtraHessian | None:
        """Approximate second derivatives from squares; None if updates during the search provide them."""
        ...


@dataclasses.dataclass(frozen=True)
class GaussNewton:
    r"""The Gauss-Newton Hessian of an objective that is a sum of squares.

    An objective $J = \sum f r^T W r$ has the approximate Hessian $2 \sum f R^T W R$, with R the first derivative of the
    residual r with respect to states, controls, times and free parameters. Second derivatives of residuals, of the
    dynamics and of the constraints are omitted and not compiled. With non-negative weights it has no negative
    curvature. The optimum is the same; convergence is linear, and faster for smaller residuals and multipliers.
    Source: Nocedal and Wright, Numerical Optimization (2006), (10.23).

    The squares are recognised in the expressions: `u**2`, `a @ a`, `a @ W @ a`, `w @ a**2`, `Norm(a)**2`, `Sum(w *
    a**2)`, in sums and times factors without states or controls. Terms that are linear in states and controls have a
    zero second derivative.

    Example: `Problem(..., tx.Minimize(running=(x - r) @ W @ (x - r) + 0.1 * u**2), hessian=GaussNewton())`.

    Raises:
        TrajectoryError: the objective has a term of another kind; raised when the problem is built.
    """

    by_updates: ClassVar[bool] = False

    def squares(self, shooting: Shooting) -> ExtraHessian:
        """The squares of the objective."""
        exprs = shooting.local.expressions
        free = {box.name for box in shooting.border.boxes}

        def terms(place: str, parts: tuple[Expr, ...]) -> list[tuple[Expr, ...]]:
            """Residuals, factors and weights."""
            return list(zip(*(term for expr in parts for term in SumOfSquares(place, expr, free).terms)))

        of_squares = SquaresHessian(shooting)
        running, final = terms("the running cost", exprs.running), terms("the objective", exprs.final)
        return ExtraHessian(of_squares.running, running, of_squares.final, final)


@dataclasses.dataclass(frozen=True)
class QuasiNewton:
    r"""Second derivatives approximated from first ones: symmetric rank-one updates of each stage.

    After each step the Hessian of the Lagrangian of a stage, with respect to its state, control, times and
    free parameters, is corrected to agree with the change of first derivatives. No second
    derivative is compiled or evaluated: use it for large rates, or rates that call Python functions. A solve takes more
    iterations, most of them two to six times as many.

    The block B of a stage becomes $B + r r^T / (r^T s)$ with $r = y - B s$. Here s is the scaled step of the unknowns
    of the stage, and y the change of the gradient of its part of the Lagrangian. Both are in coordinates about the node
    before the step.
    Source: Nocedal and Wright, Numerical Optimization (2006), (6.24).

    Example: `Problem(..., hessian=tx.trajectory.QuasiNewton())`.

    Raises:
        TrajectoryError: it is used with IPOPT or Fatrop (`solver=`), which need second derivatives.
    """

    by_updates: ClassVar[bool] = True

    def squares(self, shooting: Shooting) -> None:
        """None: updates provide second derivatives."""


def checked_hessian(hessian: Any) -> Hessian | None:
    """Raise TrajectoryError for an object that is not a Hessian option."""
    if hessian is not None and (isinstance(hessian, type) or not isinstance(hessian, Hessian)):
        raise TrajectoryError(
            "hessian expects tx.trajectory.GaussNewton(), tx.trajectory.QuasiNewton(), or nothing for exact second "
            f"derivatives, got {hessian!r}"
        )
    return hessian


def by_updates(parts: Iterable[Any]) -> bool:
    """Whether second derivatives of any of these problems come from quasi-Newton updates."""
    return any(part.hessian is not None and part.hessian.by_updates for part in parts)
