"""The solver for dense quadratic programs from Python: its arguments, and the result of a solve.

    minimise    1/2 x'H x + g'x
    subject to  A x = b,   row_lower <= C x <= row_upper,   lower <= x <= upper

The C sources describe the method, beginning with `qp.h`.
"""

from __future__ import annotations

import ctypes
import dataclasses
import enum
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..checks import reals
from ..errors import InputError
from .library import library
from .options import QPOptions


class QPStatus(enum.Enum):
    """The status of a solve; the values are those of `twx_qp_status` in qp.h."""

    SOLVED = 0
    MAX_ITERATIONS = 1
    INFEASIBLE = 2
    UNBOUNDED = 3
    STALLED = 4
    NOT_CONVEX = 5


#: That of a problem whose data cannot be.
_BAD_PROBLEM = 6


@dataclasses.dataclass(frozen=True)
class QPSolution:
    """A result, and the data for a warm start.

    Multipliers satisfy `H x + g + A'y + C'z + w = 0`: positive at upper bounds, negative at lower bounds, else 0.
    Where a status is not SOLVED, these arrays are

    - INFEASIBLE: `x` within its bounds that violates the rows least, by the sum of squares in equilibrated units. The
      multipliers prove it: `A'y + C'z + w = 0`, and their sum over bounds, `b'y + ...`, is negative.
    - UNBOUNDED: a direction `x` without curvature that leaves no constraint and along which the cost falls.
    - others: the iterate with the smallest error.

    Attributes:
        status: how the solve ended.
        x: (n,) the variables.
        y: (equalities,) multipliers of `A x = b`.
        z: (inequalities,) multipliers of the rows of C.
        w: (n,) multipliers of the bounds of x.
        scales: (n + equalities + inequalities,) by which the problem was equilibrated; a warm start begins with them.
        cost: of x.
        error: the largest of the three below. SOLVED says that it is at most the tolerance. All are relative to the
            quantities that they are sums of, in equilibrated units, so that units do not matter.
        stationarity: of `H x + g + A'y + C'z + w`.
        violation: of constraints.
        complementarity: the smaller of multiplier and distance from its bound.
        certificate: of INFEASIBLE and UNBOUNDED: the residual of the proof. For INFEASIBLE it is the size of x over the
            radius within which there is no feasible point; 0 says that there is none. Infinite for other statuses.
        iterations: steps of the interior point; 0 where a warm start sufficed.
        changes: of the set of active bounds.
        factorizations: of matrices (n, n).
    """

    status: QPStatus
    x: Array
    y: Array
    z: Array
    w: Array
    scales: Array
    cost: float
    error: float
    stationarity: float
    violation: float
    complementarity: float
    certificate: float
    iterations: int
    changes: int
    factorizations: int


class _Problem(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int32) for name in ("variables", "equalities", "inequalities")),
        *((name, ctypes.c_void_p) for name in ("H", "g", "A", "b", "C", "row_lower", "row_upper", "lower", "upper")),
    ]


class _Arrays(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("x", "y", "z", "w", "scales")]


_MEASURES = ("cost", "error", "stationarity", "violation", "complementarity", "certificate")
_COUNTS = ("status", "iterations", "changes", "factorizations")


class _Statistics(ctypes.Structure):
    _fields_ = [*((name, ctypes.c_double) for name in _MEASURES), *((name, ctypes.c_int32) for name in _COUNTS)]


_DEFAULTS = QPOptions()


def solve_qp(
    H: Any,
    g: Any,
    A: Any = None,
    b: Any = None,
    C: Any = None,
    row_lower: Any = None,
    row_upper: Any = None,
    *,
    lower: Any = None,
    upper: Any = None,
    warm: QPSolution | None = None,
    options: QPOptions | None = None,
) -> QPSolution:
    """Solve a dense convex quadratic program.

        minimise    1/2 x'H x + g'x
        subject to  A x = b,   row_lower <= C x <= row_upper,   lower <= x <= upper

    Args:
        H: (n, n) symmetric, positive semidefinite; 0 for a linear program.
        g: (n,).
        A, b: (equalities, n), (equalities,). Rows may depend on each other.
        C: (inequalities, n).
        row_lower, row_upper: (inequalities,), where None and infinite entries are no bound; they may be equal.
        lower, upper: (n,), likewise.
        warm: the result of a similar problem of the same shapes. Its active bounds are tried first.
        options: `QP_SOURCES` names where each comes from.
    Returns:
        The solution, or a proof that there is none: see `QPSolution`. No status raises.
    Raises:
        InputError: shapes that do not fit, numbers that are not finite, H that is not symmetric, a lower bound above
            its upper bound.
    Example:
        >>> solution = solve_qp(np.eye(2), [-1.0, -2.0], lower=[0.0, 0.0], upper=[1.0, 1.0])
        >>> solution.x
        array([1., 1.])
    """
    g = _numbers("g", g)
    n = len(g) if g.ndim == 1 else 0
    if n == 0:
        raise InputError(f"solve_qp: g expects shape (n,) with n of 1 or more, got {g.shape}")
    equalities, inequalities = (0 if M is None else len(np.atleast_2d(np.asarray(M))) for M in (A, C))
    data = {
        "H": _shaped("H", H, (n, n)),
        "g": g,
        "A": _matrix("A", A, equalities, n),
        "b": _vector("b", b, equalities, None if equalities else 0.0),
        "C": _matrix("C", C, inequalities, n),
        "row_lower": _vector("row_lower", row_lower, inequalities, -np.inf),
        "row_upper": _vector("row_upper", row_upper, inequalities, np.inf),
        "lower": _vector("lower", lower, n, -np.inf),
        "upper": _vector("upper", upper, n, np.inf),
    }
    problem = _Problem(n, equalities, inequalities, *(a.ctypes.data for a in data.values()))
    first = _first(n, equalities, inequalities, warm)
    arrays = _Arrays(*(a.ctypes.data for a in first.values()))
    chosen = (options or _DEFAULTS).as_structure()
    chosen.warm_start = float(warm is not None)
    core, reference = library(), ctypes.byref(problem)
    workspace, statistics = np.empty(core.qp_workspace_size(reference)), _Statistics()
    by_reference = (reference, ctypes.byref(chosen), ctypes.byref(arrays))
    status = core.qp_solve(*by_reference, workspace.ctypes.data, ctypes.byref(statistics))
    if status == _BAD_PROBLEM:
        _refuse(data)
    fields: dict[str, Any] = {name: getattr(statistics, name) for name in (*_MEASURES, *_COUNTS[1:])}
    return QPSolution(status=QPStatus(status), **(fields | first))


def _first(n: int, equalities: int, inequalities: int, warm: QPSolution | None) -> dict[str, Array]:
    sizes = {"x": n, "y": equalities, "z": inequalities, "w": n, "scales": n + equalities + inequalities}
    if warm is None:
        return {name: np.zeros(size) for name, size in sizes.items()}
    for name, size in sizes.items():
        _shaped(f"warm.{name}", getattr(warm, name), (size,))
    return {name: np.array(getattr(warm, name), float) for name in sizes}


def _numbers(name: str, value: Any) -> Array:
    ready = type(value) is np.ndarray and value.dtype == np.float64
    return np.asfortranarray(value if ready else reals(f"solve_qp: {name}", value, InputError), np.float64)


def _shaped(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    array = _numbers(name, value)
    if array.shape != shape:
        raise InputError(f"solve_qp: {name} expects shape {shape}, got {array.shape}")
    return array


def _matrix(name: str, value: Any, rows: int, n: int) -> Array:
    return np.zeros((0, n)) if value is None else _shaped(name, value, (rows, n))


def _vector(name: str, value: Any, size: int, default: float | None) -> Array:
    if value is not None:
        return _shaped(name, value, (size,))
    if default is None:
        raise InputError(f"solve_qp: {name} expects shape ({size},), one number for each row of the matrix, got None")
    return np.full(size, default)


def _refuse(data: dict[str, Array]) -> None:
    for name, array in data.items():
        bound = name in ("lower", "upper", "row_lower", "row_upper")
        wrong = np.argwhere(np.isnan(array) if bound else ~np.isfinite(array))
        if len(wrong):
            at = ", ".join(map(str, wrong[0]))
            kind = "numbers or infinities" if bound else "finite numbers"
            raise InputError(f"solve_qp: {name} expects {kind}, got {array[tuple(wrong[0])]} at [{at}]")
    for below, above in (("lower", "upper"), ("row_lower", "row_upper")):
        low, high = data[below], data[above]
        crossed = np.flatnonzero((low > high) | (low == np.inf) | (high == -np.inf))
        if len(crossed):
            i = crossed[0]
            raise InputError(f"solve_qp: expects {below} <= {above}, got {low[i]} and {high[i]} at [{i}]")
    H = data["H"]
    i, j = np.unravel_index(np.argmax(np.abs(H - H.T)), H.shape)
    raise InputError(
        f"solve_qp: H expects a symmetric matrix, got {H[i, j]} at [{i}, {j}] and {H[j, i]} at [{j}, {i}]\n"
        "  fix: (H + H.T) / 2 has the same cost"
    )
