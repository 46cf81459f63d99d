"""How accurate exp, log and their Jacobians are on SE(3), against values with fifty digits. Needs mpmath.

Each block of a result is judged alone. Its error is the largest entry of the difference, its unit the spacing of
floating point numbers at the largest entry of the block (for the position of exp and log: at the largest entry of v).
Beyond 1 rad the figure is divided by the angle, because rounding the angle itself moves the exact result that far.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import jax
import numpy as np

from ...groups import se3
from ..checks import Absent, Check, Section, at_most

__all__ = ["BAR", "MAPS", "SECTION", "Exact", "Map", "mpmath", "poses_of", "twists", "worst_units"]

BAR = 8.0
"""The largest figure allowed."""

_DIGITS = 60
_SEED = 20240607

Rows = list[list[Any]]


def mpmath() -> ModuleType:
    """The module. Raises Absent where it is not installed."""
    try:
        import mpmath
    except ImportError as error:
        raise Absent("not run: mpmath is not installed; pip install mpmath") from error
    return mpmath


class Exact:
    """The maps of one twist with fifty digits and more: textbook closed forms, and Taylor sums where those cancel."""

    def __init__(self, xi: np.ndarray) -> None:
        self.mp = mpmath()
        numbers = [self.mp.mpf(float(entry)) for entry in xi]
        self.v, self.w = numbers[:3], numbers[3:]
        self.x = sum(entry * entry for entry in self.w)
        self.wv = sum(a * b for a, b in zip(self.w, self.v, strict=True))
        self.W, self.V = _hat(self.w), _hat(self.v)

    @cached_property
    def coefficients(self) -> tuple[Any, Any, Any, Any, Any]:
        """sin t/t, (1 - cos t)/t^2, (t - sin t)/t^3 and the derivatives of the last two with respect to t^2."""
        mp, x = self.mp, self.x
        if x < 1:

            def taylor(k: int, slope: bool) -> Any:
                terms = (
                    (-1) ** j * (j * x ** (j - 1) if slope else x**j) / mp.factorial(2 * j + k)
                    for j in range(1 if slope else 0, 30)
                )
                return mp.fsum(terms)

            return taylor(1, False), taylor(2, False), taylor(3, False), taylor(2, True), taylor(3, True)
        t = mp.sqrt(x)
        s, c = mp.sin(t), mp.cos(t)
        b, d = (1 - c) / x, (t - s) / (x * t)
        return s / t, b, d, (s / t - 2 * b) / (2 * x), ((1 - c) / x - 3 * d) / (2 * x)

    def _polynomial(self, a: Any, b: Any) -> Rows:
        """I + a W + b W^2."""
        square = _product(self.W, self.W)
        return [[(i == j) + a * self.W[i][j] + b * square[i][j] for j in range(3)] for i in range(3)]

    @cached_property
    def rotation(self) -> Rows:
        a, b, *_ = self.coefficients
        return self._polynomial(a, b)

    @cached_property
    def jacobian(self) -> Rows:
        """The left Jacobian of SO(3)."""
        _, b, c, *_ = self.coefficients
        return self._polynomial(b, c)

    @cached_property
    def coupling(self) -> Rows:
        """The upper right block of the left Jacobian of SE(3): the derivative of `jacobian` in the direction v."""
        _, b, c, db, dc = self.coefficients
        W, V, WW = self.W, self.V, _product(self.W, self.W)
        mixed, other = _product(W, V), _product(V, W)
        return [
            [
                b * V[i][j] + c * (mixed[i][j] + other[i][j]) + 2 * self.wv * (db * W[i][j] + dc * WW[i][j])
                for j in range(3)
            ]
            for i in range(3)
        ]

    @property
    def position(self) -> list[Any]:
        return [sum(a * b for a, b in zip(row, self.v, strict=True)) for row in self.jacobian]

    @cached_property
    def jacobian_inv(self) -> Rows:
        """The inverse by cofactors, not by its closed form."""
        J = self.jacobian
        cofactor = [
            [
                J[(i + 1) % 3][(j + 1) % 3] * J[(i + 2) % 3][(j + 2) % 3]
                - J[(i + 1) % 3][(j + 2) % 3] * J[(i + 2) % 3][(j + 1) % 3]
                for j in range(3)
            ]
            for i in range(3)
        ]
        determinant = sum(J[0][j] * cofactor[0][j] for j in range(3))
        return [[cofactor[j][i] / determinant for j in range(3)] for i in range(3)]

    @cached_property
    def coupling_inv(self) -> Rows:
        """-J^-1 Q J^-1."""
        product = _product(_product(self.jacobian_inv, self.coupling), self.jacobian_inv)
        return [[-entry for entry in row] for row in product]


def _hat(w: Sequence[Any]) -> Rows:
    x, y, z = w
    return [[0, -z, y], [z, 0, -x], [-y, x, 0]]


def _product(A: Rows, B: Rows) -> Rows:
    return [[sum(A[i][k] * B[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def twists(count: int, largest: float, dtype: Any, below: bool = False) -> np.ndarray:
    """Twists with translations of size 1e-8 to 1e6 and angles up to `largest`: a third even, a third logarithmic, a
    third at zero, at the smallest numbers, around the switch points of the series and around multiples of pi / 2.

    With `below`, angles stay away from `largest` by what rounding the pose may add to them.
    """
    rng = np.random.default_rng(_SEED)
    info = np.finfo(dtype)
    top = largest * (1.0 - 1e3 * float(info.eps)) if below else largest
    named = [0.0, float(info.tiny) ** 0.97, float(info.tiny) ** 0.5, 1e-20, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3]
    named += [centre * (1 + step) for centre in (1.0, 2.0, 4.0) for step in (-1e-6, 1e-6)]
    named += [0.5 * np.pi * k * (1 + step) for k in range(1, 13) for step in (-1e-3, -1e-6, 1e-6, 1e-3)]
    named = [angle for angle in named if angle <= top] + [top]
    parts = np.array_split(np.arange(count), 3)
    angles = np.concatenate(
        [
            rng.uniform(0.0, top, len(parts[0])),
            10.0 ** rng.uniform(-8.0, np.log10(top), len(parts[1])),
            np.resize(named, len(parts[2])),
        ]
    )
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


def _units(got: np.ndarray, exact: Sequence[Any], size: float, angle: float, mp: ModuleType) -> float:
    """The largest error in units of the last place at `size`, divided by the angle beyond 1 rad."""
    if not np.all(np.isfinite(got)):
        return float("inf")
    worst = max(abs(mp.mpf(float(value)) - entry) for value, entry in zip(got.ravel(), _entries(exact), strict=True))
    if worst == 0:
        return 0.0
    unit = max(float(np.spacing(got.dtype.type(size))), float(np.finfo(got.dtype).tiny))
    return float(worst / unit) / max(1.0, angle)


def _entries(rows: Sequence[Any]) -> list[Any]:
    return [entry for row in rows for entry in row] if isinstance(rows[0], list) else list(rows)


def _largest(rows: Sequence[Any]) -> float:
    return float(max(abs(entry) for entry in _entries(rows)))


def _blocks_of_exp(xi: np.ndarray, got: np.ndarray) -> dict[str, tuple[np.ndarray, Any, float]]:
    exact = Exact(xi)
    return {
        "rotation": (got[:3, :3], exact.rotation, _largest(exact.rotation)),
        "position": (got[:3, 3], exact.position, _largest(exact.v)),
    }


def _blocks_of_log(xi: np.ndarray, got: np.ndarray) -> dict[str, tuple[np.ndarray, Any, float]]:
    v, w = [float(entry) for entry in xi[:3]], [float(entry) for entry in xi[3:]]
    return {"rotation": (got[3:], w, _largest(w)), "position": (got[:3], v, _largest(v))}


def _blocks_of_jacobian(inverse: bool, sign: float) -> Callable[..., dict[str, tuple[np.ndarray, Any, float]]]:
    def blocks(xi: np.ndarray, got: np.ndarray) -> dict[str, tuple[np.ndarray, Any, float]]:
        exact = Exact(sign * xi)
        diagonal = exact.jacobian_inv if inverse else exact.jacobian
        coupling = exact.coupling_inv if inverse else exact.coupling
        return {
            "rotation": (got[:3, :3], diagonal, _largest(diagonal)),
            "translation": (got[:3, 3:], coupling, _largest(coupling)),
        }

    return blocks


def poses_of(xis: np.ndarray) -> np.ndarray:
    """The exact poses, rounded once."""
    poses = np.tile(np.eye(4, dtype=xis.dtype), (len(xis), 1, 1))
    for pose, xi in zip(poses, xis, strict=True):
        exact = Exact(xi)
        pose[:3, :3] = [[float(entry) for entry in row] for row in exact.rotation]
        pose[:3, 3] = [float(entry) for entry in exact.position]
    return poses


@dataclass(frozen=True)
class Map:
    """A map of twists, its exact value by blocks of the result with their names, and how far it is asked for."""

    name: str
    function: Callable[..., jax.Array]
    blocks: Callable[..., dict[str, tuple[np.ndarray, Any, float]]]
    largest: float
    angles: str
    names: tuple[str, str]
    of_poses: bool = False


_POSE, _MATRIX = ("rotation", "position"), ("rotation", "translation")

MAPS = (
    Map("exp", se3.exp, _blocks_of_exp, 20.0, "0 to 20", _POSE),
    Map("log", se3.log, _blocks_of_log, float(np.pi), "below pi", _POSE, of_poses=True),
    Map("left_jacobian", se3.left_jacobian, _blocks_of_jacobian(False, 1.0), 20.0, "0 to 20", _MATRIX),
    Map("left_jacobian_inv", se3.left_jacobian_inv, _blocks_of_jacobian(True, 1.0), 6.0, "0 to 6", _MATRIX),
    Map("right_jacobian_inv", se3.right_jacobian_inv, _blocks_of_jacobian(True, -1.0), 6.0, "0 to 6", _MATRIX),
)


def worst_units(each: Map, xis: np.ndarray) -> dict[str, tuple[float, float]]:
    """By block the largest error of a map over twists (n, 6), in units in the last place, and the angle where it is."""
    mp = mpmath()
    with mp.workdps(_DIGITS):
        results = np.asarray(jax.jit(jax.vmap(each.function))(poses_of(xis) if each.of_poses else xis))
        worst: dict[str, tuple[float, float]] = {}
        for xi, got in zip(xis, results, strict=True):
            angle = float(np.linalg.norm(xi[3:].astype(np.float64)))
            for block, (values, exact, size) in each.blocks(xi, got).items():
                found = (_units(values, exact, size, angle, mp), angle)
                worst[block] = max(worst.get(block, (0.0, 0.0)), found)
    return worst


@functools.cache
def _worst(each: Map, precision: str, cases: int) -> dict[str, tuple[float, float]]:
    dtype = np.dtype(precision).type
    return worst_units(each, twists(cases, each.largest, dtype, below=each.of_poses))


def _check(each: Map, precision: str, block: str) -> Check:
    """Of 600 twists; float64 needs JAX's x64 switch."""
    return Check(
        f"{each.name}, angles {each.angles} rad",
        f"{precision}, {block}",
        lambda: _worst(each, precision, 600)[block][0],
        at_most(BAR, "ulp"),
    )


SECTION = Section(
    "maps",
    "The maps in the last place",
    "The maps of SE(3) against values with fifty digits, worst of 600 cases, in units in the last place (ulp) times "
    "the angle beyond 1 rad; translations 1e-8 to 1e6.",
    {"": [_check(*each) for each in ((m, p, b) for m in MAPS for p in ("float64", "float32") for b in m.names)]},
    wide=True,
)
