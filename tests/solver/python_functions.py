"""Functions of a problem in stages that are written in Python, as the core calls them."""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from twistax.errors import TrajectoryError
from twistax.solver import StageFunctions, Stages


class PythonFunctions:
    """Functions of all stages written in Python: for tests, and where no compiled ones can be had.

    Args:
        values: z -> cost, c, h, e.
        jacobians: z -> gradient by v, then lists of (rows, columns) matrices by stage: F of N, of h and e of N + 1.
        hessians: z, weight, lambda, y, ye -> list of (columns, columns) matrices of N + 1 stages.
        retract: z, d -> z moved by a step d of v; by addition where None.
        transport: d, lambda -> multipliers about moved nodes.
        stop: iteration -> whether to stop.
    An exception ends the solve, which raises it again.
    """

    def __init__(
        self,
        stages: Stages,
        values: Callable[..., Any],
        jacobians: Callable[..., Any],
        hessians: Callable[..., Any],
        retract: Callable[..., Any] | None = None,
        transport: Callable[..., Any] | None = None,
        stop: Callable[[int], bool] | None = None,
    ) -> None:
        self.error: BaseException | None = None
        n, m = stages.points, stages.variables
        c, h, e = sum(stages.after), sum(stages.inequalities), sum(stages.equalities)
        blocks = [stages.block_sizes(rows) for rows in (stages.after, stages.inequalities, stages.equalities)]

        def values_of(_: Any, z: Any, *out: Any) -> None:
            _write(values(_read(z, n)), out, (1, c, h, e))

        def jacobians_of(_: Any, z: Any, *out: Any) -> None:
            _write(jacobians(_read(z, n)), out, (m, *blocks))

        def hessians_of(_: Any, z: Any, weight: float, lam: Any, y: Any, ye: Any, out: Any) -> None:
            found = hessians(_read(z, n), weight, _read(lam, c), _read(y, h), _read(ye, e))
            _write([found], [out], [stages.block_sizes(stages.columns)])

        pointers = {"values": 5, "jacobians": 5, "retract": 3, "transport": 2}
        kinds: dict[str, list[Any]] = {name: [_POINTER] * count for name, count in pointers.items()}
        kinds["hessians"] = [_POINTER, ctypes.c_double, *[_POINTER] * 4]
        written: dict[str, Callable[..., None]] = {
            "values": values_of,
            "jacobians": jacobians_of,
            "hessians": hessians_of,
        }
        if retract is not None:
            written["retract"] = lambda _, z, d, out: _write([retract(_read(z, n), _read(d, m))], [out], [n])
        if transport is not None:
            written["transport"] = lambda _, d, lam: _write([transport(_read(d, m), _read(lam, c))], [lam], [c])
        self._callbacks: dict[str, Any] = {
            name: ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, *kinds[name])(self._guarded(f))
            for name, f in written.items()
        }
        ask = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int32, ctypes.c_void_p)
        self._callbacks["stop"] = ask(self._guarded(lambda _, iteration, z: stop is not None and bool(stop(iteration))))
        addresses = {name: ctypes.cast(f, ctypes.c_void_p).value or 0 for name, f in self._callbacks.items()}
        self.functions = StageFunctions(**addresses, owner=self)

    def _guarded(self, function: Callable[..., bool | None]) -> Callable[..., int]:
        """1 where it says so, or raised, or another one has: no exception passes through C."""

        def call(*arguments: Any) -> int:
            if self.error is not None:
                return 1
            try:
                return int(bool(function(*arguments)))
            except BaseException as error:
                self.error = error
                return 1

        return call

    def check(self) -> None:
        """Raise what a function raised."""
        error, self.error = self.error, None
        if error is not None:
            raise error


_POINTER = ctypes.POINTER(ctypes.c_double)


def _read(pointer: Any, count: int) -> Array:
    return np.ctypeslib.as_array(pointer, (count,)).copy() if count else np.zeros(0)


def _write(found: Sequence[Any], out: Sequence[Any], counts: Sequence[int]) -> None:
    """Arrays by rows, lists of matrices by stages and columns, into memory."""
    for value, pointer, count in zip(found, out, counts, strict=True):
        if isinstance(value, list):
            flat = np.concatenate([np.zeros(0), *(np.ravel(np.asarray(a, float), order="F") for a in value)])
        else:
            flat = np.ravel(np.asarray(value, float))
        if len(flat) != count:
            raise TrajectoryError(f"solve: a function returned {len(flat)} numbers where {count} are expected")
        if count:
            np.ctypeslib.as_array(pointer, (count,))[:] = flat
