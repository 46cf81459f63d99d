"""The inertia of a rigid body for free motion: about the point that moves uniformly, with exact flows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...groups import quaternions
from ...groups.arrays import Components, add, cross, dot, matrix, scale, unpack, vector
from ..charts.chart import conjugate

#: A constant, which costs nothing where it is zero, or a traced number.
Number: TypeAlias = jax.Array | float

#: A matrix by rows.
Rows: TypeAlias = Sequence[Sequence[Number]]

#: How far, relative to its largest entry, a matrix may be from that of a rigid body; a float32 one by round-off.
_ROUND_OFF = 1e-5


def arrays(numbers: Sequence[Number], like: jax.Array) -> Components:
    """The numbers as scalars with the precision of `like`."""
    return tuple(jnp.asarray(number, like.dtype) for number in numbers)


def _times(rows: Rows, v: Components) -> Components:
    return tuple(_weighted(row, v) for row in rows)


def _weighted(row: Sequence[Number], v: Components) -> jax.Array:
    """row . v; entries that are the constant zero are left out."""
    terms = [a * x for a, x in zip(row, v, strict=True) if not (isinstance(a, float) and a == 0.0)]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros_like(v[0])


@dataclasses.dataclass(frozen=True)
class BodyAxes:
    """Axes of a body, and the role of each.

    The two axes with the closest moments are `like` and `rest`; in a symmetric body, the flow about `rest` is the
    identity.
    """

    axes: np.ndarray  # (3, 3), an orthonormal axis in every column
    main: int  # numbers of columns, as the others
    like: int
    rest: int

    @classmethod
    def of(cls, tensor: np.ndarray | None) -> BodyAxes:
        """The principal axes of an inertia tensor (3, 3); the axes of the body if nothing is known."""
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

    n: Sequence[Number]
    strength: Number

    def flow(self, q: Components, L: Components, dt: jax.Array) -> Components:
        """The attitude after dt; L is the momentum in world axes."""
        momentum = quaternions.rotate(conjugate(q), L)
        half = 0.5 * dt * self.strength * _weighted(self.n, momentum)
        return quaternions.product(q, (jnp.cos(half), *scale(jnp.sin(half), arrays(self.n, half))))


@dataclasses.dataclass(frozen=True)
class Spin:
    """The kinetic energy L . J^-1 L / 2 as a sum of terms with exact flows; L is constant in the world.

    J^-1 = k I + sum_i s_i n_i n_i^T over fixed axes n_i. The first two terms together describe a symmetric body: it
    rotates about L at the rate k |L| and about its axis at s (n . L). Each of the others rotates it about its own axis.
    Three different moments need one such term; a symmetric body needs none.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration (2006), section VII.5.3 (splitting methods for rigid
    bodies), for the idea; Landau and Lifshitz, Mechanics, section 33, for the symmetric body.
    """

    tensor: Rows  # J
    inverse: Rows
    isotropic: Number  # k
    main: _Axis | None  # the axis of the symmetric part, None for a sphere
    other_axes: tuple[_Axis, ...]

    @classmethod
    def of(cls, tensor: np.ndarray) -> Spin:
        """The spin of a constant tensor (3, 3), symmetric and positive."""
        frame = BodyAxes.of(tensor)
        inverse = np.linalg.inv(tensor)
        about_axes = np.einsum("ij,ik,kj->j", frame.axes, inverse, frame.axes)
        k = float(about_axes[frame.like])
        small = 4.0 * np.finfo(float).eps * np.abs(about_axes).max()

        def axis(number: int) -> _Axis | None:
            strength = float(about_axes[number]) - k
            return _Axis(frame.axes[:, number].tolist(), strength) if abs(strength) > small else None

        rest = axis(frame.rest)
        return cls(tensor.tolist(), inverse.tolist(), k, axis(frame.main), () if rest is None else (rest,))

    @classmethod
    def of_moments(cls, moments: Components, frame: BodyAxes) -> Spin:
        """The spin of traced moments about the axes of the frame."""
        inverse, eye = [1.0 / moment for moment in moments], np.eye(3).tolist()
        main, rest = (_Axis(eye[i], inverse[i] - inverse[frame.like]) for i in (frame.main, frame.rest))
        J, J_inv = (
            [[a if i == j else 0.0 for j in range(3)] for i, a in enumerate(diagonal)]
            for diagonal in (moments, inverse)
        )
        return cls(J, J_inv, inverse[frame.like], main, (rest,))

    @classmethod
    def of_traced(cls, tensor: jax.Array, frame: BodyAxes) -> Spin:
        """The spin of a traced tensor (3, 3), symmetric and positive, whose principal axes may be far from those of the
        frame.

        Off-diagonal entries in the frame's axes are distributed to pairs of axes: n_i n_j^T + n_j n_i^T = (n_i +
        n_j)(n_i + n_j)^T - n_i n_i^T - n_j n_j^T.
        """
        # By cross products: a library call would not compile inside of a loop.
        rows = [unpack(row) for row in tensor]
        columns = [cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)]
        inverse = matrix(columns).T / dot(rows[0], columns[0])
        axes = jnp.asarray(frame.axes, tensor.dtype)
        turned = jnp.sum(axes[:, :, None, None] * inverse[:, None, :, None] * axes[None, None, :, :], axis=(0, 2))
        k = turned[frame.like, frame.like]

        def single(i: int) -> _Axis:
            return _Axis(frame.axes[:, i].tolist(), 2.0 * turned[i, i] - k - turned[i].sum())

        def pair(i: int, j: int) -> _Axis:
            n = (frame.axes[:, i] + frame.axes[:, j]) / np.sqrt(2.0)
            return _Axis(n.tolist(), 2.0 * turned[i, j])

        other_axes = (single(frame.rest), single(frame.like), *(pair(i, j) for i, j in combinations(range(3), 2)))
        return cls(rows, [unpack(row) for row in inverse], k, single(frame.main), other_axes)

    def symmetric(self, q: Components, L: Components, dt: jax.Array) -> Components:
        """The attitude after any time dt under the symmetric part; L is the momentum in world axes."""
        turned = q if self.main is None else self.main.flow(q, L, dt)
        return quaternions.product(quaternions.exp(scale(dt * self.isotropic, L)), turned)

    def flow_of_other_axes(self, q: Components, L: Components, dt: jax.Array, backwards: bool) -> Components:
        """The attitude after dt under all other parts successively."""
        if len(self.other_axes) < 2:
            return self.other_axes[0].flow(q, L, dt) if self.other_axes else q
        # A loop: unrolled, derivatives of so many rotations in a row take minutes to compile.
        directions = jnp.asarray(np.array([axis.n for axis in self.other_axes]), dt.dtype)
        strengths = vector(arrays([axis.strength for axis in self.other_axes], dt))

        def turn(q: Components, entry: tuple[jax.Array, jax.Array]) -> tuple[Components, None]:
            return _Axis(unpack(entry[0]), entry[1]).flow(q, L, dt), None

        return jax.lax.scan(turn, q, (directions, strengths), reverse=backwards)[0]


@dataclasses.dataclass(frozen=True)
class BodyInertia:
    """The momentum L = J w about the centre of mass, and p = m (v + w x c) for a body that also translates. Velocities
    and momenta are in body axes.

    With linear parts the maps are Ad* and Ad of the translation to c, [p; L] -> [p; L - c x p] and [v; w] -> [v + w x
    c; w]; momenta about the centre are [L; p]. A body that only rotates has no linear part, which is represented by ().
    """

    spin: Spin  # with J about the centre of mass, or about the origin of an attitude's frame
    mass: Number = 1.0
    center: tuple[Number, ...] = ()  # of mass, in the body's frame

    def momenta(self, velocity: Components) -> Components:
        """The momenta about the centre of mass from the velocity of the frame, or their rates from its acceleration."""
        v, w = velocity[:-3], velocity[-3:]
        p = scale(self.mass, add(v, cross(w, arrays(self.center, w[0])))) if v else ()
        return (*_times(self.spin.tensor, w), *p)

    def velocity(self, momenta: Components) -> Components:
        """The inverse of `momenta`."""
        w, p = _times(self.spin.inverse, momenta[:3]), momenta[3:]
        v = add(scale(1.0 / self.mass, p), cross(arrays(self.center, w[0]), w)) if p else ()
        return (*v, *w)

    def centered(self, momentum: Components) -> Components:
        """The momenta about the centre of mass, from those about the origin of the frame."""
        p, L = momentum[:-3], momentum[-3:]
        return (*add(L, cross(p, arrays(self.center, p[0]))), *p) if p else L

    def about_origin(self, momenta: Components) -> Components:
        """The inverse of `centered`."""
        L, p = momenta[:3], momenta[3:]
        return (*p, *add(L, cross(arrays(self.center, p[0]), p))) if p else L


def rotational(place: str, value: np.ndarray | jax.Array, default: np.ndarray | None) -> BodyInertia:
    """The inertia of moments (3,) about the body's axes or of a tensor (3, 3), constant or traced.

    The default of a traced value determines the axes of the free motion. Raises ModelError, with `place` in its
    message, for a constant that is not symmetric and positive.
    """
    default = np.diag(default) if default is not None and default.ndim == 1 else default
    if isinstance(value, np.ndarray):
        tensor = np.diag(value) if value.ndim == 1 else value
        _check_tensor(place, tensor)
        return BodyInertia(Spin.of(tensor))
    if value.ndim == 1:
        return BodyInertia(Spin.of_moments(unpack(value), BodyAxes.of(default)))
    return BodyInertia(Spin.of_traced(value, BodyAxes.of(default)))


def rigid(place: str, value: np.ndarray | jax.Array, default: np.ndarray | None) -> BodyInertia:
    """The inertia of a spatial inertia (6, 6), linear first, or of its diagonal (6,); arguments as for `rotational`.

    With m and c its blocks are m I, -m [c], m [c] and J - m [c]^2. A traced matrix of another form gives NaN.
    """
    m, c, tensor, off = _parts(value)
    if isinstance(value, np.ndarray):
        if not off <= 1e-9 * np.abs(value).max():
            raise ModelError(
                f"{place} is not the spatial inertia of a rigid body: with [v; w] its blocks must be m I, -m [c], "
                "m [c] and J - m [c]^2 of a mass m and a centre of mass c.\n"
                "  fix: pass the matrix of the system in the order of the state, or use tx.RKMK, which "
                "supports other inertias"
            )
        tensor = 0.5 * (tensor + tensor.T)
        _check_tensor(place, tensor)
        return BodyInertia(Spin.of(tensor), float(m), tuple(c.tolist()))
    # Nothing can be raised here; NaN ends an integration at its first step.
    m = jnp.where(off <= _ROUND_OFF * jnp.abs(value).max(), m, jnp.nan)
    return BodyInertia(
        Spin.of_traced(tensor, BodyAxes.of(None if default is None else _parts(default)[2])), m, unpack(c)
    )


def _parts(M: Any) -> tuple[Any, Any, Any, Any]:
    """Mass, centre of mass, tensor about it, and how far the matrix is from that of a body."""
    xp = np if isinstance(M, np.ndarray) else jnp
    eye = xp.eye(3, dtype=M.dtype)
    if M.ndim == 1:
        M = xp.eye(6, dtype=M.dtype) * M[:, None]
    m = M[0, 0]
    c = xp.stack([M[5, 1], M[3, 2], M[4, 0]]) / m
    arm = xp.cross(eye, c)  # [c]
    tensor = M[3:, 3:] + m * xp.sum(arm[:, :, None] * arm[None, :, :], axis=1)
    off = xp.stack([M[:3, :3] - m * eye, M[:3, 3:] + m * arm, M[3:, :3] - m * arm])
    return m, c, tensor, xp.abs(off).max()


def _check_tensor(place: str, tensor: np.ndarray) -> None:
    symmetric = np.abs(tensor - tensor.T).max() <= 1e-9 * np.abs(tensor).max()
    if not (symmetric and np.linalg.eigvalsh(tensor).min() > 0.0):
        raise ModelError(f"{place} expects a symmetric tensor with positive principal moments, got {tensor.tolist()}")
