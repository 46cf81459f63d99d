"""The interior-point core from Python: a multi-stage problem, its functions, and the result of a solve.

    minimise    sum_k l_k(x_k, u_k, p)
    subject to  x_(k+1) = f_k(x_k, u_k, p),   h_k(x_k, u_k, p) <= 0,   e_k(x_k, u_k, p) = 0,   lower <= v <= upper

with v = (x_0, u_0, ..., x_N, u_N, p). States may lie on a manifold: then a node has a point, `retract` moves it along a
tangent step, and defects are logarithms about the node at the end of an interval.
Source: A. Waechter, L. T. Biegler, On the implementation of an interior-point filter line-search algorithm for
large-scale nonlinear programming, Mathematical Programming 106 (2006).
"""

from __future__ import annotations

import ctypes
import dataclasses
import enum
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ..errors import TrajectoryError
from .library import library
from .options import Options
from .stages import Stages


class CoreStatus(enum.Enum):
    """The status of a solve; the values are those of `twx_status` in core.h."""

    SOLVED = 0
    MAX_ITERATIONS = 1
    INFEASIBLE = 2
    STALLED = 3
    NON_FINITE = 4
    UNBOUNDED_CURVATURE = 5
    STOPPED = 6
    UNBOUNDED = 8
    ACCEPTABLE = 9


#: Bytes of a number in Python's core.
_DOUBLE = 8

#: That of a problem whose bounds or units cannot be.
_BAD_PROBLEM = 7


@dataclasses.dataclass(frozen=True)
class StageFunctions:
    """Addresses of the functions of all stages, in the layout of `twx_problem` in core.h.

    Attributes:
        values, jacobians, hessians, retract, transport, stop: addresses; 0 where there is no such function.
        user: what they get as first argument.
        flat: where points have the entries of v themselves, -1 for those of manifolds; none if left out.
        owner: what must live as long as the functions; its `check`, if it has one, is called after a solve.
    """

    values: int
    jacobians: int
    hessians: int
    retract: int = 0
    transport: int = 0
    stop: int = 0
    user: int = 0
    flat: Array | None = None
    owner: Any = None

    def check(self) -> None:
        """Raise the error of a function in the last call."""
        check = getattr(self.owner, "check", None)
        if check is not None:
            check()

    @property
    def addresses(self) -> dict[str, int]:
        """The addresses by the names in `twx_problem`."""
        names = ("user", "values", "jacobians", "hessians", "retract", "transport", "stop")
        return {name: getattr(self, name) for name in names}


class Units(NamedTuple):
    """Units of v, of the rows h and e, and of the cost, in which the core computes; None means 1."""

    size: Array | None = None
    row_size: Array | None = None
    equality_size: Array | None = None
    cost: float = 1.0


@dataclasses.dataclass
class CoreSolution:
    """A result, in the problem's units, and the data for a warm start.

    Attributes:
        status: how the solve ended.
        z: points, controls and parameters.
        v: the same in coordinates of the bounds.
        s, y: slacks and multipliers of h.
        lam: multipliers of the dynamics.
        ye: multipliers of e.
        zl, zu: multipliers of lower and upper bounds.
        statistics: counts and measures, by name; SOLVED means that `error`, scaled, is at most the tolerance, and
            `excess` over `worth` at most the option `excess`.
        log: (iterations, 10) cost, violation, stationarity, barrier, multiple of the identity, lengths of both steps,
            size of the step, trials, and a character's code that tells the kind of step.
    """

    status: CoreStatus
    z: Array
    v: Array
    s: Array
    lam: Array
    y: Array
    ye: Array
    zl: Array
    zu: Array
    statistics: dict[str, float]
    log: Array


class ProblemStructure(ctypes.Structure):
    """`twx_problem`."""

    _fields_ = [
        ("intervals", ctypes.c_int32),
        ("parameters", ctypes.c_int32),
        *(
            (name, ctypes.c_void_p)
            for name in (
                *("states", "controls", "inequalities", "equalities", "point_states"),
                *("flat", "lower", "upper", "size", "row_size", "equality_size"),
            )
        ),
        ("cost_size", ctypes.c_double),
        *(
            (name, ctypes.c_void_p)
            for name in ("largest_step", "user", "values", "jacobians", "hessians", "retract", "transport", "stop")
        ),
        ("derivatives", ctypes.c_void_p),
        ("scratch", ctypes.c_size_t),
        *((name, ctypes.c_int32) for name in ("filter_rows", "without_watchdog", "discards")),
    ]


#: Numbers of `twx_statistics`, in its order.
MEASURES = (
    *("cost", "error", "stationarity", "violation", "complementarity", "barrier", "cost_scale", "minimum"),
    *("excess", "worth"),
)
COUNTS = (
    *("status", "iterations", "evaluations", "factorizations", "corrections", "restorations"),
    *("restoration_iterations", "filter_resets", "inertia_corrections"),
)


class StatisticsStructure(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double) for name in MEASURES),
        *((name, ctypes.c_int32) for name in COUNTS),
        ("log", ctypes.c_void_p),
        ("log_rows", ctypes.c_int32),
    ]


#: Arrays of `twx_solution`, in its order.
MULTIPLIERS = ("v", "s", "lam", "y", "ye", "zl", "zu")


class SolutionStructure(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in MULTIPLIERS]


class Described(NamedTuple):
    """A problem in the form of the core, with the arrays that own its memory."""

    structure: ProblemStructure
    memory: list[Array]


def as_problem(
    stages: Stages,
    functions: StageFunctions,
    lower: Array,
    upper: Array,
    units: Units,
    largest_step: Array | None = None,
) -> Described:
    """A problem for the core; arguments are those of `solve`.

    Raises:
        TrajectoryError: arrays of other shapes.
    """
    by_name = {"lower": lower, "upper": upper, "largest_step": largest_step}
    by_name |= {"size": units.size, "row_size": units.row_size, "equality_size": units.equality_size}
    variables, rows, equalities = stages.variables, sum(stages.inequalities), sum(stages.equalities)
    lengths = dict.fromkeys(("lower", "upper", "largest_step", "size"), variables)
    lengths |= {"row_size": rows, "equality_size": equalities}
    arrays = {name: _checked(name, a, lengths[name]) for name, a in by_name.items() if a is not None}
    arrays |= {
        name: np.asarray(getattr(stages, name), np.int32)
        for name in ("states", "controls", "inequalities", "equalities", "point_states")
        if getattr(stages, name) is not None
    }
    if functions.flat is not None:
        arrays["flat"] = np.ascontiguousarray(functions.flat, np.int32)
    structure = ProblemStructure(len(stages.states) - 1, stages.parameters, cost_size=units.cost)
    for name, address in ({name: a.ctypes.data for name, a in arrays.items()} | functions.addresses).items():
        setattr(structure, name, address or None)
    return Described(structure, list(arrays.values()))


#: Called before each iteration with its number, the cost, the largest violation and the point; what is true stops the
#: solve.
StopCheck = Callable[[int, float, float, Array], Any]


def solve(
    stages: Stages,
    functions: StageFunctions,
    lower: Array,
    upper: Array,
    z: Array,
    v: Array | None = None,
    *,
    units: Units | None = None,
    largest_step: Array | None = None,
    options: Options | None = None,
    warm: CoreSolution | None = None,
    should_stop: StopCheck | None = None,
) -> CoreSolution:
    """Solve from a point.

    Args:
        lower, upper: bounds of v; equal where an entry of x_0, u or p is fixed.
        z: the start.
        v: its coordinates, in which bounds count; z itself where no state lies on a manifold.
        units: by which steps and errors are measured; 1 where None.
        largest_step: of v, how far a step may move an entry, negative: a share of what it is then; any distance where
            None.
        warm: a result whose slacks and multipliers are the first ones, within the ranges that options say: a small
            `barrier_start` and small pushes keep it near.
        should_stop: called before each iteration; violations are in the core's units.
    Raises:
        TrajectoryError: arrays of other shapes, bounds that cannot be, a state after the first that bounds fix.
        Exception: what `should_stop` raised.
    """
    arrays = _start(stages, z, z if v is None else v, warm)
    described = as_problem(stages, functions, lower, upper, units or Units(), largest_step)
    statistics, problem = StatisticsStructure(), described.structure
    stop = _StopFunction(should_stop, statistics, stages.points)
    for name, address in stop.addresses.items():
        setattr(problem, name, address)
    chosen = dataclasses.replace(options or Options(), warm_start=float(warm is not None)).as_structure()
    core = library()
    workspace = np.empty(core.workspace_size(ctypes.byref(problem), _DOUBLE))
    log = np.zeros((int(chosen.iterations) + 1, 10))
    statistics.log, statistics.log_rows = log.ctypes.data, len(log)
    multipliers = SolutionStructure(*(arrays[name].ctypes.data for name in MULTIPLIERS))
    references = [ctypes.byref(part) for part in (problem, chosen, multipliers, statistics)]
    pointers = (arrays["z"].ctypes.data, references[2], workspace.ctypes.data, references[3])
    status = core.solve(*references[:2], *pointers)
    stop.check()
    functions.check()
    if status == _BAD_PROBLEM:
        raise TrajectoryError(
            "solve: bounds expect lower <= upper, and units positive numbers; "
            "bounds may be equal only for x_0, controls and parameters\n  fix: fix a later state by an equality"
        )
    numbers = {name: getattr(statistics, name) for name in (*MEASURES, *COUNTS[1:])}
    return CoreSolution(status=CoreStatus(status), **arrays, statistics=numbers, log=log[: statistics.iterations])


class _StopFunction:
    """The callback by which the core asks whether to stop. It also lets Python handle signals.

    Attributes:
        addresses: by the name that `twx_problem` has for it.
    """

    def __init__(self, should_stop: StopCheck | None, statistics: StatisticsStructure, points: int) -> None:
        self._error: BaseException | None = None
        self.addresses: dict[str, int] = {}
        if should_stop is None:
            return

        views = dict[int, Array]()  # the core has two places for points

        def stop(_: Any, iteration: int, z: int) -> int:
            try:
                if z not in views:
                    views[z] = np.ctypeslib.as_array(ctypes.cast(z, ctypes.POINTER(ctypes.c_double)), (points,))
                return int(bool(should_stop(iteration, statistics.cost, statistics.violation, views[z])))
            except BaseException as error:
                self._error = error
                return 1

        self._function = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int32, ctypes.c_void_p)(stop)
        self.addresses = {"stop": ctypes.cast(self._function, ctypes.c_void_p).value or 0}

    def check(self) -> None:
        """Raise the error of the callback."""
        if self._error is not None:
            raise self._error


def _checked(name: str, a: Any, count: int) -> Array:
    array = np.ascontiguousarray(a, float)
    if array.shape != (count,):
        raise TrajectoryError(f"solve: {name} expects shape ({count},), got {array.shape}")
    return array


def _start(stages: Stages, z: Array, v: Array, warm: CoreSolution | None) -> dict[str, Array]:
    sizes = {
        "z": stages.points,
        "v": stages.variables,
        "s": sum(stages.inequalities),
        "lam": sum(stages.after),
        "y": sum(stages.inequalities),
        "ye": sum(stages.equalities),
        "zl": stages.variables,
        "zu": stages.variables,
    }
    first = {name: np.zeros(count) if warm is None else getattr(warm, name) for name, count in sizes.items()}
    first |= {"z": z, "v": v}
    return {name: _checked(name, a, sizes[name]).copy() for name, a in first.items()}
