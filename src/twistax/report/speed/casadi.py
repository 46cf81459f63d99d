"""CasADi: a function of SX symbols, C written from it, compiled with gcc and called in a C loop."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..timing import Timed, repeated
from .case import Case
from .contenders import Contender
from .programs import CALLS, GRADIENT, JACOBIAN, TINY, VALUE, Lacks, Quantity, Task

_FLAGS = ("-O3", "-march=native", "-fPIC", "-shared")
_LOOP = Path(__file__).with_name("loop.c")

#: Longer, s, and gcc is stopped.
_PATIENCE = 120.0

_VECTOR = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")


def _as_numpy(ca: Any) -> Any:
    """SX symbols under the names of NumPy, with structural zeros."""

    def asarray(value: Any) -> Any:
        return ca.SX(ca.sparsify(ca.DM(np.asarray(value, float))))

    def block(rows: Any) -> Any:
        return ca.vertcat(*(ca.horzcat(*row) for row in rows))

    def stack(parts: Any) -> Any:
        return ca.vertcat(*parts)

    made = {"asarray": asarray, "array": lambda rows: ca.sparsify(block(rows)), "block": block}
    joined = {"stack": stack, "concatenate": stack, "outer": lambda a, b: a @ b.T}
    return SimpleNamespace(sin=ca.sin, cos=ca.cos, dot=ca.dot, **made, **joined)


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
        result = ca.vertcat(*case.by_hand(_as_numpy(ca), *arguments))
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

        arguments, function = [ca.DM(points[0]) for points in self._case.points(1)], self._external
        return Timed(lambda: self._read(repeated(CALLS, function, *arguments)), CALLS, self._seconds)

    def _read(self, result: Any) -> Any:
        return np.asarray(result.full()).T.reshape(self._shape)

    def loop(self, steps: int) -> Timed:
        arguments = [points[0] for points in self._case.points(1)]
        return self._called(self._library.twistax_loop, arguments, (), steps, steps, TINY)

    def batch(self, count: int) -> Timed:
        return self._called(self._library.twistax_batch, self._case.points(count), (count,), count, count)

    def _called(
        self, call: Any, points: Sequence[Any], leading: tuple[int, ...], evaluations: int, *given: Any
    ) -> Timed:
        arguments, out = [np.ascontiguousarray(each) for each in points], np.zeros((*leading, *self._shape))

        def run() -> Any:
            call(*given, *arguments, out)
            return out

        return Timed(run, evaluations, self._seconds)


CASADI = Contender(
    "CasADi C",
    "C1",
    "the same plain matrices as SX symbols, C written by `Function.generate`, compiled with "
    f"`gcc {' '.join(_FLAGS[:2])}`; loop and batch are loops in C on one core, a single call goes through its "
    "Python interface (`casadi.external`). Derivatives are its own, `jacobian` and `gradient`.",
    _CasadiTask,
    packages=(("casadi", "casadi"),),
    tools=("gcc",),
)
