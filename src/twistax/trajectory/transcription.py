"""How an interval is integrated: `Problem(transcription=...)`."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from ..checks import whole
from ..errors import TrajectoryError
from ..integrators import RKMK, ImplicitRKMK, Method
from ..integrators.tableaus import DOP853, RK4, CollocationTableau
from ..linear.discretize import method_of
from .interval import Collocated, Interval

#: Steps of a close integration of an interval at least, for limits are looked at where they end; an even number.
_LOOKS = 8


@dataclasses.dataclass(frozen=True)
class MultipleShooting:
    """An explicit Runge-Kutta method in exponential coordinates about the first node of an interval.

    Args:
        method: an `RKMK` with an explicit tableau; RK4 if left out. Its chart does not matter.
        substeps: its steps in an interval. Limits on states are asked at their ends.

    Raises:
        TrajectoryError: another method, or no positive whole number of substeps.
    """

    method: Any = dataclasses.field(default_factory=lambda: RKMK(RK4))
    substeps: Any = 2
    interval: ClassVar[type[Interval]] = Interval

    def __post_init__(self) -> None:
        object.__setattr__(self, "method", method_of(self.method))
        whole("substeps", self.substeps, 1, TrajectoryError)

    @property
    def tableau(self) -> Any:
        return self.method.tableau

    @property
    def finer(self) -> MultipleShooting:
        """A method of higher order in finer steps, to measure errors with."""
        return MultipleShooting(RKMK(DOP853), max(2 * self.substeps, _LOOKS))

    @property
    def replaying(self) -> Method:
        """The method of a replay that names none."""
        return RKMK(RK4)

    def rolling(self, samples: int) -> MultipleShooting:
        """The same for the core, in so many steps of an interval."""
        return MultipleShooting(RKMK(RK4), samples)


@dataclasses.dataclass(frozen=True)
class Collocation:
    """Collocation on the group: a polynomial in exponential coordinates about the first node of an interval.

    Its slope is that of the equation at the nodes of the tableau. For stiff systems, and for long intervals of high
    order. The equations of a step are solved inside of the interval, with the running cost integrated to the order of
    the tableau.

    Args:
        tableau: a `tx.tableaus.CollocationTableau`, such as `tx.tableaus.GAUSS_LEGENDRE6` or `RADAU_IIA5`.
        substeps: its steps in an interval. Limits on states are asked at their ends.

    Raises:
        TrajectoryError: another tableau, or no positive whole number of substeps.
    """

    tableau: Any
    substeps: Any = 1
    interval: ClassVar[type[Interval]] = Collocated

    def __post_init__(self) -> None:
        if not isinstance(self.tableau, CollocationTableau):
            raise TrajectoryError(
                f"Collocation expects a tableau like tx.tableaus.GAUSS_LEGENDRE6, got {self.tableau!r}"
            )
        whole("substeps", self.substeps, 1, TrajectoryError)

    @property
    def finer(self) -> Collocation:
        """The same method in finer steps, to measure errors with."""
        return Collocation(self.tableau, max(2 * self.substeps, _LOOKS))

    @property
    def replaying(self) -> Method:
        """The method of a replay that names none: implicit where the tableau is one for stiff systems."""
        return ImplicitRKMK(self.tableau) if self.tableau.stiffly_accurate else RKMK(RK4)

    def rolling(self, samples: int) -> MultipleShooting | Collocation:
        """The same for the core, in so many steps of an interval."""
        stiff = self.tableau.stiffly_accurate
        return Collocation(self.tableau, samples) if stiff else MultipleShooting(RKMK(RK4), samples)


def transcription_of(given: Any, method: Any, substeps: Any) -> MultipleShooting | Collocation:
    """The transcription that was given, or multiple shooting by a method.

    Raises:
        TrajectoryError: another object, or both are given.
    """
    if given is None:
        chosen = {} if substeps is None else {"substeps": substeps}
        return MultipleShooting(method_of(method), **chosen)
    if not isinstance(given, (MultipleShooting, Collocation)):
        raise TrajectoryError(
            "transcription expects tx.trajectory.MultipleShooting(...) or tx.trajectory.Collocation(...), "
            f"got {given!r}"
        )
    if method is not None or substeps is not None:
        raise TrajectoryError("transcription brings its own method and substeps; leave those out")
    return given
