"""Butcher tableaus of explicit and collocation methods, which are checked at construction. `tx.tableaus` lists them."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import reals
from ..errors import ModelError
from ..expr.moved import earlier_classes

# fmt: off
__all__ = [
    "ALL", "BOGACKI_SHAMPINE3", "ButcherTableau", "CollocationTableau", "DOP853", "DORMAND_PRINCE5", "DORMAND_PRINCE8",
    "EULER", "GAUSS_LEGENDRE4", "GAUSS_LEGENDRE6", "HEUN", "IMPLICIT", "RADAU_IIA1", "RADAU_IIA3", "RADAU_IIA5",
    "RADAU_IIA9", "RK4", "TSIT5",
]
# fmt: on

__getattr__ = earlier_classes(__name__)
#: Coefficients are given in double precision; a sum of them may be off by a few units in the last place.
_TOLERANCE = 1e-13


class Coefficients:
    """Base class of tableaus and compositions: a name, an order, and coefficients that are checked at construction."""

    name: str
    order: int
    c: Any
    #: How messages call it.
    kind = "tableau"

    @property
    def stages(self) -> int:
        """The number of stages."""
        return len(self.c)

    def _read(self, field: str, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
        """Make a field a read-only array of finite doubles, of that shape if one is given."""
        array = reals(f"{self.kind} {self.name!r}: {field}", getattr(self, field), ModelError).astype(np.float64)
        if not np.isfinite(array).all():
            raise self._error(f"{field} has entries that are not finite")
        if shape is not None and array.shape != shape:
            raise self._error(f"{field} must have shape {shape}, got {array.shape}")
        array.setflags(write=False)
        self._set(**{field: array})
        return array

    def _set(self, **values: Any) -> None:
        for field, value in values.items():
            object.__setattr__(self, field, value)

    def _check_order(self, field: str = "order") -> None:
        order = getattr(self, field)
        if isinstance(order, bool) or not isinstance(order, int) or order < 1:
            raise self._error(f"{field} must be a positive whole number, got {order!r}")

    def _error(self, sentence: str) -> ModelError:
        return ModelError(f"{self.kind} {self.name!r}: {sentence}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name}, order {self.order}, {self.stages} stages)"


class StageRows(NamedTuple):
    """The coefficients of the stages to compute: a (n, n), strictly lower triangular, and c (n,)."""

    a: Any
    c: Any


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ButcherTableau(Coefficients):
    """The coefficients of an explicit Runge-Kutta method with s stages. Arrays are read-only.

    For $y' = f(t, y)$: $k_i = f(t + c_i h, y + h sum_j a_ij k_j)$, $y_1 = y + h sum_i b_i k_i$.

    Attributes:
        name: its name in tables.
        order: the order of convergence of the solution with the weights b.
        a: (s, s), strictly lower triangular; rows sum to c.
        b, c: (s,); b sums to 1.
        embedded_order, b_embedded: for embedded pairs, order and weights of the solution that estimates the error, else
            None.
        second_embedded_order, b_second_embedded: a second embedded solution, of lower order, for methods that combine
            two estimates.
        counted: the number of stages up to the last one with a weight in b; later ones are for the embedded solutions
            or the next step.

    Raises:
        ModelError: a wrong shape, a value that is not finite, an implicit stage, or a wrong sum.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.1.
    """

    name: str
    order: int
    a: Any
    b: Any
    c: Any
    embedded_order: int | None = None
    b_embedded: Any = None
    second_embedded_order: int | None = None
    b_second_embedded: Any = None
    counted: StageRows = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        b = self._read("b")
        if b.ndim != 1 or not b.size:
            raise self._error(f"b must be a vector, got shape {b.shape}")
        s = b.size
        self._read("a", (s, s))
        self._read("c", (s,))
        if np.triu(self.a).any():
            row = int(np.argmax(np.triu(self.a).any(axis=1)))
            raise self._error(f"row {row} of a must be zero on and right of the diagonal: the method is not explicit")
        off = np.abs(self.a.sum(axis=1) - self.c)
        if off.max() > _TOLERANCE:
            row = int(np.argmax(off))
            raise self._error(f"row {row} of a sums to {self.a[row].sum():.16g}, but c[{row}] is {self.c[row]:.16g}")
        self._check_solution("order", "b")
        for order, weights in (("embedded_order", "b_embedded"), ("second_embedded_order", "b_second_embedded")):
            if (getattr(self, order) is None) != (getattr(self, weights) is None):
                raise self._error(f"a pair needs both {order} and {weights}")
            if getattr(self, order) is not None:
                self._check_solution(order, weights)
        if self.b_second_embedded is not None and self.b_embedded is None:
            raise self._error("a second embedded solution needs a first one")
        n = int(np.flatnonzero(b)[-1]) + 1
        self._set(counted=StageRows(self.a[:n, :n], self.c[:n]))
        _ = self.to_the_end, self.is_pair and self.error_order  # every step reads them

    @functools.cached_property
    def to_the_end(self) -> StageRows:
        """All stages, with the end of the step as the last one: a stage of the tableau, or an additional one."""
        if self.b[-1] == 0.0 and np.array_equal(self.a[-1], self.b):
            return StageRows(self.a, self.c)
        wider = np.pad(np.vstack([self.a, self.b]), ((0, 0), (0, 1)))
        return StageRows(wider, np.append(self.c, 1.0))

    @property
    def is_pair(self) -> bool:
        """Whether the method estimates its own error."""
        return self.b_embedded is not None

    @functools.cached_property
    def error_order(self) -> int:
        """The power of the step with which the estimated error of one step decreases.

        With two embedded solutions the estimate is $e1^2 / sqrt(e1^2 + e2^2 / 100)$, as in the program DOP853.

        Raises:
            ModelError: the method has no embedded solution.
        """
        if self.embedded_order is None:
            raise self._error(
                "the method has no embedded solution, so it cannot choose its own steps.\n"
                "  fix: pass dt or steps in place of rtol, or use an embedded pair, tx.tableaus.TSIT5"
            )
        if self.second_embedded_order is None:
            return self.embedded_order + 1
        return 2 * (self.embedded_order + 1) - (self.second_embedded_order + 1)

    def _check_solution(self, order: str, weights: str) -> None:
        self._check_order(order)
        total = self._read(weights, self.b.shape).sum()
        if abs(total - 1.0) > _TOLERANCE:
            raise self._error(f"{weights} must sum to 1, but it sums to {total:.16g}")


def lower_triangle(rows: Sequence[Any]) -> NDArray[Any]:
    """The square matrix a of the rows below its first one: row i + 1 has entries 0 to i, and the rest is zero."""
    a = np.zeros((len(rows) + 1, len(rows) + 1))
    for i, row in enumerate(rows, start=1):
        a[i, :i] = row
    return a


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class CollocationTableau(Coefficients):
    """The coefficients of an implicit Runge-Kutta method with s stages by collocation. Arrays are read-only.

    For $y' = f(t, y)$ the increments z_i of the stages solve $z_i = h sum_j a_ij f(t + c_j h, y + z_j)$, and $y_1 = y +
    h sum_i b_i f(t + c_i h, y + z_i)$. These are the values, at the nodes and at the end of the step, of the polynomial
    through y whose slope satisfies the equation at all nodes c.

    Attributes:
        name: its name in tables.
        order: the order of convergence.
        a: (s, s), nonsingular; $sum_j a_ij c_j^(k-1) = c_i^k / k$ for k up to s.
        b, c: (s,); $sum_i b_i c_i^(k-1) = 1 / k$ for k up to the order; c increases.

    Raises:
        ModelError: a wrong shape, a value that is not finite, nodes that do not increase from above 0 to at most 1, a
            wrong sum, or an a whose inverse has two equal eigenvalues.

    Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.5; the conditions are C(s) and
    B(order) there.
    """

    name: str
    order: int
    a: Any
    b: Any
    c: Any
    # What follows from these.
    inverse: Any = dataclasses.field(init=False)  # a^-1
    end: Any = dataclasses.field(init=False)  # d with y_1 = y + sum_i d_i z_i
    real: tuple[float, ...] = dataclasses.field(init=False)  # the real eigenvalues of a^-1
    pairs: tuple[complex, ...] = dataclasses.field(init=False)  # the complex ones with positive imaginary part
    #: T with a^-1 T = T L, L of the real eigenvalues and, for each pair p + iq, the block [[p, q], [-q, p]].
    transform: Any = dataclasses.field(init=False)
    untransform: Any = dataclasses.field(init=False)  # T^-1
    #: (s, s): times z, the coefficients of x, x^2, ... of the polynomial through zero and z; x = 1 is the end.
    polynomial: Any = dataclasses.field(init=False)
    start_weight: float = dataclasses.field(init=False)  # g0 of the embedded solution
    error_weights: Any = dataclasses.field(init=False)  # e with y_embedded - y_1 = g0 h f(t, y) + sum_i e_i z_i

    def __post_init__(self) -> None:
        s = self._read("c").size
        if self.c.ndim != 1 or not s or not (np.diff(self.c, prepend=0.0) > 0.0).all() or self.c[-1] > 1.0:
            raise self._error(f"c must be a vector that grows from above 0 to at most 1, got {self.c}")
        self._read("b", (s,))
        self._read("a", (s, s))
        self._check_order()
        for k in range(1, s + 1):
            off = np.abs(self.a @ self.c ** (k - 1) - self.c**k / k)
            if off.max() > _TOLERANCE:
                raise self._error(f"row {int(off.argmax())} of a does not integrate c^{k - 1} up to its node")
        for k in range(1, self.order + 1):
            if abs(self.b @ self.c ** (k - 1) - 1.0 / k) > _TOLERANCE:
                raise self._error(f"b does not integrate c^{k - 1}, which order {self.order} needs")
        self._derive()

    def _derive(self) -> None:
        s, inverse = self.stages, np.linalg.inv(self.a)
        values, vectors = np.linalg.eig(inverse)
        values = np.where(np.abs(values.imag) < 1e-12 * np.abs(values), values.real, values)
        real, paired = np.flatnonzero(values.imag == 0.0), np.flatnonzero(values.imag > 0.0)
        columns = [vectors[:, i].real for i in real]
        for i in paired:
            columns += [vectors[:, i].real, vectors[:, i].imag]
        transform = np.stack(columns, axis=1)
        if np.abs(np.linalg.det(transform)) < 1e-6:
            raise self._error("the inverse of a has eigenvalues that nearly coincide")
        # Of an embedded solution that weighs the slopes at 0 and c and integrates polynomials of degree s - 1.
        start_weight = 1.0 / (values[real[0]].real if real.size else abs(values[paired[0]]))
        powers = np.vander(self.c, s, increasing=True)
        difference = np.linalg.solve(powers.T, -start_weight * np.eye(s)[0])
        self._set(
            inverse=inverse,
            end=np.eye(s)[-1] if self.stiffly_accurate else np.linalg.solve(self.a.T, self.b),
            real=tuple(float(values[i].real) for i in real),
            pairs=tuple(complex(values[i]) for i in paired),
            transform=transform,
            untransform=np.linalg.inv(transform),
            polynomial=np.linalg.inv(powers * self.c[:, None]),
            start_weight=float(start_weight),
            error_weights=np.linalg.solve(self.a.T, difference),
        )

    @property
    def stiffly_accurate(self) -> bool:
        """Whether the last stage is the end of the step; such a method estimates its own error."""
        return bool(self.c[-1] == 1.0 and np.abs(self.a[-1] - self.b).max() < _TOLERANCE)

    @property
    def symmetric(self) -> bool:
        """Whether the step with -h is the inverse of the step with h, which holds if the nodes are symmetric."""
        return bool(np.abs(self.c + self.c[::-1] - 1.0).max() < _TOLERANCE)

    @functools.cached_property
    def error_order(self) -> int:
        """The power of the step with which the estimated error of one step decreases.

        Raises:
            ModelError: the method does not estimate its error.
        """
        if not self.stiffly_accurate:
            raise self._error(
                "the last stage is not the end of the step, so the method has no error estimate for adaptive steps"
            )
        return self.stages + 1


# ---- the tableaus themselves -----------------------------------------------------------------------------------------

#: Fields that are a row of numbers each.
_WEIGHTS = ("b", "c", "b_embedded", "b_second_embedded")


def _stored(kind: str) -> list[dict[str, Any]]:
    """The tableaus of a kind in `tableaus.json`, in order: a row is text, of exact fractions or decimals."""

    def row(text: str) -> list[float]:
        return [float(Fraction(number)) for number in text.split()]

    tableaus = []
    for data in json.loads(Path(__file__).with_name("tableaus.json").read_text())[kind].values():
        fields = {field: row(value) if field in _WEIGHTS else value for field, value in data.items()}
        del fields["what"], fields["source"]
        tableaus.append(fields | {"a": [row(text) for text in data["a"]]})
    return tableaus


#: Every explicit tableau, by order.
ALL: tuple[ButcherTableau, ...] = tuple(
    ButcherTableau(**fields | {"a": lower_triangle(fields["a"])}) for fields in _stored("explicit")
)
EULER, HEUN, BOGACKI_SHAMPINE3, RK4, DORMAND_PRINCE5, TSIT5, DOP853, DORMAND_PRINCE8 = ALL

#: Every implicit tableau, by order.
IMPLICIT: tuple[CollocationTableau, ...] = tuple(CollocationTableau(**f) for f in _stored("collocation"))
RADAU_IIA1, RADAU_IIA3, GAUSS_LEGENDRE4, RADAU_IIA5, GAUSS_LEGENDRE6, RADAU_IIA9 = IMPLICIT
