"""The kinetic energy of rotation as a sum of parts with exact flows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...groups import quaternions
from ...groups.arrays import Components, cross, dot, matrix, scale, unpack, vector

__all__ = ["Frame", "Number", "Rows", "Spin", "arrays", "conjugate", "times"]

#: A constant, which costs nothing where it is zero, or a traced number.
Number: TypeAlias = jax.Array | float

#: A matrix by rows.
Rows: TypeAlias = Sequence[Sequence[Number]]


def _is_zero(number: Number) -> bool:
    return isinstance(number, float) and number == 0.0


def times(rows: Rows, v: Components) -> Components:
    """The matrix of these rows times v; entries that are the constant zero are left out."""
    return tuple(_weighted(row, v) for row in rows)


def arrays(numbers: Sequence[Number], like: jax.Array) -> Components:
    """The numbers as scalars of the precision of `like`."""
    return tuple(jnp.asarray(number, like.dtype) for number in numbers)


def conjugate(q: Components) -> Components:
    """The unit quaternion of the inverse rotation."""
    return (q[0], *scale(-1.0, q[1:]))


def _weighted(row: Sequence[Number], v: Components) -> jax.Array:
    terms = [entry * x for entry, x in zip(row, v, strict=True) if not _is_zero(entry)]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros_like(v[0])


@dataclasses.dataclass(frozen=True)
class Frame:
    """Axes of a body, and which part each plays.

    The two with the nearest moments are `like` and `rest`: in a symmetric body `rest` then moves nothing.

    Attributes:
        axes: (3, 3), an orthonormal axis in every column.
        main, like, rest: numbers of columns.
    """

    axes: np.ndarray
    main: int
    like: int
    rest: int

    @classmethod
    def of(cls, tensor: np.ndarray | None) -> Frame:
        """The principal axes of an inertia tensor (3, 3); the body's own where nothing is known."""
        if tensor is None:
            return cls(np.eye(3), 2, 0, 1)
        if np.array_equal(tensor, np.diag(np.diag(tensor))):
            moments, axes = np.diag(tensor), np.eye(3)
        else:
            moments, axes = np.linalg.eigh(tensor)
        pairs = sorted(combinations(range(3), 2), key=lambda pair: abs(np.subtract(*1.0 / moments[list(pair)])))
        like, rest = pairs[0]
        return cls(axes, 3 - like - rest, like, rest)


@dataclasses.dataclass(frozen=True)
class _Axis:
    """strength (n . L)^2 / 2, which turns the body about n, fixed in it, at the rate strength (n . L)."""

    n: tuple[Number, ...]
    strength: Number

    def flow(self, q: Components, L: Components, dt: jax.Array) -> Components:
        """The attitude dt later; L is the momentum in world axes."""
        own = quaternions.rotate(conjugate(q), L)
        half = 0.5 * dt * self.strength * _weighted(self.n, own)
        return quaternions.product(q, (jnp.cos(half), *scale(jnp.sin(half), arrays(self.n, half))))


@dataclasses.dataclass(frozen=True)
class Spin:
    """L . J^-1 L / 2 for the momentum L, as a sum whose terms have exact flows: L stays in the world.

    J^-1 = k I + sum_i s_i n_i n_i^T over fixed axes n_i. The first two terms together are a symmetric body: it turns
    about L at the rate k |L| and about its axis at s (n . L). Each of the others turns it about its own axis. Three
    moments take one other; a symmetric body takes none.

    Attributes:
        tensor, inverse: J and J^-1.
        isotropic: k.
        main: the axis of the symmetric part, None for a sphere.
        others: the rest.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section VII.5.3 (splitting methods for rigid
    bodies), for the idea; Landau and Lifshitz, Mechanics, section 33, for the symmetric body.
    """

    tensor: Rows
    inverse: Rows
    isotropic: Number
    main: _Axis | None
    others: tuple[_Axis, ...]

    @classmethod
    def of(cls, tensor: np.ndarray) -> Spin:
        """Of a constant tensor (3, 3), symmetric and positive."""
        frame = Frame.of(tensor)
        inverse = np.linalg.inv(tensor)
        along = np.einsum("ij,ik,kj->j", frame.axes, inverse, frame.axes)
        k = float(along[frame.like])
        small = 4.0 * np.finfo(float).eps * np.abs(along).max()

        def axis(number: int) -> _Axis | None:
            strength = float(along[number]) - k
            return _Axis(tuple(frame.axes[:, number].tolist()), strength) if abs(strength) > small else None

        rest = axis(frame.rest)
        return cls(tensor.tolist(), inverse.tolist(), k, axis(frame.main), () if rest is None else (rest,))

    @classmethod
    def of_moments(cls, moments: Components, frame: Frame) -> Spin:
        """Of traced moments about the body's own axes, which are those of the frame."""
        inverse = [1.0 / moment for moment in moments]
        main, rest = (
            _Axis(tuple(np.eye(3)[i].tolist()), inverse[i] - inverse[frame.like]) for i in (frame.main, frame.rest)
        )
        return cls(_diagonal(moments), _diagonal(inverse), inverse[frame.like], main, (rest,))

    @classmethod
    def of_traced(cls, tensor: jax.Array, frame: Frame) -> Spin:
        """Of a traced tensor (3, 3), symmetric and positive, whose principal axes are near those of the frame, or not.

        What is not on the diagonal in the frame's axes is shared between axes in pairs:
        n_i n_j^T + n_j n_i^T = (n_i + n_j)(n_i + n_j)^T - n_i n_i^T - n_j n_j^T.
        """
        inverse = _inverse(tensor)
        axes = jnp.asarray(frame.axes, tensor.dtype)
        turned = jnp.sum(axes[:, :, None, None] * inverse[:, None, :, None] * axes[None, None, :, :], axis=(0, 2))
        k = turned[frame.like, frame.like]

        def single(i: int) -> _Axis:
            return _Axis(tuple(frame.axes[:, i].tolist()), 2.0 * turned[i, i] - k - turned[i].sum())

        def pair(i: int, j: int) -> _Axis:
            n = (frame.axes[:, i] + frame.axes[:, j]) / np.sqrt(2.0)
            return _Axis(tuple(n.tolist()), 2.0 * turned[i, j])

        others = (single(frame.rest), single(frame.like), *(pair(i, j) for i, j in combinations(range(3), 2)))
        return cls(_rows(tensor), _rows(inverse), k, single(frame.main), others)

    def symmetric(self, q: Components, L: Components, dt: jax.Array) -> Components:
        """The attitude dt later by the symmetric part; L is the momentum in world axes. For any dt."""
        turned = q if self.main is None else self.main.flow(q, L, dt)
        return quaternions.product(quaternions.exp(scale(dt * self.isotropic, L)), turned)

    def others_flow(self, q: Components, L: Components, dt: jax.Array, backwards: bool) -> Components:
        """The attitude after dt by every other part, one after the other."""
        if len(self.others) < 2:
            return self.others[0].flow(q, L, dt) if self.others else q
        # A loop: unrolled, derivatives of so many rotations in a row take minutes to compile.
        directions = jnp.asarray(np.array([axis.n for axis in self.others]), dt.dtype)
        strengths = vector(arrays([axis.strength for axis in self.others], dt))

        def turn(q: Components, entry: tuple[jax.Array, jax.Array]) -> tuple[Components, None]:
            return _Axis(unpack(entry[0]), entry[1]).flow(q, L, dt), None

        return jax.lax.scan(turn, q, (directions, strengths), reverse=backwards)[0]


def _diagonal(entries: Sequence[Number]) -> Rows:
    return [[entry if i == j else 0.0 for j in range(3)] for i, entry in enumerate(entries)]


def _rows(matrix: jax.Array) -> Rows:
    return [[matrix[i, j] for j in range(3)] for i in range(3)]


def _inverse(tensor: jax.Array) -> jax.Array:
    """The inverse of a (3, 3) matrix by cross products: a library call would not compile inside of a loop."""
    rows = [unpack(tensor[i]) for i in range(3)]
    columns = [cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)]
    return matrix(columns).T / dot(rows[0], columns[0])
