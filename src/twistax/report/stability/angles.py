"""The maps at angles of every size, and single precision."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import se3, so3
from ...scenes import SCENES
from ..checks import Check, Section, at_most, refused, simulated
from ..figures.maps import BAR, MAPS, Map, twists, worst_units
from ..rows import plain

#: Angles, rad.
_ANGLES = (1e-300, 1e-100, 1e-30, 1e-16, 1e-8, 1e-6, 1e-4, 1e-2, 0.5, 1.0, 2.0, 3.0)
_LARGE = (3.14, 6.0, 6.28, 10.0, 30.0, 100.0, 300.0, 1000.0)
_AXIS, _VELOCITY = np.array([1.0, 2.0, -2.0]) / 3.0, np.array([0.3, -2.0, 1.1])
_ULP = at_most(BAR, "ulp")


def _worst(each: Map, xis: Any) -> float:
    return max(units for units, _ in worst_units(each, xis).values())


def _accuracy(each: Map) -> Check:
    angles = tuple(angle for angle in (*_ANGLES, *_LARGE) if angle <= (1e3 if each.largest > 6.3 else each.largest))
    xis = np.array([np.concatenate([_VELOCITY, angle * _AXIS]) for angle in angles])
    span = f"{plain(angles[0])} to {plain(angles[-1])} rad"
    return Check(f"{each.name} of SE(3), angles {span}", "tx.lie.se3", lambda: _worst(each, xis), _ULP)


@functools.cache
def _round_trips() -> Any:
    """log(Exp(w)) and its derivative, forward and backward, compiled once."""

    def there_and_back(w: jax.Array) -> jax.Array:
        return so3.log(so3.exp(w))

    def all_of(w: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return there_and_back(w), jax.jacfwd(there_and_back)(w), jax.jacrev(there_and_back)(w)

    return jax.jit(jax.vmap(all_of))


def _back(angle: float, derivative: bool, bar: float) -> Check:
    def measure() -> float:
        w = angle * _AXIS
        back, *slopes = (np.asarray(value)[0] for value in _round_trips()(jnp.asarray(w[None])))
        if derivative:
            return float(np.max(np.abs(np.stack(slopes) - np.eye(3))))
        return float(np.max(np.abs(back - w)) / angle)

    what = f"{'derivative of ' if derivative else ''}log(Exp(w)), |w| = {plain(angle)} rad"
    return Check(what, "tx.lie.so3", measure, at_most(bar))


def _half_turn() -> float:
    """How far log of a half turn about an axis is from it; NaN if its derivatives are not finite."""
    R = jnp.asarray(2.0 * np.outer(_AXIS, _AXIS) - np.eye(3))
    back, slope = np.asarray(so3.log(R)), np.asarray(jax.jacfwd(so3.log)(R))
    return float(np.linalg.norm(back - np.pi * _AXIS)) if np.isfinite(slope).all() else float("nan")


def _at_full_turn() -> float:
    """How far the inverse of the left Jacobian is from inverting it, relative to its size."""
    w = jnp.asarray((2.0 * np.pi - 1e-6) * _AXIS)
    J, inverse = so3.left_jacobian(w), so3.left_jacobian_inv(w)
    return float(np.max(np.abs(J @ inverse - np.eye(3))) / np.max(np.abs(inverse)))


def _pose_round_trip() -> float:
    xi = np.concatenate([1e9 * _VELOCITY, 1e-9 * _AXIS])
    back = np.asarray(se3.log(se3.exp(jnp.asarray(xi))))
    parts = [np.linalg.norm(back[i:j] - xi[i:j]) / np.linalg.norm(xi[i:j]) for i, j in ((0, 3), (3, 6))]
    return float(max(parts))


ANGLES = Section(
    "angles",
    [
        "Series where closed forms cancel, closed forms elsewhere: near round-off everywhere (per rad beyond 1 rad).",
        *[_accuracy(each) for each in MAPS],
        "Small rotations keep their direction and size to round-off, far below where R equals the identity.",
        *(_back(angle, False, 1e-15 if angle < 1.5 else 3e-15) for angle in _ANGLES),
        "Every coefficient function carries a derivative of its own: no 0/0 at any angle.",
        *(_back(angle, True, 2e-14) for angle in _ANGLES),
        "At half a turn w and -w are one rotation; the one with a positive first entry comes back, with finite slopes.",
        Check("log of a half turn", "tx.lie.so3", _half_turn, at_most(1e-15, "rad"), slow=True),
        "At a full turn the left Jacobian has no inverse; just before, the loss is that of its condition.",
        Check(
            "left Jacobian times its inverse, 1e-6 rad before a full turn", "tx.lie.so3", _at_full_turn, at_most(1e-9)
        ),
        "Rotation and translation do not share a scale: each comes back to its own round-off.",
        Check(
            "log(Exp(xi)) of a pose with |v| = 1e9 m, |w| = 1e-9 rad", "tx.lie.se3", _pose_round_trip, at_most(1e-15)
        ),
    ],
)


# ---- single precision -----------------------------------------------------------------------------------------------

_TOP = SCENES["euler-top"]
_EPS = float(np.finfo(np.float32).eps)
_DOP853, _RK4 = tx.RKMK(tx.tableaus.DOP853), tx.RKMK(tx.tableaus.RK4)


def _top(duration: float, **options: Any) -> tx.Solution:
    """The Euler top in float32. Raises TypeError if it came back as something else."""
    start = {name: np.asarray(value, np.float32) for name, value in _TOP.start.items()}
    sol = simulated(_TOP.dynamics, start, t1=duration, **options)
    if any(value.dtype != jnp.float32 for value in sol.xs.values()):
        raise TypeError("float32 went in, something else came out")
    return sol


def _error(**steps: Any) -> float:
    """After 2 s, in units of the precision."""
    sol = _top(2.0, method=_DOP853, **steps)
    return _TOP.error({name: value[-1] for name, value in sol.xs.items()}, t=2.0) / _EPS


def _defect() -> float:
    """|R'R - I| after 10,000 steps, in units of the precision."""
    R = np.asarray(_top(20.0, steps=10_000, method=_RK4).xs["R"][-1], float)
    return float(np.max(np.abs(R.T @ R - np.eye(3)))) / _EPS


def _single_round_trip() -> float:
    w = np.float32(1e-30) * np.array([1.0, 2.0, -2.0], np.float32)
    return float(np.max(np.abs(np.asarray(so3.log(so3.exp(jnp.asarray(w)))) - w)) / 1e-30) / _EPS


_TOO_FINE = refused(tx.InputError, "ten times the round-off of float32")

PRECISION = Section(
    "single",
    [
        "Only round-off is left: a few units for some rad of motion.",
        Check("Euler top, 2 s, equal steps of 0.02 s", "DOP853", lambda: _error(dt=0.02), at_most(50.0, "eps")),
        "A tolerance of 80 eps is kept.",
        Check("Euler top, 2 s, rtol 1e-5", "DOP853", lambda: _error(rtol=1e-5), at_most(200.0, "eps")),
        "Finer than round-off no step can be; the message tells how to get doubles.",
        Check("rtol 1e-6, which is below ten eps", "DOP853", lambda: _error(rtol=1e-6), _TOO_FINE),
        "The stored quaternion is put back to length one in every step.",
        Check("R'R - I after 10,000 steps", "RK4", _defect, at_most(5.0, "eps")),
        "The squares underflow; the series never sees them.",
        Check("log(Exp(w)), |w| = 3e-30 rad", "tx.lie.so3", _single_round_trip, at_most(4.0, "eps")),
        "Single precision has switch points of its own between series and closed forms.",
        *[
            Check(
                f"{each.name} of SE(3), 60 twists",
                "tx.lie.se3",
                lambda each=each: _worst(each, twists(60, each.largest, np.float32, below=each.of_poses)),  # type: ignore[misc]
                _ULP,
                slow=True,
            )
            for each in MAPS
        ],
    ],
)
