"""The data of a collocation method, checked when it is made, and what follows from it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..coefficients import coefficients

__all__ = ["CollocationTableau"]

#: Coefficients are given in double precision; a sum of them may be off by a few units in the last place.
_TOLERANCE = 1e-13


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class CollocationTableau:
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

    def __post_init__(self) -> None:
        for field in ("a", "b", "c"):
            object.__setattr__(self, field, coefficients(field, getattr(self, field), self._error))
        s = self.c.size
        if self.c.ndim != 1 or not s or not (np.diff(self.c, prepend=0.0) > 0.0).all() or self.c[-1] > 1.0:
            raise self._error(f"c must be a vector that grows from above 0 to at most 1, got {self.c}")
        for field, shape in (("b", (s,)), ("a", (s, s))):
            if getattr(self, field).shape != shape:
                raise self._error(f"{field} must have shape {shape} for {s} nodes, got {getattr(self, field).shape}")
        if isinstance(self.order, bool) or not isinstance(self.order, int) or self.order < 1:
            raise self._error(f"order must be a positive whole number, got {self.order!r}")
        for k in range(1, s + 1):
            off = np.abs(self.a @ self.c ** (k - 1) - self.c**k / k)
            if off.max() > _TOLERANCE:
                raise self._error(f"row {int(off.argmax())} of a does not integrate c^{k - 1} up to its node")
        for k in range(1, self.order + 1):
            if abs(self.b @ self.c ** (k - 1) - 1.0 / k) > _TOLERANCE:
                raise self._error(f"b does not integrate c^{k - 1}, which order {self.order} needs")
        if np.abs(np.linalg.det(self.transform)) < 1e-6:
            raise self._error("the inverse of a has eigenvalues that nearly coincide")

    @property
    def stages(self) -> int:
        """s."""
        return int(self.c.size)

    @property
    def stiffly_accurate(self) -> bool:
        """Whether the last stage is the end of the step; such a method estimates its own error."""
        return bool(self.c[-1] == 1.0 and np.abs(self.a[-1] - self.b).max() < _TOLERANCE)

    @property
    def symmetric(self) -> bool:
        """Whether the method of the step -h is its inverse: the nodes are."""
        return bool(np.abs(self.c + self.c[::-1] - 1.0).max() < _TOLERANCE)

    @functools.cached_property
    def inverse(self) -> NDArray[Any]:
        """a^-1."""
        return np.linalg.inv(self.a)

    @functools.cached_property
    def end(self) -> NDArray[Any]:
        """d with y_1 = y + sum_i d_i z_i: b a^-1, and the last unit vector where the last stage is the end."""
        if self.stiffly_accurate:
            return np.eye(self.stages)[-1]
        return np.linalg.solve(self.a.T, self.b)

    @functools.cached_property
    def _eigen(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Eigenvalues of a^-1 with their vectors: real ones, then of each pair that with positive imaginary part."""
        values, vectors = np.linalg.eig(self.inverse)
        real = np.flatnonzero(np.abs(values.imag) < 1e-12 * np.abs(values))
        pairs = np.flatnonzero(values.imag >= 1e-12 * np.abs(values))
        found = np.concatenate([values[real].real, values[pairs]]).astype(complex)
        return found, np.concatenate([vectors[:, real].real, vectors[:, pairs]], axis=1).astype(complex)

    @property
    def real(self) -> tuple[float, ...]:
        """The real eigenvalues of a^-1."""
        return tuple(float(value.real) for value in self._eigen[0] if value.imag == 0.0)

    @property
    def pairs(self) -> tuple[complex, ...]:
        """The complex ones with positive imaginary part."""
        return tuple(complex(value) for value in self._eigen[0] if value.imag != 0.0)

    @functools.cached_property
    def transform(self) -> NDArray[Any]:
        """T with a^-1 T = T L, L of the real eigenvalues and, for each pair p + iq, the block [[p, q], [-q, p]].

        Its columns are the real eigenvectors, then real and imaginary part of those of the pairs.
        """
        values, vectors = self._eigen
        columns = []
        for value, vector in zip(values, vectors.T, strict=True):
            columns += [vector.real] if value.imag == 0.0 else [vector.real, vector.imag]
        return np.stack(columns, axis=1)

    @functools.cached_property
    def untransform(self) -> NDArray[Any]:
        """T^-1."""
        return np.linalg.inv(self.transform)

    @functools.cached_property
    def polynomial(self) -> NDArray[Any]:
        """(s, s): the coefficients of x, x^2, ... of the polynomial through zero and z, x = 0 to 1 over the step, are
        this times z.
        """
        return np.linalg.inv(np.vander(self.c, self.stages, increasing=True) * self.c[:, None])

    @property
    def start_weight(self) -> float:
        """g0, the weight of the slope at the start of the step in the embedded solution.

        One over the real eigenvalue, with an even number of stages over the size of the first pair.
        """
        return 1.0 / (self.real[0] if self.real else abs(self.pairs[0]))

    @functools.cached_property
    def error_weights(self) -> NDArray[Any]:
        """e with y_embedded - y_1 = g0 h f(t, y) + sum_i e_i z_i, where the embedded solution has order s.

        The embedded solution weighs the slopes at 0 and c by g0 and b_embedded, and integrates polynomials of degree
        s - 1.
        """
        moments = np.vander(self.c, self.stages, increasing=True).T
        difference = np.linalg.solve(moments, -self.start_weight * np.eye(self.stages)[0])
        return np.linalg.solve(self.a.T, difference)

    @property
    def error_order(self) -> int:
        """The power of the step with which the estimated error of one step falls.

        Raises:
            ModelError: the method does not estimate its error.
        """
        if not self.stiffly_accurate:
            raise self._error("the last stage is not the end of the step, so it cannot choose its own steps")
        return self.stages + 1

    def __repr__(self) -> str:
        return f"CollocationTableau({self.name}, order {self.order}, {self.stages} stages)"

    def _error(self, sentence: str) -> ModelError:
        return ModelError(f"tableau {self.name!r}: {sentence}")
