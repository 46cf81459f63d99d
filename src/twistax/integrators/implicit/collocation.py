"""Collocation methods: their data, checked when they are made, and what follows from it."""

from __future__ import annotations

import dataclasses
from math import sqrt
from typing import Any

import numpy as np

from ..tableaus import Coefficients

__all__ = [
    "GAUSS_LEGENDRE4",
    "GAUSS_LEGENDRE6",
    "IMPLICIT",
    "RADAU_IIA3",
    "RADAU_IIA5",
    "RADAU_IIA9",
    "CollocationTableau",
]

#: Coefficients are given in double precision; a sum of them may be off by a few units in the last place.
_TOLERANCE = 1e-13


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class CollocationTableau(Coefficients):
    """The coefficients of an implicit Runge-Kutta method with s stages by collocation. Arrays are read-only.

    For y' = f(t, y) the increments z_i of the stages solve  z_i = h sum_j a_ij f(t + c_j h, y + z_j),  and
    y_1 = y + h sum_i b_i f(t + c_i h, y + z_i): the polynomial through y whose slope is that of the equation at all
    nodes c, at the end of the step.

    Attributes:
        name: how tables call it.
        order: the order of convergence.
        a: (s, s), not singular; sum_j a_ij c_j^(k-1) = c_i^k / k for k up to s.
        b, c: (s,); sum_i b_i c_i^(k-1) = 1 / k for k up to the order; c grows.

    Raises:
        ModelError: a wrong shape, a value that is not finite, nodes that do not grow from above 0 to at most 1, a sum
            that is off, or an a whose inverse has two equal eigenvalues.

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
        """Whether the method of the step -h is its inverse: the nodes are."""
        return bool(np.abs(self.c + self.c[::-1] - 1.0).max() < _TOLERANCE)

    @property
    def error_order(self) -> int:
        """The power of the step with which the estimated error of one step falls.

        Raises:
            ModelError: the method does not estimate its error.
        """
        if not self.stiffly_accurate:
            raise self._error("the last stage is not the end of the step, so it cannot choose its own steps")
        return self.stages + 1


_3, _6, _15 = sqrt(3.0), sqrt(6.0), sqrt(15.0)

#: Radau IIA with two stages. L-stable.
#: Source: Hairer, Wanner, Solving Ordinary Differential Equations II (1996), section IV.5.
RADAU_IIA3 = CollocationTableau("Radau IIA 3", 3, a=[[5 / 12, -1 / 12], [3 / 4, 1 / 4]], b=[3 / 4, 1 / 4], c=[1 / 3, 1])

#: Radau IIA with three stages, the method of the program RADAU5. L-stable.
#: Source: as above.
RADAU_IIA5 = CollocationTableau(
    "Radau IIA 5",
    5,
    a=[
        [(88 - 7 * _6) / 360, (296 - 169 * _6) / 1800, (-2 + 3 * _6) / 225],
        [(296 + 169 * _6) / 1800, (88 + 7 * _6) / 360, (-2 - 3 * _6) / 225],
        [(16 - _6) / 36, (16 + _6) / 36, 1 / 9],
    ],
    b=[(16 - _6) / 36, (16 + _6) / 36, 1 / 9],
    c=[(4 - _6) / 10, (4 + _6) / 10, 1],
)

#: Radau IIA with five stages: the last row of a is b. L-stable.
#: Source: nodes and weights found in sixty digits from the conditions of collocation; as above, and Hairer, Wanner,
#: Stiff differential equations solved by Radau methods (1999), for their use.
_RADAU9 = [
    [0.072998864317903324, -0.026735331107945572, 0.018676929763984354, -0.01287910609330644, 0.0050428392338820152],
    [0.15377523147918247, 0.14621486784749351, -0.03644456890512809, 0.021233063119304719, -0.0079355799027287775],
    [0.14006304568480987, 0.29896712949128348, 0.16758507013524896, -0.033969101686617747, 0.010944288744192252],
    [0.14489430810953476, 0.27650006876015923, 0.32579792291042103, 0.12875675325490976, -0.015708917378805328],
    [0.14371356079122594, 0.28135601514946206, 0.31182652297574125, 0.22310390108357074, 0.04],
]
RADAU_IIA9 = CollocationTableau(
    "Radau IIA 9",
    9,
    a=_RADAU9,
    b=_RADAU9[-1],
    c=[0.057104196114517682, 0.27684301363812383, 0.58359043236891682, 0.86024013565621945, 1],
)

#: Gauss with two stages. A-stable, symmetric.
#: Source: as above.
GAUSS_LEGENDRE4 = CollocationTableau(
    "Gauss-Legendre 4",
    4,
    a=[[1 / 4, 1 / 4 - _3 / 6], [1 / 4 + _3 / 6, 1 / 4]],
    b=[1 / 2, 1 / 2],
    c=[1 / 2 - _3 / 6, 1 / 2 + _3 / 6],
)

#: Gauss with three stages. A-stable, symmetric.
#: Source: as above.
GAUSS_LEGENDRE6 = CollocationTableau(
    "Gauss-Legendre 6",
    6,
    a=[
        [5 / 36, 2 / 9 - _15 / 15, 5 / 36 - _15 / 30],
        [5 / 36 + _15 / 24, 2 / 9, 5 / 36 - _15 / 24],
        [5 / 36 + _15 / 30, 2 / 9 + _15 / 15, 5 / 36],
    ],
    b=[5 / 18, 4 / 9, 5 / 18],
    c=[1 / 2 - _15 / 10, 1 / 2, 1 / 2 + _15 / 10],
)

#: Every implicit tableau, by order.
IMPLICIT: tuple[CollocationTableau, ...] = (RADAU_IIA3, GAUSS_LEGENDRE4, RADAU_IIA5, GAUSS_LEGENDRE6, RADAU_IIA9)
