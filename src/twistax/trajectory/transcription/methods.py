"""Transcriptions, the integration of an interval: `Problem(transcription=...)`."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...checks import whole
from ...errors import TrajectoryError
from ...integrators import RKMK, ImplicitRKMK, Method
from ...integrators.tableaus import DOP853, RK4, CollocationTableau
from ...linear.discretize import method_of
from ...solver.transcription import Scheme

#: The minimal number of steps of an accurate integration, at whose ends limits are checked; an even number.
_LOOKS = 8


@dataclasses.dataclass(frozen=True)
class MultipleShooting:
    """An explicit Runge-Kutta method in exponential coordinates about the first node of an interval.

    The running cost is integrated to the order of the tableau, as if it were the rate of another state.

    Args:
        method: an `RKMK` with an explicit tableau; RK4 by default. Its `chart` is ignored.
        substeps: the number of steps in an interval. Limits on states are imposed at their ends.

    Raises:
        TrajectoryError: a method of another kind, or a number of substeps that is not a positive whole number.
    """

    method: Any = dataclasses.field(default_factory=lambda: RKMK(RK4))
    substeps: Any = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "method", method_of(self.method))
        whole("substeps", self.substeps, 1, TrajectoryError)

    @property
    def scheme(self) -> Scheme:
        """The tableau that the solver's core uses."""
        a, c = self.method.tableau.counted
        square = np.zeros((len(c), len(c)))
        for row, weights in zip(square, a):
            row[: len(weights)] = weights
        return Scheme(square, np.asarray(self.method.tableau.b[: len(c)]), np.asarray(c), self.substeps, False)

    @property
    def finer(self) -> MultipleShooting:
        """A method of higher order with smaller steps, for the mesh error."""
        return MultipleShooting(RKMK(DOP853), max(2 * self.substeps, _LOOKS))

    @property
    def replaying(self) -> Method:
        """The default method of a replay."""
        return RKMK(RK4)

    def rolling(self, samples: int) -> MultipleShooting:
        """The same method for the core, with another number of steps in an interval."""
        return MultipleShooting(RKMK(RK4), samples)


@dataclasses.dataclass(frozen=True)
class Collocation:
    """Collocation on the group: a polynomial in exponential coordinates about the first node of an interval.

    The derivative of the polynomial satisfies the differential equation at the nodes of the tableau. Use it for stiff
    systems, and with high order for long intervals. The equations of a step are solved inside the interval. The running
    cost is integrated to the order of the tableau.

    Args:
        tableau: a `tx.tableaus.CollocationTableau`, such as `tx.tableaus.GAUSS_LEGENDRE6` or `RADAU_IIA5`.
        substeps: the number of steps in an interval. Limits on states are imposed at their ends.

    Raises:
        TrajectoryError: a tableau of another kind, or a number of substeps that is not a positive whole number.
    """

    tableau: Any
    substeps: Any = 1

    def __post_init__(self) -> None:
        if not isinstance(self.tableau, CollocationTableau):
            raise TrajectoryError(
                f"Collocation expects a tableau like tx.tableaus.GAUSS_LEGENDRE6, got {self.tableau!r}"
            )
        whole("substeps", self.substeps, 1, TrajectoryError)

    @property
    def scheme(self) -> Scheme:
        """The tableau that the solver's core uses."""
        return Scheme(self.tableau.a, self.tableau.b, self.tableau.c, self.substeps, True)

    @property
    def finer(self) -> Collocation:
        """The same method with smaller steps, for the mesh error."""
        return Collocation(self.tableau, max(2 * self.substeps, _LOOKS))

    @property
    def replaying(self) -> Method:
        """The default method of a replay: implicit if the tableau is stiffly accurate."""
        return ImplicitRKMK(self.tableau) if self.tableau.stiffly_accurate else RKMK(RK4)

    def rolling(self, samples: int) -> MultipleShooting | Collocation:
        """The same method for the core, with another number of steps in an interval."""
        stiff = self.tableau.stiffly_accurate
        return Collocation(self.tableau, samples) if stiff else MultipleShooting(RKMK(RK4), samples)


def transcription_of(transcription: Any, method: Any, substeps: Any) -> MultipleShooting | Collocation:
    """The transcription if there is one, else multiple shooting with a method and substeps.

    Raises:
        TrajectoryError: an object of another kind, or both arguments are present.
    """
    if transcription is None:
        chosen = {} if substeps is None else {"substeps": substeps}
        return MultipleShooting(method_of(method), **chosen)
    if not isinstance(transcription, (MultipleShooting, Collocation)):
        raise TrajectoryError(
            "transcription expects tx.trajectory.MultipleShooting(...) or tx.trajectory.Collocation(...), "
            f"got {transcription!r}"
        )
    if method is not None or substeps is not None:
        raise TrajectoryError(
            "method and substeps belong to the transcription: leave them out if you pass transcription="
        )
    return transcription
