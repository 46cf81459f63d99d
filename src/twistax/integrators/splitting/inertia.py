"""The inertia of a rigid body as free motion needs it: about the point that moves straight ahead."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...groups import so3
from ...groups.arrays import Components, add, cross, scale, unpack
from .spin import Frame, Number, Spin, arrays, times

__all__ = ["CenteredInertia", "RotationalInertia", "rigid", "rotational"]

#: How far, relative to its largest entry, a matrix may be from that of a rigid body; a float32 one by round-off.
_ROUND_OFF = 1e-5


@dataclasses.dataclass(frozen=True)
class RotationalInertia:
    """A body that turns about the origin of its frame: L = J w. Velocities and momenta are in body axes.

    Attributes:
        spin: the rotation about the centre of free motion.
    """

    spin: Spin

    def momenta(self, velocity: Components) -> Components:
        """The momenta of a velocity of the body's frame, angular first; linear, as is that of a rate of both."""
        return times(self.spin.tensor, velocity)

    def velocity(self, momenta: Components) -> Components:
        """The inverse of `momenta`."""
        return times(self.spin.inverse, momenta)

    def centered(self, momentum: Components) -> Components:
        """Momenta about the frame's origin, linear first where there is a linear part, as momenta about the centre."""
        return momentum

    def about_origin(self, momenta: Components) -> Components:
        """The inverse of `centered`."""
        return momenta


@dataclasses.dataclass(frozen=True)
class CenteredInertia(RotationalInertia):
    """A rigid body with mass m and centre of mass c in its frame: L = J w about c, and p = m (v + w x c).

    These are Ad* and Ad of the shift to c, [p; L] -> [p; L - c x p] and [v; w] -> [v + w x c; w].

    Attributes:
        spin: with J about c.
        mass, center: m and c.
    """

    mass: Number
    center: tuple[Number, ...]

    def momenta(self, velocity: Components) -> Components:
        v, w = velocity[:3], velocity[3:]
        return (*times(self.spin.tensor, w), *scale(self.mass, add(v, cross(w, arrays(self.center, v[0])))))

    def velocity(self, momenta: Components) -> Components:
        w = times(self.spin.inverse, momenta[:3])
        return (*add(scale(1.0 / self.mass, momenta[3:]), cross(arrays(self.center, w[0]), w)), *w)

    def centered(self, momentum: Components) -> Components:
        p, L = momentum[:3], momentum[3:]
        return (*add(L, cross(p, arrays(self.center, p[0]))), *p)

    def about_origin(self, momenta: Components) -> Components:
        L, p = momenta[:3], momenta[3:]
        return (*p, *add(L, cross(arrays(self.center, p[0]), p)))


def rotational(place: str, value: np.ndarray | jax.Array, known: np.ndarray | None) -> RotationalInertia:
    """The inertia of moments (3,) about the body's axes or of a tensor (3, 3).

    Args:
        place: what messages call it.
        value: a constant, or a traced value.
        known: of a traced value, its default, which chooses the axes of the free motion.
    Raises:
        ModelError: a constant that is not symmetric and positive.
    """
    if isinstance(value, np.ndarray):
        tensor = np.diag(value) if value.ndim == 1 else value
        _check_tensor(place, tensor)
        return RotationalInertia(Spin.of(tensor))
    if value.ndim == 1:
        known = None if known is None else np.diag(known)
        return RotationalInertia(Spin.of_moments(unpack(value), Frame.of(known)))
    return RotationalInertia(Spin.of_traced(value, Frame.of(known)))


def rigid(place: str, value: np.ndarray | jax.Array, known: np.ndarray | None) -> CenteredInertia:
    """The inertia of a spatial inertia (6, 6), linear first, or of its diagonal (6,).

    With m and c its blocks are m I, -m [c], m [c] and J - m [c]^2. A traced matrix of another form gives NaN.

    Args:
        place, value, known: as for `rotational`.
    Raises:
        ModelError: a constant that is not of this form.
    """
    if value.ndim == 1:
        value = np.diag(value) if isinstance(value, np.ndarray) else _traced_diagonal(value)
        known = None if known is None else np.diag(known)
    if isinstance(value, np.ndarray):
        m, c, tensor = _parts(value, np)
        again = _assembled(m, c, tensor, np)
        if not np.abs(again - value).max() <= 1e-9 * np.abs(value).max():
            raise ModelError(
                f"{place} is not the spatial inertia of a rigid body: with [v; w] its blocks must be m I, -m [c], "
                "m [c] and J - m [c]^2 of a mass m and a centre of mass c.\n"
                "  fix: give the matrix of the system in the order of the state; tx.RKMK takes bodies of other inertia"
            )
        tensor = 0.5 * (tensor + tensor.T)
        _check_tensor(place, tensor)
        return CenteredInertia(Spin.of(tensor), float(m), tuple(c.tolist()))
    m, c, tensor = _parts(value, jnp)
    off = jnp.abs(_assembled(m, c, tensor, jnp) - value).max()
    # Nothing can be raised here; NaN ends an integration at its first step.
    m = jnp.where(off <= _ROUND_OFF * jnp.abs(value).max(), m, jnp.nan)
    frame = Frame.of(None if known is None else _parts(known, np)[2])
    return CenteredInertia(Spin.of_traced(tensor, frame), m, unpack(c))


def _parts(M: Any, xp: Any) -> tuple[Any, Any, Any]:
    """Mass, centre of mass and tensor about it."""
    m = M[0, 0]
    c = xp.stack([M[5, 1], M[3, 2], M[4, 0]]) / m
    arm = _hat(c, xp)
    return m, c, M[3:, 3:] + m * _squared(arm, xp)


def _assembled(m: Any, c: Any, tensor: Any, xp: Any) -> Any:
    arm = _hat(c, xp)
    corner = tensor - m * _squared(arm, xp)
    top = xp.concatenate([m * xp.eye(3, dtype=tensor.dtype), -m * arm], axis=1)
    return xp.concatenate([top, xp.concatenate([m * arm, corner], axis=1)], axis=0)


def _hat(c: Any, xp: Any) -> Any:
    return so3.hat(c) if xp is jnp else np.cross(np.eye(3), c)


def _squared(arm: Any, xp: Any) -> Any:
    return xp.sum(arm[:, :, None] * arm[None, :, :], axis=1)


def _traced_diagonal(entries: jax.Array) -> jax.Array:
    return jnp.eye(6, dtype=entries.dtype) * entries[:, None]


def _check_tensor(place: str, tensor: np.ndarray) -> None:
    symmetric = np.abs(tensor - tensor.T).max() <= 1e-9 * np.abs(tensor).max()
    if not (symmetric and np.linalg.eigvalsh(tensor).min() > 0.0):
        raise ModelError(f"{place} expects a symmetric tensor with positive principal moments, got {tensor.tolist()}")
