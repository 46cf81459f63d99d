"""How accurate exp, log and their Jacobians are on SE(3), against values with fifty digits. Needs mpmath.

Each block of a result is judged alone. Its error is the largest entry of the difference, its unit the spacing of
floating point numbers at the largest entry of the block (for the position of exp and log: at the largest entry of v).
Beyond 1 rad the figure is divided by the angle, because rounding the angle itself moves the exact result that far.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import jax
import numpy as np

from ...groups import se3
from ..checks import Absent, Check, Section, at_most

BAR = 8.0
"""The largest figure allowed."""

_DIGITS = 60
_SEED = 20240607

Array = np.ndarray


def mpmath() -> ModuleType:
    """The module. Raises Absent where it is not installed."""
    try:
        import mpmath
    except ImportError as error:
        raise Absent("not run: mpmath is not installed; pip install mpmath") from error
    return mpmath


class Exact:
    """The maps of one twist with fifty digits and more: textbook closed forms, and Taylor sums where those cancel.

    Attributes:
        v, w, W, V: parts of the twist (3, 1), and the matrices of their cross products.
        rotation, position: of Exp.
        jacobian, coupling: the blocks of the left Jacobian, that of SO(3) and the upper right one.
        jacobian_inv, coupling_inv: those of its inverse.
    """

    def __init__(self, xi: Array) -> None:
        self.mp = mpmath()
        self.v, self.w = (self.mp.matrix([float(entry) for entry in part]) for part in (xi[:3], xi[3:]))
        self.V, self.W = (self.mp.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]]) for x, y, z in (self.v, self.w))
        self.x = sum(entry * entry for entry in self.w)

    @cached_property
    def coefficients(self) -> tuple[Any, Any, Any, Any, Any]:
        """sin t/t, (1 - cos t)/t^2, (t - sin t)/t^3 and the derivatives of the last two with respect to t^2."""
        mp, x = self.mp, self.x
        if x < 1:

            def taylor(k: int, slope: bool) -> Any:
                powers = ((j * x ** (j - 1) if j else 0) if slope else x**j for j in range(30))
                return mp.fsum((-1) ** j * power / mp.factorial(2 * j + k) for j, power in enumerate(powers))

            return taylor(1, False), taylor(2, False), taylor(3, False), taylor(2, True), taylor(3, True)
        t = mp.sqrt(x)
        a, b, d = mp.sin(t) / t, (1 - mp.cos(t)) / x, (t - mp.sin(t)) / (x * t)
        return a, b, d, (a - 2 * b) / (2 * x), (b - 3 * d) / (2 * x)

    @cached_property
    def rotation(self) -> Any:
        a, b, *_ = self.coefficients
        return self.mp.eye(3) + a * self.W + b * self.W * self.W

    @cached_property
    def jacobian(self) -> Any:
        _, b, c, *_ = self.coefficients
        return self.mp.eye(3) + b * self.W + c * self.W * self.W

    @cached_property
    def coupling(self) -> Any:
        """The derivative of `jacobian` in the direction v."""
        _, b, c, db, dc = self.coefficients
        W, V, wv = self.W, self.V, (self.w.T * self.v)[0]
        return b * V + c * (W * V + V * W) + 2 * wv * (db * W + dc * W * W)

    @property
    def position(self) -> Any:
        return self.jacobian * self.v

    @cached_property
    def jacobian_inv(self) -> Any:
        return self.jacobian**-1

    @cached_property
    def coupling_inv(self) -> Any:
        return -(self.jacobian_inv * self.coupling * self.jacobian_inv)


def twists(count: int, largest: float, dtype: Any, below: bool = False) -> Array:
    """Twists with translations of size 1e-8 to 1e6 and angles up to `largest`: a third even, a third logarithmic, a
    third at zero, at the smallest numbers, around the switch points of the series and around multiples of pi / 2.

    With `below`, angles stay away from `largest` by what rounding the pose may add to them.
    """
    rng, info = np.random.default_rng(_SEED), np.finfo(dtype)
    top = largest * (1.0 - 1e3 * float(info.eps)) if below else largest
    named = [0.0, float(info.tiny) ** 0.97, float(info.tiny) ** 0.5, 1e-20, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3]
    named += [centre * (1 + step) for centre in (1.0, 2.0, 4.0) for step in (-1e-6, 1e-6)]
    named += [0.5 * np.pi * k * (1 + step) for k in range(1, 13) for step in (-1e-3, -1e-6, 1e-6, 1e-3)]
    even, logarithmic, rest = map(len, np.array_split(np.arange(count), 3))
    drawn = [rng.uniform(0.0, top, even), 10.0 ** rng.uniform(-8.0, np.log10(top), logarithmic)]
    angles = np.concatenate([*drawn, np.resize([*(angle for angle in named if angle <= top), top], rest)])
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
class Map:
    """A map of twists, and how far it is asked for.

    Attributes:
        blocks: by name, the place of a block in the result, its exact value, and what its size is that of.
        sign: of the twist whose exact values count.
        of_poses: whether it maps the poses of the twists.
    """

    name: str
    function: Callable[..., jax.Array]
    blocks: Mapping[str, tuple[Any, str, str]]
    largest: float
    angles: str
    sign: float = 1.0
    of_poses: bool = False


_EXP = {"rotation": (np.s_[:3, :3], "rotation", "rotation"), "position": (np.s_[:3, 3:], "position", "v")}
_LOG = {"rotation": (np.s_[3:, None], "w", "w"), "position": (np.s_[:3, None], "v", "v")}
_JACOBIAN, _INVERSE = (
    {"rotation": (np.s_[:3, :3], J, J), "translation": (np.s_[:3, 3:], Q, Q)}
    for J, Q in (("jacobian", "coupling"), ("jacobian_inv", "coupling_inv"))
)

MAPS = (
    Map("exp", se3.exp, _EXP, 20.0, "0 to 20"),
    Map("log", se3.log, _LOG, float(np.pi), "below pi", of_poses=True),
    Map("left_jacobian", se3.left_jacobian, _JACOBIAN, 20.0, "0 to 20"),
    Map("left_jacobian_inv", se3.left_jacobian_inv, _INVERSE, 6.0, "0 to 6"),
    Map("right_jacobian_inv", se3.right_jacobian_inv, _INVERSE, 6.0, "0 to 6", sign=-1.0),
)


def worst_units(each: Map, xis: Array) -> dict[str, tuple[float, float]]:
    """By block the largest error of a map over twists (n, 6), in units in the last place, and the angle where it is."""
    with mpmath().workdps(_DIGITS):
        exacts = [Exact(each.sign * xi) for xi in xis]
        arguments = np.stack([_pose(exact, xis.dtype) for exact in exacts]) if each.of_poses else xis
        results = np.asarray(jax.jit(jax.vmap(each.function))(arguments))
        worst = dict.fromkeys(each.blocks, (0.0, 0.0))
        for xi, exact, got in zip(xis, exacts, results, strict=True):
            angle = float(np.linalg.norm(xi[3:].astype(np.float64)))
            for block, (place, value, size) in each.blocks.items():
                units = _units(got[place], getattr(exact, value), getattr(exact, size)) / max(1.0, angle)
                worst[block] = max(worst[block], (units, angle))
    return worst


def _pose(exact: Exact, dtype: Any) -> Array:
    """The exact pose, rounded once."""
    top = np.hstack([np.array(part.tolist(), dtype=float) for part in (exact.rotation, exact.position)])
    return np.vstack([top, [[0.0, 0.0, 0.0, 1.0]]]).astype(dtype)


def _units(got: Array, exact: Any, sized: Any) -> float:
    """The largest error in units of the last place at the largest entry of what gives the size."""
    if not np.all(np.isfinite(got)):
        return float("inf")
    worst = max(abs(float(value) - entry) for value, entry in zip(got.ravel(), exact, strict=True))
    size = got.dtype.type(max(abs(float(entry)) for entry in sized))
    return float(worst / max(float(np.spacing(size)), float(np.finfo(got.dtype).tiny)))


@functools.cache
def _worst(each: Map, precision: str) -> dict[str, tuple[float, float]]:
    """Of 600 twists."""
    return worst_units(each, twists(600, each.largest, np.dtype(precision).type, below=each.of_poses))


def _check(each: Map, precision: str, block: str) -> Check:
    """Double precision needs JAX's x64 switch."""
    what, by = f"{each.name}, angles {each.angles} rad", f"{precision}, {block}"
    return Check(what, by, lambda: _worst(each, precision)[block][0], at_most(BAR, "ulp"))


LAST_PLACES = Section(
    "maps",
    [_check(each, name, block) for each in MAPS for name in ("float64", "float32") for block in each.blocks],
    wide=True,
)
