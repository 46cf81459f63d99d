"""Weighted least squares with linear constraints, in JAX programs, by the dense quadratic program of `qp.py`.

minimise    sum_i w_i (J_i x - r_i)^2 / 2 + damping |x|^2 / 2
subject to  A x = b,   row_lower <= C x <= row_upper,   lower <= x <= upper
"""

from __future__ import annotations

import ctypes
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from .library import library

#: The fields of `twx_squares`.
_NAMES = ("variables", "rows", "equalities", "inequalities")


class SquaresSolution(NamedTuple):
    """A solution, with the leading axes of a batch.

    Attributes:
        x: (n,), zero where the status is not SOLVED.
        start: of the next problem.
        status: (), a value of `QPStatus`, or 6: numbers that are not finite, or bounds that exclude each other.
        error: (), relative, of the optimality conditions.
        iterations: () of the interior point; 0 where the start sufficed.
    """

    x: jax.Array
    start: jax.Array
    status: jax.Array
    error: jax.Array
    iterations: jax.Array


class _Sizes(ctypes.Structure):
    """`twx_squares`."""

    _fields_ = [(name, ctypes.c_int32) for name in _NAMES]


class LeastSquares:
    """Problems of the same sizes.

    Attributes:
        sizes: variables, rows, equalities, inequalities.
        shapes: of the arrays of a problem, by their names in squares.h.
        start_size: entries of a start; zeros are none.
        problem_size: entries of a problem with its start.
    """

    def __init__(self, variables: int, rows: int, equalities: int, inequalities: int) -> None:
        self.sizes = n, m, e, c = (variables, rows, equalities, inequalities)
        self._sizes = _Sizes(*self.sizes)
        self.shapes = {"J": (m, n), "w": (m,), "r": (m,), "damping": (), "A": (e, n), "b": (e,), "C": (c, n)}
        self.shapes |= {"row_lower": (c,), "row_upper": (c,), "lower": (n,), "upper": (n,)}
        self.start_size = 3 * n + 2 * (e + c) + 1
        self.problem_size = sum(map(math.prod, self.shapes.values())) + self.start_size

    @property
    def workspace_size(self) -> int:
        """Doubles that the solver needs."""
        return int(library().squares_workspace(ctypes.addressof(self._sizes)))

    def __call__(self, *parts: Any) -> SquaresSolution:
        """J, w, r, damping, A, b, C, row_lower, row_upper, lower, upper and start -> the solution; no derivatives.

        It runs in double precision, and the results have the precision of J.
        """
        problem = jnp.concatenate([jnp.ravel(part) for part in parts])
        result = self._solved(problem).astype(problem.dtype)
        at = self.start_size
        status, iterations = (result[at + k].astype(jnp.int32) for k in (0, 2))
        return SquaresSolution(result[: self.sizes[0]], result[:at], status, result[at + 1], iterations)

    def _solved(self, problem: jax.Array) -> jax.Array:
        sizes = {name: np.int64(size) for name, size in zip(_NAMES, self.sizes, strict=True)}

        @jax.custom_batching.custom_vmap
        def solved(problems: Any) -> Any:
            *batch, size = problems.shape
            with jax.enable_x64(True):
                flat = jnp.reshape(problems, (math.prod(batch), size)).astype(np.dtype(float))
                shapes = [(len(flat), self.start_size + 3), (self.workspace_size,)]
                results = [jax.ShapeDtypeStruct(shape, np.dtype(float)) for shape in shapes]
                return jax.ffi.ffi_call(library().targets[2], results)(flat, **sizes)[0].reshape(*batch, -1)

        @solved.def_vmap
        def batched(size: int, mapped: list[bool], problems: Any) -> tuple[Any, bool]:
            return solved(problems), True

        constant = jax.custom_jvp(lambda values: solved(values))
        constant.defjvp(_no_derivatives)
        result: jax.Array = constant(problem)
        return result


def _no_derivatives(*_: Any) -> Any:
    raise InputError(
        "the solution of a quadratic program with limits has no derivatives in jax.grad.\n"
        "  fix: pass jax.lax.stop_gradient(...) of its arguments, such as the positions of a DifferentialController"
    )
