"""The accuracy of exp, log and their Jacobians on SE(3), against values with fifty digits. Needs mpmath.

Each block of a result is assessed separately. Its error is the largest entry of the difference, and its unit the
spacing of floating point numbers at the largest entry of the block (for the position of exp and log: at the largest
entry of v). Beyond 1 rad the error is divided by the angle, because rounding the angle changes the exact result by that
much.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import twistax as tx

from ...groups import se3, so3
from ...scenes import SCENES
from ..harness.expected import at_most, needed, refused, simulated
from ..harness.measurement import MeasuredCase, Section, quick
from ..harness.rows import plain

#: The largest figure allowed.
BAR = 8.0
Array = np.ndarray


mpmath = functools.partial(needed, "mpmath", "mpmath")


def exact(xi: Array) -> SimpleNamespace:
    """The maps of one twist with fifty digits and more: textbook closed forms, and Taylor sums where those cancel.

    v, w: parts of the twist (3, 1), with the matrices V, W of their cross products; rotation, position: of Exp;
    jacobian, coupling: the blocks of the left Jacobian, that of SO(3) and the upper right one, its derivative in the
    direction v; jacobian_inv, coupling_inv: those of its inverse.
    """
    mp = mpmath()
    v, w = (mp.matrix([float(entry) for entry in part]) for part in (xi[:3], xi[3:]))
    V, W = (mp.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]]) for x, y, z in (v, w))
    a, b, c, db, dc = _coefficients(mp, sum(entry * entry for entry in w))
    rotation, jacobian = mp.eye(3) + a * W + b * W * W, mp.eye(3) + b * W + c * W * W
    coupling = b * V + c * (W * V + V * W) + 2 * (w.T * v)[0] * (db * W + dc * W * W)
    inverse = jacobian**-1
    blocks = {"jacobian": jacobian, "coupling": coupling, "jacobian_inv": inverse}
    blocks["coupling_inv"] = -(inverse * coupling * inverse)
    return SimpleNamespace(v=v, w=w, V=V, W=W, rotation=rotation, position=jacobian * v, **blocks)


def _coefficients(mp: Any, x: Any) -> tuple[Any, Any, Any, Any, Any]:
    """sin t/t, (1 - cos t)/t^2, (t - sin t)/t^3 and the derivatives of the last two with respect to x = t^2."""
    if x < 1:

        def taylor(k: int, slope: bool) -> Any:
            powers = ((j * x ** (j - 1) if j else 0) if slope else x**j for j in range(30))
            return mp.fsum((-1) ** j * power / mp.factorial(2 * j + k) for j, power in enumerate(powers))

        return taylor(1, False), taylor(2, False), taylor(3, False), taylor(2, True), taylor(3, True)
    t = mp.sqrt(x)
    a, b, c = mp.sin(t) / t, (1 - mp.cos(t)) / x, (t - mp.sin(t)) / (x * t)
    return a, b, c, (a - 2 * b) / (2 * x), (b - 3 * c) / (2 * x)


def twists(count: int, largest: float, dtype: Any, below: bool = False) -> Array:
    """Twists with translations of size 1e-8 to 1e6 and angles up to `largest`: a third even, a third logarithmic, a
    third at zero, at the smallest numbers, around the switch points of the series and around multiples of pi / 2.

    With `below`, angles stay away from `largest` by what rounding the pose may add to them.
    """
    rng, info = np.random.default_rng(20240607), np.finfo(dtype)
    top = largest * (1.0 - 1e3 * float(info.eps)) if below else largest
    named = [0.0, float(info.tiny) ** 0.97, float(info.tiny) ** 0.5, 1e-20, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3]
    named += [centre * (1 + step) for centre in (1.0, 2.0, 4.0) for step in (-1e-6, 1e-6)]
    named += [0.5 * np.pi * k * (1 + step) for k in range(1, 13) for step in (-1e-3, -1e-6, 1e-6, 1e-3)]
    even, logarithmic, special = map(len, np.array_split(np.arange(count), 3))
    drawn = [rng.uniform(0.0, top, even), 10.0 ** rng.uniform(-8.0, np.log10(top), logarithmic)]
    angles = np.concatenate([*drawn, np.resize([*(angle for angle in named if angle <= top), top], special)])
    axes = rng.normal(size=(count, 3))
    axes[::7] = np.eye(3)[rng.integers(0, 3, len(axes[::7]))]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    directions = rng.normal(size=(count, 3))
    directions[::5] = axes[::5]
    sizes = 10.0 ** rng.uniform(-8.0, 6.0, (count, 1))
    result = np.concatenate([sizes * directions, angles[:, None] * axes], axis=1).astype(dtype)
    # Rounding to float32 may lift the angle over the edge.
    over = np.linalg.norm(result[:, 3:].astype(np.float64), axis=1) > top
    result[over, 3:] *= dtype(1.0 - 4.0 * float(info.eps))
    return result


@dataclass(frozen=True, eq=False)
class LieMap:
    """A map of SE(3), the blocks of its result, and the largest angle at which it is checked."""

    name: str
    function: Callable[..., jax.Array]
    #: By name, the place of a block in the result, its exact value, and what its size is that of.
    blocks: Mapping[str, tuple[Any, str, str]]
    largest: float
    angles: str
    sign: float = 1.0  # of the twist whose exact values count
    of_poses: bool = False  # whether it maps the poses of the twists


_EXP = {"rotation": (np.s_[:3, :3], "rotation", "rotation"), "position": (np.s_[:3, 3:], "position", "v")}
_LOG = {"rotation": (np.s_[3:, None], "w", "w"), "position": (np.s_[:3, None], "v", "v")}
_JACOBIAN, _INVERSE = (
    {"rotation": (np.s_[:3, :3], J, J), "translation": (np.s_[:3, 3:], Q, Q)}
    for J, Q in (("jacobian", "coupling"), ("jacobian_inv", "coupling_inv"))
)

MAPS = (
    LieMap("exp", se3.exp, _EXP, 20.0, "0 to 20"),
    LieMap("log", se3.log, _LOG, float(np.pi), "below pi", of_poses=True),
    LieMap("left_jacobian", se3.left_jacobian, _JACOBIAN, 20.0, "0 to 20"),
    LieMap("left_jacobian_inv", se3.left_jacobian_inv, _INVERSE, 6.0, "0 to 6"),
    LieMap("right_jacobian_inv", se3.right_jacobian_inv, _INVERSE, 6.0, "0 to 6", sign=-1.0),
)


def worst_units(mapping: LieMap, xis: Array) -> dict[str, float]:
    """The largest error of a map over twists (n, 6), in units in the last place, by block."""
    with mpmath().workdps(60):
        wanted = [exact(mapping.sign * xi) for xi in xis]
        arguments = np.stack([_pose(it, xis.dtype) for it in wanted]) if mapping.of_poses else xis
        results = np.asarray(jax.jit(jax.vmap(mapping.function))(arguments))
        angles = np.maximum(1.0, np.linalg.norm(xis[:, 3:].astype(np.float64), axis=1))
        return {
            block: max(
                _units(got[place], getattr(it, value), getattr(it, size)) / angle
                for it, got, angle in zip(wanted, results, angles, strict=True)
            )
            for block, (place, value, size) in mapping.blocks.items()
        }


def _pose(it: SimpleNamespace, dtype: Any) -> Array:
    """The exact pose, rounded once."""
    top = np.hstack([np.array(part.tolist(), dtype=float) for part in (it.rotation, it.position)])
    return np.vstack([top, [[0.0, 0.0, 0.0, 1.0]]]).astype(dtype)


def _units(got: Array, wanted: Any, sized: Any) -> float:
    """The largest error in units of the last place at the largest entry of what gives the size."""
    if not np.all(np.isfinite(got)):
        return float("inf")
    worst = max(abs(float(value) - entry) for value, entry in zip(got.ravel(), wanted, strict=True))
    size = got.dtype.type(max(abs(float(entry)) for entry in sized))
    return float(worst / max(float(np.spacing(size)), float(np.finfo(got.dtype).tiny)))


@functools.cache
def _of_twists(mapping: LieMap, precision: str, count: int = 600) -> dict[str, float]:
    """Double precision needs JAX's x64 switch."""
    return worst_units(mapping, twists(count, mapping.largest, np.dtype(precision).type, below=mapping.of_poses))


_of_block = lambda mapping, precision, block: _of_twists(mapping, precision)[block]  # noqa: E731
_ULP = at_most(BAR, "ulp")

LAST_PLACES: Section = [
    quick(f"{mapping.name}, angles {mapping.angles} rad", f"{name}, {block}", _ULP, _of_block, mapping, name, block)
    for mapping in MAPS
    for name in ("float64", "float32")
    for block in mapping.blocks
]

#: Angles, rad.
_ANGLES = (1e-300, 1e-100, 1e-30, 1e-16, 1e-8, 1e-6, 1e-4, 1e-2, 0.5, 1.0, 2.0, 3.0)
_LARGE = (3.14, 6.0, 6.28, 10.0, 30.0, 100.0, 300.0, 1000.0)
_AXIS, _VELOCITY = np.array([1.0, 2.0, -2.0]) / 3.0, np.array([0.3, -2.0, 1.1])


def _accuracy(mapping: LieMap) -> MeasuredCase:
    angles = [angle for angle in (*_ANGLES, *_LARGE) if angle <= (1e3 if mapping.largest > 6.3 else mapping.largest)]
    xis = np.array([np.concatenate([_VELOCITY, angle * _AXIS]) for angle in angles])
    what = f"{mapping.name} of SE(3), angles {plain(angles[0])} to {plain(angles[-1])} rad"
    return quick(what, "tx.lie.se3", _ULP, lambda: max(worst_units(mapping, xis).values()))


@jax.jit
@jax.vmap
def _there_and_back(w: jax.Array) -> tuple[jax.Array, ...]:
    """log(Exp(w)) and its derivative, forward and backward."""
    turned = lambda w: so3.log(so3.exp(w))  # noqa: E731
    return turned(w), jax.jacfwd(turned)(w), jax.jacrev(turned)(w)


def _back(angle: float, derivative: bool, bar: float) -> MeasuredCase:
    def measure() -> float:
        back, *slopes = (np.asarray(value)[0] for value in _there_and_back(jnp.asarray(angle * _AXIS[None])))
        if derivative:
            return float(np.max(np.abs(np.stack(slopes) - np.eye(3))))
        return float(np.max(np.abs(back - angle * _AXIS)) / angle)

    what = f"{'derivative of ' if derivative else ''}log(Exp(w)), |w| = {plain(angle)} rad"
    return quick(what, "tx.lie.so3", at_most(bar), measure)


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
    return float(max(np.linalg.norm((back - xi)[part]) / np.linalg.norm(xi[part]) for part in np.s_[:3, 3:]))


ANGLES: Section = [
    "Series where closed forms cancel, closed forms elsewhere: near round-off everywhere (per rad beyond 1 rad).",
    *map(_accuracy, MAPS),
    "Small rotations keep their direction and size to round-off, far below where R equals the identity.",
    *(_back(angle, False, 1e-15 if angle < 1.5 else 3e-15) for angle in _ANGLES),
    "Every coefficient function carries a derivative of its own: no 0/0 at any angle.",
    *(_back(angle, True, 2e-14) for angle in _ANGLES),
    "At half a turn w and -w are one rotation; the one with a positive first entry comes back, with finite slopes.",
    quick("log of a half turn", "tx.lie.so3", at_most(1e-15, "rad"), _half_turn, slow=True),
    "At a full turn the left Jacobian has no inverse; just before, the loss is that of its condition.",
    quick("left Jacobian times its inverse, 1e-6 rad before a full turn", "tx.lie.so3", at_most(1e-9), _at_full_turn),
    "Rotation and translation do not share a scale: each comes back to its own round-off.",
    quick("log(Exp(xi)) of a pose with |v| = 1e9 m, |w| = 1e-9 rad", "tx.lie.se3", at_most(1e-15), _pose_round_trip),
]

_TOP = SCENES["euler-top"]
_EPS = float(np.finfo(np.float32).eps)
_DOP853, _RK4 = tx.RKMK(tx.tableaus.DOP853), tx.RKMK(tx.tableaus.RK4)


def _top(duration: float, **options: Any) -> dict[str, Any]:
    """The end of the Euler top in float32. Raises TypeError if it came back as something else."""
    start = {name: np.asarray(value, np.float32) for name, value in _TOP.start.items()}
    sol = simulated(_TOP.dynamics, start, t1=duration, **options)
    if any(value.dtype != jnp.float32 for value in sol.xs.values()):
        raise TypeError("float32 arguments, but another precision in the result")
    return {name: value[-1] for name, value in sol.xs.items()}


def _error(**steps: float) -> float:
    """The error after 2 s, in units of the precision."""
    return _TOP.error(_top(2.0, method=_DOP853, **steps), t=2.0) / _EPS


def _defect() -> float:
    """|R'R - I| after 10,000 steps, in units of the precision."""
    R = np.asarray(_top(20.0, steps=10_000, method=_RK4)["R"], float)
    return float(np.max(np.abs(R.T @ R - np.eye(3)))) / _EPS


def _single_round_trip() -> float:
    w = np.float32(1e-30) * np.array([1.0, 2.0, -2.0], np.float32)
    return float(np.max(np.abs(np.asarray(so3.log(so3.exp(jnp.asarray(w)))) - w)) / 1e-30) / _EPS


_single_units = lambda mapping: max(_of_twists(mapping, "float32", 60).values())  # noqa: E731
_TOO_FINE = refused(tx.InputError, "ten times the round-off of float32")

PRECISION: Section = [
    "Only round-off is left: a few units for some rad of motion.",
    quick("Euler top, 2 s, equal steps of 0.02 s", "DOP853", at_most(50.0, "eps"), _error, dt=0.02),
    "A tolerance of 80 eps is kept.",
    quick("Euler top, 2 s, rtol 1e-5", "DOP853", at_most(200.0, "eps"), _error, rtol=1e-5),
    "Finer than round-off no step can be; the message tells how to get doubles.",
    quick("rtol 1e-6, which is below ten eps", "DOP853", _TOO_FINE, _error, rtol=1e-6),
    "The stored quaternion is put back to length one in every step.",
    quick("R'R - I after 10,000 steps", "RK4", at_most(5.0, "eps"), _defect),
    "The squares underflow; the series never sees them.",
    quick("log(Exp(w)), |w| = 3e-30 rad", "tx.lie.so3", at_most(4.0, "eps"), _single_round_trip),
    "Single precision has switch points of its own between series and closed forms.",
    *(quick(f"{m.name} of SE(3), 60 twists", "tx.lie.se3", _ULP, _single_units, m, slow=True) for m in MAPS),
]
