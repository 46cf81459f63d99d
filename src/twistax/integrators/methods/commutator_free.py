"""Commutator-free methods: every stage is a product of a few exponentials, without an inverse Jacobian."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeAlias

import jax
import numpy as np
from numpy.typing import NDArray

from ...checks import instance
from ...errors import ModelError
from ...system.dynamics import Dynamics
from ..charts.chart import Exponential, compensated
from ..charts.coordinates import Blocks, StateCoordinates
from ..method import Method, VectorField
from ..tableaus import ButcherTableau, Coefficients, StageRows
from .rkmk import stage_slopes

#: Exponentials in the order in which they act, each the weights of the slopes in its exponent.
Exponentials: TypeAlias = tuple[tuple[float, ...], ...]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class CommutatorFreeTableau(Coefficients):
    """The coefficients of an explicit commutator-free method with s stages, for body velocities, $g' = g hat(Omega)$.

        $g_i = g_0 Exp(h sum_j a_i1j k_j) Exp(h sum_j a_i2j k_j) ..., k_i = Omega(t + c_i h, g_i),
        g(t + h) = g_0 Exp(h sum_j b_1j k_j) Exp(h sum_j b_2j k_j) ...$

    The leftmost exponential acts first; for right-trivialised equations, as in most papers, the order is reversed.

    Attributes:
        name: its name in tables.
        order: the order of convergence.
        a: the exponentials of every stage, none for the first; each is a row of weights of earlier stages, where
            trailing zeros may be omitted.
        b: the exponentials of the step, likewise.
        c: (s,) the nodes; they equal the row sums of a.
        underlying: the equivalent Runge-Kutta method for states without a group.

    Raises:
        ModelError: an exponential without weights, a weight of the same or a later stage, one that is not finite,
            or weights of the step that do not sum to 1.

    Source: Celledoni, Marthinsen, Owren, Commutator-free Lie group methods, Future Generation Computer Systems 19
    (2003). Crouch-Grossman methods also have this form, with one slope in every exponential.
    """

    name: str
    order: int
    a: Any
    b: Any
    underlying: ButcherTableau = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        a = tuple(self._exponentials(f"a[{i}]", row, i) for i, row in enumerate(self.a))
        self._set(a=a, b=self._exponentials("b", self.b, len(a)))
        stages, step = self.weights(self.a).sum(axis=1), self.weights([self.b])[0].sum(axis=0)
        self._set(underlying=ButcherTableau(self.name, self.order, stages, step, stages.sum(axis=1)))

    @property
    def c(self) -> Any:
        """The nodes."""
        return self.underlying.c

    def weights(self, rows: Sequence[Exponentials]) -> NDArray[Any]:
        """Several stages as one array (stages, exponentials, s), with zeros where there is no exponential."""
        table = np.zeros((len(rows), max(map(len, rows)), len(self.a)))
        for stage, exponentials in zip(table, rows, strict=True):
            for exponent, values in zip(stage, exponentials, strict=False):
                exponent[: len(values)] = values
        return table

    def _exponentials(self, field: str, rows: Any, known: int) -> Exponentials:
        try:
            read = tuple(tuple(float(weight) for weight in row) for row in rows)
        except (TypeError, ValueError) as error:
            raise self._error(f"{field} is not a list of rows of numbers: {error}") from None
        for row in read:
            if not any(row):
                raise self._error(f"{field} has an exponential whose weights are all zero")
            if len(row) > known:
                raise self._error(
                    f"{field} has {len(row)} weights, but only {known} earlier slopes exist: the method "
                    "would be implicit"
                )
        return read


#: The method of order 4 with two exponentials in the step; without a group it is the classical Runge-Kutta method.
#: Source: Celledoni, Marthinsen, Owren (2003), with the order of the exponentials reversed for body velocities.
CF4 = CommutatorFreeTableau(
    "CF4",
    4,
    a=[[], [[1 / 2]], [[0, 1 / 2]], [[1 / 2], [-1 / 2, 0, 1]]],
    b=[[1 / 4, 1 / 6, 1 / 6, -1 / 12], [-1 / 12, 1 / 6, 1 / 6, 1 / 4]],
)


@dataclasses.dataclass(frozen=True)
class CommutatorFree(Method):
    """A commutator-free method, for all systems. Compared with `RKMK`, it has more exponentials and no inverse
    Jacobian.

    States without a group use the underlying Runge-Kutta method. An exponential that rotates by more than half a turn
    fails, as in `RKMK`.

    Attributes:
        tableau: the coefficients, CF4 by default.

    Raises:
        ModelError: the tableau has another type.

    Source: Celledoni, Marthinsen, Owren, Commutator-free Lie group methods (2003).
    """

    tableau: CommutatorFreeTableau = CF4

    def __post_init__(self) -> None:
        instance("CommutatorFree", self.tableau, CommutatorFreeTableau, "a tableau like tx.tableaus.CF4", ModelError)

    @property
    def name(self) -> str:
        return self.tableau.name

    @property
    def order(self) -> int:
        return self.tableau.order

    @property
    def evaluations(self) -> int:
        return len(self.tableau.a)

    def coordinates(self, dynamics: Dynamics) -> StateCoordinates:
        # Only moves are used: commutators are those of a pull-back that does not happen.
        return compensated(Exponential(commutators=1), dynamics.group)

    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        # Every stage has as many exponentials as the longest, some of zero.
        local, tableau = self.coordinates(field.dynamics), self.tableau

        def reached(exponents: list[Blocks]) -> Blocks:
            point = y
            for exponent in exponents:
                point = local.move(point, exponent)
            return point

        def slope(time: jax.Array, exponents: list[Blocks]) -> tuple[Blocks, None]:
            return self.rate(field, time, reached(exponents)), None

        stages = StageRows(tableau.weights(tableau.a), tableau.c)
        slopes, _ = stage_slopes(stages, slope, self.rate(field, t, y), None, t, h)
        return local.settle(reached(slopes.combine(tableau.weights([tableau.b])[0], h)))
