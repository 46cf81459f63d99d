"""CasADi: a function of SX symbols, C written from it, compiled with gcc and called in a C loop."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..timing import Timed
from .by_hand import Matrices
from .case import Case
from .contender import Contender
from .programs import CALLS, GRADIENT, JACOBIAN, TINY, VALUE, Lacks, Quantity, Task

__all__ = ["Casadi"]

_FLAGS = ("-O3", "-march=native", "-fPIC", "-shared")
_LOOP = Path(__file__).with_name("loop.c")

#: Longer, s, and gcc is stopped.
_PATIENCE = 120.0

_VECTOR = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")


class Casadi(Contender):
    name, colour = "CasADi C", "C1"
    how = (
        "the same plain matrices as SX symbols, C written by `Function.generate`, compiled with "
        f"`gcc {' '.join(_FLAGS[:2])}`; loop and batch are loops in C on one core, a single call goes through its "
        "Python interface (`casadi.external`). Derivatives are its own, `jacobian` and `gradient`."
    )
    packages = (("casadi", "casadi"),)

    def absent(self) -> str | None:
        return super().absent() or (None if shutil.which("gcc") else "there is no gcc to compile its C")

    def task(self, case: Case, quantity: Quantity) -> Task:
        return _CasadiTask(case, quantity)


class _Sx(Matrices):
    """Symbols with structural zeros."""

    def constant(self, value: Any) -> Any:
        return self.xp.SX(self.xp.sparsify(self.xp.DM(np.asarray(value, float))))

    def matrix(self, rows: Sequence[Sequence[Any]]) -> Any:
        return self.xp.sparsify(self.block(rows))

    def block(self, rows: Sequence[Sequence[Any]]) -> Any:
        return self.xp.vertcat(*(self.xp.horzcat(*row) for row in rows))

    def vector(self, entries: Sequence[Any]) -> Any:
        return self.xp.vertcat(*entries)

    def joined(self, parts: Sequence[Any]) -> Any:
        return self.xp.vertcat(*parts)

    def dot(self, a: Any, b: Any) -> Any:
        return self.xp.dot(a, b)

    def outer(self, a: Any, b: Any) -> Any:
        return a @ b.T


def _derived(ca: Any, quantity: Quantity) -> Callable[[Any, Any], Any]:
    """Of a column and what it depends on; its entries in memory are those of our result."""
    # CasADi keeps columns together, we rows.
    return {
        VALUE: lambda f, x: f,
        JACOBIAN: lambda f, x: ca.jacobian(f, x).T,
        GRADIENT: lambda f, x: ca.gradient(ca.sum1(f), x),
    }[quantity]


def _compiled(ca: Any, function: Any, folder: Path, case: Case, results: int) -> Path:
    """The shared library of a function and of `loop.c`. Raises Lacks where gcc takes too long."""
    generator = ca.CodeGenerator("evaluated.c")
    generator.add(function)
    generator.generate(f"{folder}/")
    sizes = dict(zip(("SIZE_A", "SIZE_B", "SIZE_C"), case.sizes, strict=True))
    sizes |= {"SZ_ARG": function.sz_arg(), "SZ_RES": function.sz_res(), "SZ_IW": function.sz_iw()}
    sizes |= {"SZ_W": function.sz_w(), "SIZE_OUT": results}
    defined = [f"-D{name}={value}" for name, value in sizes.items()]
    defined += ["-DNAME=evaluated", f'-DSOURCE="{folder / "evaluated.c"}"']
    target = folder / "evaluated.so"
    words = ["gcc", *_FLAGS, *defined, "-o", str(target), str(_LOOP), "-lm"]
    try:
        subprocess.run(words, check=True, capture_output=True, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        raise Lacks(f"gcc was stopped after {_PATIENCE:g} s on {function.n_instructions():,} operations") from None
    return target


class _CasadiTask(Task):
    """Written and compiled once for all uses."""

    def __init__(self, case: Case, quantity: Quantity) -> None:
        import casadi as ca

        self._case, self._shape = case, quantity.shape(case)
        arguments = [ca.SX.sym(name, size) for name, size in zip("abc", case.sizes, strict=True)]
        matrices = _Sx(ca)
        result = matrices.joined(case.by_hand(matrices, *arguments))
        begin = time.perf_counter()
        result = _derived(ca, quantity)(result, ca.vertcat(*arguments[:2]))
        function = ca.Function("evaluated", arguments, [ca.densify(result)])
        # What is loaded stays when its file is gone.
        with tempfile.TemporaryDirectory() as folder:
            target = _compiled(ca, function, Path(folder), case, int(np.prod(self._shape)))
            self._library = ctypes.CDLL(str(target))
            self._external = ca.external("evaluated", str(target))
        self._seconds = time.perf_counter() - begin
        self._library.twistax_batch.argtypes = [ctypes.c_long, *[_VECTOR] * 4]
        self._library.twistax_loop.argtypes = [ctypes.c_long, ctypes.c_double, *[_VECTOR] * 4]
        self._library.twistax_batch.restype = self._library.twistax_loop.restype = None

    def single(self) -> Timed:
        import casadi as ca

        arguments = [ca.DM(points[0]) for points in self._case.points(1)]
        function, shape = self._external, self._shape

        def calls() -> Any:
            for _ in range(CALLS):
                result = function(*arguments)
            return np.asarray(result.full()).T.reshape(shape)

        return Timed(calls, CALLS, self._seconds)

    def loop(self, steps: int) -> Timed:
        arguments = [np.ascontiguousarray(points[0]) for points in self._case.points(1)]
        out = np.zeros(self._shape)

        def call() -> Any:
            self._library.twistax_loop(steps, TINY, *arguments, out)
            return out

        return Timed(call, steps, self._seconds)

    def batch(self, count: int) -> Timed:
        arguments = [np.ascontiguousarray(points) for points in self._case.points(count)]
        out = np.zeros((count, *self._shape))

        def call() -> Any:
            self._library.twistax_batch(count, *arguments, out)
            return out

        return Timed(call, count, self._seconds)
