"""Systems to write out, and C code compiled and called from here."""

import ctypes
import functools
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, RegularGridInterpolator, make_interp_spline

import twistax as tx

#: What the code must be clean under, and more than is promised.
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")
STRICTER = ("-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Wstrict-prototypes", "-Wmissing-prototypes")

COMPILERS = [c for c in ("gcc", "clang") if shutil.which(c)]
needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler: neither gcc nor clang is installed")

MASS = np.array(
    [
        [2.0, 0.0, 0.0, 0.0, 0.1, -0.2],
        [0.0, 2.0, 0.0, -0.1, 0.0, 0.3],
        [0.0, 0.0, 2.0, 0.2, -0.3, 0.0],
        [0.0, -0.1, 0.2, 0.5, 0.01, 0.0],
        [0.1, 0.0, -0.3, 0.01, 0.4, 0.02],
        [-0.2, 0.3, 0.0, 0.0, 0.02, 0.6],
    ]
)


@functools.cache
def body() -> tx.Dynamics:
    """A body with a solve, a table, outputs and constraints; names whose order is not that of the alphabet."""
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    F, b = tx.Control("wrench", shape=(6,)), tx.Control("b.rake", shape=())
    M, k = tx.Parameter("M", value=MASS), tx.Parameter("gain", value=1.5)
    drag = tx.Linterp(V[0], np.array([-1.0, 0.0, 2.0]), np.array([1.0, 0.1, 0.7])) * b
    rate = tx.linalg.Solve(M, k * F - tx.lie.AdjointDual(V, M @ V) - drag * V)
    return tx.compile(
        tx.System(
            rates={g: V, V: rate},
            outputs={"turn": g[:3, :3] @ tx.spatial.SSM(V[3:]), "speed": tx.linalg.Norm(V[:3])},
            constraints={"most": F <= 3.0, "level": g[2, 3] == 1.0},
        )
    )


def tables() -> dict[str, tuple[tx.Expr, Any]]:
    """Tables of vectors and inside of maps: of `x` (3,) and `M` (3, 2), each with its value by plain interpolation."""
    x, M = tx.State("x", shape=(3,)), tx.State("M", shape=(3, 2))
    knots, lines, plane = np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]), np.arange(6.0).reshape(3, 2) ** 1.5
    several = np.sqrt(np.arange(18.0)).reshape(3, 3, 2)
    fp = tx.Parameter("fp", value=plane)
    even, uneven, beyond = np.linspace(-1.0, 5.0, 6), np.array([-0.5, 0.2, 1.0, 3.0, 4.5]), tx.tables.Extrapolated()
    hill = np.sin(even)[:, None] * np.cos(uneven)

    def bilinear(a: Any, b: Any, fp: np.ndarray = plane) -> np.ndarray:
        inside = np.stack(np.broadcast_arrays(np.clip(a, 0.0, 3.0), np.clip(b, 0.0, 2.0)), axis=-1)
        return RegularGridInterpolator((knots, lines), fp)(inside)

    def column(x: Any, k: int) -> np.ndarray:
        return np.interp(x, knots, plane[:, k])

    return {
        "vector": (tx.Bilerp(x, x[::-1], knots, lines, plane), lambda x, M: bilinear(x, x[::-1])),
        "parameter": (tx.Bilerp(M, 0.3, knots, lines, fp), lambda x, M: bilinear(M, 0.3)),
        "map": (tx.Vmap(lambda r: tx.Bilerp(r[0], r[1], knots, lines, plane), M), lambda x, M: bilinear(*M.T)),
        "vectors in a map": (
            tx.Vmap(lambda e: tx.Bilerp(e, x, knots, lines, fp), x),
            lambda x, M: np.stack([bilinear(e, x) for e in x]),
        ),
        "a table each": (
            tx.Vmap(lambda e, fp: tx.Bilerp(e, 0.7, knots, lines, fp), [x, several]),
            lambda x, M: np.stack([bilinear(e, 0.7, fp) for e, fp in zip(x, several, strict=True)]),
        ),
        "lines": (
            tx.Vmap(lambda e: tx.Linterp(e, knots, plane), x),
            lambda x, M: np.stack([column(x, 0), column(x, 1)], axis=-1),
        ),
        "grid": (
            tx.Interp(x, 0.7 * x[::-1], axes=[knots, lines], values=plane),
            lambda x, M: bilinear(x, 0.7 * x[::-1]),
        ),
        "spline of two axes": (
            tx.Interp(x, x[::-1], axes=[even, uneven], values=hill, kind=tx.tables.BSpline(), outside=beyond),
            lambda x, M: np.array([_tensor((even, uneven), hill, at) for at in zip(x, x[::-1], strict=True)]),
        ),
        "cubic": (
            tx.Vmap(lambda e: tx.Cinterp(e, knots, knots**2), x),
            lambda x, M: CubicSpline(knots, knots**2)(x),
        ),
    }


def _tensor(axes: Any, values: np.ndarray, point: Any) -> np.ndarray:
    for points, coordinate in zip(axes, point, strict=True):
        values = make_interp_spline(points, values)(coordinate)
    return values


#: Between, on and beyond lines of the grids.
TABLE_POINTS = [
    (np.array([0.3, 1.0, 2.5]), np.array([[0.5, 1.5], [-1.0, 3.0], [3.0, 0.0]])),
    (np.array([-0.5, 3.0, 4.5]), np.array([[1.0, 2.0], [2.9, 0.1], [0.0, 1.9]])),
]


def point(seed: int = 0) -> tuple[Any, ...]:
    """(t, x, u, params) of the body."""
    rng = np.random.default_rng(seed)
    g = np.asarray(tx.lie.se3.exp(0.7 * rng.normal(size=6)))
    x = {"g": g, "V": rng.normal(size=6)}
    return 0.3, x, {"wrench": rng.normal(size=6), "b.rake": rng.uniform()}, {"M": MASS + 0.1 * np.eye(6), "gain": 0.8}


def flat(given: tuple[Any, ...]) -> list[Any]:
    """The arguments in the order of the call convention."""
    t, *dicts = given
    return [t, *(np.asarray(v) for values in dicts for v in values.values())]


class Library:
    """C code as a shared library."""

    def __init__(self, source: Path, dtype: Any = np.float64, compiler: str = "gcc", level: str = "-O1") -> None:
        target = source.with_suffix(f".{compiler}.so")
        command = [compiler, *STRICT, *STRICTER, level, "-shared", "-fPIC", str(source), "-lm", "-o", str(target)]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        self.library, self.dtype = ctypes.CDLL(str(target)), np.dtype(dtype)

    def call(self, function: str, arguments: Sequence[Any], shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        """The results of a function, the first argument a number, all others arrays."""
        time, *arrays = arguments
        given = [np.ascontiguousarray(a, self.dtype) for a in arrays]
        results = [np.full(shape, 777.0, self.dtype) for shape in shapes]
        real = ctypes.c_float if self.dtype == np.float32 else ctypes.c_double
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (*given, *results)]
        getattr(self.library, function)(real(time), *pointers)
        return results


def run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(list(command), capture_output=True, text=True)
