"""The maps of SO(3) and SE(3) at angles from 1e-300 to 1e3 rad."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...groups import se3, so3
from ..accuracy_of_maps import BAR, MAPS, Map, worst_units
from .row import AtMost, Row, Section, plain

__all__ = ["ANGLES"]

#: Angles, rad.
_ANGLES = (1e-300, 1e-100, 1e-30, 1e-16, 1e-8, 1e-6, 1e-4, 1e-2, 0.5, 1.0, 2.0, 3.0)
_LARGE = (3.14, 6.0, 6.28, 10.0, 30.0, 100.0, 300.0, 1000.0)
_AXIS, _VELOCITY = np.array([1.0, 2.0, -2.0]) / 3.0, np.array([0.3, -2.0, 1.1])


def _twists(angles: tuple[float, ...]) -> Any:
    return np.array([np.concatenate([_VELOCITY, angle * _AXIS]) for angle in angles])


def _accuracy(each: Map) -> Row:
    angles = tuple(angle for angle in (*_ANGLES, *_LARGE) if angle <= (1e3 if each.largest > 6.3 else each.largest))
    return Row(
        f"{each.name} of SE(3), angles {plain(angles[0])} to {plain(angles[-1])} rad",
        "tx.lie.se3",
        lambda: max(units for units, _ in worst_units(each, _twists(angles)).values()),
        AtMost(BAR, "ulp"),
        "Series where closed forms cancel, closed forms elsewhere: near round-off everywhere (per rad beyond 1 rad).",
    )


@functools.cache
def _round_trips() -> Any:
    """log(Exp(w)) and its derivative, forward and backward, compiled once."""

    def there_and_back(w: jax.Array) -> jax.Array:
        return so3.log(so3.exp(w))

    def all_of(w: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return there_and_back(w), jax.jacfwd(there_and_back)(w), jax.jacrev(there_and_back)(w)

    return jax.jit(jax.vmap(all_of))


def _round_trip(angle: float, derivative: bool) -> float:
    w = angle * _AXIS
    back, forward, backward = (np.asarray(value)[0] for value in _round_trips()(jnp.asarray(w[None])))
    if not derivative:
        return float(np.max(np.abs(back - w)) / angle)
    return float(max(np.max(np.abs(found - np.eye(3))) for found in (forward, backward)))


def _half_turn() -> float:
    """How far log of a half turn about an axis is from it, and whether its derivatives are numbers."""
    R = 2.0 * np.outer(_AXIS, _AXIS) - np.eye(3)
    back, slope = np.asarray(so3.log(jnp.asarray(R))), np.asarray(jax.jacfwd(so3.log)(jnp.asarray(R)))
    return float(np.linalg.norm(back - np.pi * _AXIS)) if np.isfinite(slope).all() else float("nan")


def _inverse_at(angle: float) -> float:
    """How far the inverse of the left Jacobian is from inverting it, relative to its size."""
    J, inverse = so3.left_jacobian(jnp.asarray(angle * _AXIS)), so3.left_jacobian_inv(jnp.asarray(angle * _AXIS))
    return float(np.max(np.abs(J @ inverse - np.eye(3))) / np.max(np.abs(inverse)))


ANGLES = Section(
    "angles",
    "Angles from 1e-300 to 1e3 rad",
    "The maps against values with fifty digits, in units in the last place (ulp); log(Exp(w)) against w, relative to "
    "|w|; its derivative against the identity, forward and backward. The axis is (1, 2, -2)/3.",
    (
        *(_accuracy(each) for each in MAPS),
        *(
            Row(
                f"log(Exp(w)), |w| = {plain(angle)} rad",
                "tx.lie.so3",
                functools.partial(_round_trip, angle, False),
                AtMost(1e-15 if angle < 1.5 else 3e-15),
                "Small rotations keep their direction and size to round-off, far below where R equals the identity.",
            )
            for angle in _ANGLES
        ),
        *(
            Row(
                f"derivative of log(Exp(w)), |w| = {plain(angle)} rad",
                "tx.lie.so3",
                functools.partial(_round_trip, angle, True),
                AtMost(2e-14),
                "Every coefficient function carries a derivative of its own: no 0/0 at any angle.",
            )
            for angle in _ANGLES
        ),
        Row(
            "log of a half turn",
            "tx.lie.so3",
            _half_turn,
            AtMost(1e-15, "rad"),
            "At half a turn w and -w are the same rotation; the one whose first entry is positive comes back, with "
            "finite derivatives.",
            slow=True,
        ),
        Row(
            "left Jacobian times its inverse, 1e-6 rad before a full turn",
            "tx.lie.so3",
            lambda: _inverse_at(2.0 * np.pi - 1e-6),
            AtMost(1e-9),
            "At a full turn the left Jacobian has no inverse; just before, the loss is that of its condition.",
        ),
        Row(
            "log(Exp(xi)) of a pose with |v| = 1e9 m, |w| = 1e-9 rad",
            "tx.lie.se3",
            lambda: _pose_round_trip(1e9, 1e-9),
            AtMost(1e-15),
            "Rotation and translation do not share a scale: each comes back to its own round-off.",
        ),
    ),
)


def _pose_round_trip(size: float, angle: float) -> float:
    xi = np.concatenate([size * _VELOCITY, angle * _AXIS])
    back = np.asarray(se3.log(se3.exp(jnp.asarray(xi))))
    parts = [np.linalg.norm(back[i:j] - xi[i:j]) / np.linalg.norm(xi[i:j]) for i, j in ((0, 3), (3, 6))]
    return float(max(parts))
