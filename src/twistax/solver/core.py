"""The interior-point core from Python: a problem in stages, its functions, and what a solve returns.

    minimise    sum_k l_k(x_k, u_k, p)
    subject to  x_(k+1) = f_k(x_k, u_k, p),   h_k(x_k, u_k, p) <= 0,   e_k(x_k, u_k, p) = 0,   lower <= v <= upper

with v = (x_0, u_0, ..., x_N, u_N, p). States may lie on a manifold: then a node has a point, `retract` moves it along a
tangent step, and defects are logarithms about the node where an interval ends.
Source: A. Waechter, L. T. Biegler, On the implementation of an interior-point filter line-search algorithm for
large-scale nonlinear programming, Mathematical Programming 106 (2006).
"""

from __future__ import annotations

import ctypes
import dataclasses
import enum
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ..errors import TrajectoryError
from .library import library
from .options import Options


class CoreStatus(enum.Enum):
    """How a solve ended; the values are those of `twx_status` in core.h."""

    SOLVED = 0
    MAX_ITERATIONS = 1
    INFEASIBLE = 2
    STALLED = 3
    NON_FINITE = 4
    UNBOUNDED_CURVATURE = 5
    STOPPED = 6
    _BAD_PROBLEM = 7
    UNBOUNDED = 8
    ACCEPTABLE = 9


@dataclasses.dataclass(frozen=True)
class Stages:
    """Sizes of a problem, for each of its N + 1 stages.

    Attributes:
        states: dimensions of the states' tangent spaces.
        controls: counts of controls; the last stage has none.
        inequalities, equalities: counts of rows h and e.
        parameters: count of parameters p, which all stages share.
        point_states: entries of a state's point, where states lie on a manifold.
    """

    states: Sequence[int]
    controls: Sequence[int]
    inequalities: Sequence[int]
    equalities: Sequence[int]
    parameters: int = 0
    point_states: Sequence[int] | None = None

    def __post_init__(self) -> None:
        counts = (self.states, self.controls, self.inequalities, self.equalities, self.point_states or self.states)
        if len(set(map(len, counts))) != 1 or len(self.states) < 2:
            raise TrajectoryError(f"Stages expects lists of one length, 2 or more, got {[len(c) for c in counts]}")
        if min(map(min, counts)) < 0 or self.parameters < 0:
            raise TrajectoryError("Stages expects counts of 0 or more")
        if self.controls[-1] != 0:
            raise TrajectoryError(f"Stages: the last stage has no controls, got {self.controls[-1]}")

    @functools.cached_property
    def variables(self) -> int:
        """Entries of v."""
        return sum(self.states) + sum(self.controls) + self.parameters

    @functools.cached_property
    def points(self) -> int:
        """Entries of z, which has points in place of states."""
        return sum(self.point_states or self.states) + sum(self.controls) + self.parameters

    @functools.cached_property
    def first(self) -> Array:
        """Where each stage begins in v."""
        widths = np.array(self.states) + np.array(self.controls)
        return np.asarray(np.cumsum(widths) - widths)

    @functools.cached_property
    def first_point(self) -> Array:
        """Where each stage begins in z."""
        widths = np.array(self.point_states or self.states) + np.array(self.controls)
        return np.asarray(np.cumsum(widths) - widths)

    @functools.cached_property
    def columns(self) -> list[int]:
        """Columns of each stage's derivatives: x_k, u_k, p."""
        return [x + u + self.parameters for x, u in zip(self.states, self.controls)]

    @functools.cached_property
    def after(self) -> list[int]:
        """States of the stage after each one."""
        return [*self.states[1:], 0]

    @functools.cached_property
    def first_defect(self) -> Array:
        """Where the defects of each stage begin."""
        return np.asarray(np.cumsum(self.after) - self.after)

    @functools.cached_property
    def first_slope(self) -> Array:
        """Where the derivatives of the defects of each stage begin."""
        sizes = np.array(self.after) * np.array(self.columns)
        return np.asarray(np.cumsum(sizes) - sizes)

    @functools.cached_property
    def runs(self) -> list[slice]:
        """Consecutive stages whose counts are all the same: their blocks have one shape."""
        points = self.point_states or self.states
        counts = np.array([self.states, self.controls, self.inequalities, self.equalities, self.after, points])
        begins = np.flatnonzero((np.diff(counts) != 0).any(axis=0)) + 1
        ends = [0, *begins.tolist(), len(self.states)]
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    @functools.cached_property
    def row_counts(self) -> tuple[int, int, int]:
        """Defects, inequalities and equalities of all stages."""
        return sum(self.after), sum(self.inequalities), sum(self.equalities)

    @functools.cached_property
    def slope_sizes(self) -> list[int]:
        """Entries of the derivatives of all defects, inequalities and equalities."""
        return [self.block_sizes(rows) for rows in (self.after, self.inequalities, self.equalities)]

    @functools.cached_property
    def hessian_size(self) -> int:
        """Entries of the second derivatives of all stages."""
        return self.block_sizes(self.columns)

    def block_sizes(self, rows: Sequence[int]) -> int:
        """Entries of a block (rows, columns) of each stage, one after the other."""
        return sum(r * n for r, n in zip(rows, self.columns))


@dataclasses.dataclass(frozen=True)
class StageFunctions:
    """Addresses of the functions of all stages, as `twx_problem` in core.h declares them.

    Attributes:
        values, jacobians, hessians, retract, transport, stop: addresses; 0 where there is no such function.
        user: what they get as first argument.
        owner: what must live as long as the functions; its `check`, if it has one, is called after a solve.
    """

    values: int
    jacobians: int
    hessians: int
    retract: int = 0
    transport: int = 0
    stop: int = 0
    user: int = 0
    owner: Any = None

    def check(self) -> None:
        """Raise what a function raised in the last call."""
        check = getattr(self.owner, "check", None)
        if check is not None:
            check()

    @property
    def addresses(self) -> dict[str, int]:
        """By the names that `twx_problem` has for them."""
        names = ("user", "values", "jacobians", "hessians", "retract", "transport", "stop")
        return {name: getattr(self, name) for name in names}


class Units(NamedTuple):
    """Units in which the core counts: of v, of the rows h and e, and of the cost; 1 where None."""

    size: Array | None = None
    row_size: Array | None = None
    equality_size: Array | None = None
    cost: float = 1.0


@dataclasses.dataclass
class CoreSolution:
    """A result, in the problem's units, and the start of a warm solve.

    Attributes:
        status: how the solve ended.
        z: points, controls and parameters.
        v: the same in coordinates of the bounds.
        s, y: slacks and multipliers of h.
        lam: multipliers of the dynamics.
        ye: multipliers of e.
        zl, zu: multipliers of lower and upper bounds.
        statistics: counts and measures, by name; SOLVED means that `error`, scaled, is at most the tolerance.
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
                *("lower", "upper", "size", "row_size", "equality_size"),
            )
        ),
        ("cost_size", ctypes.c_double),
        *(
            (name, ctypes.c_void_p)
            for name in ("largest_step", "user", "values", "jacobians", "hessians", "retract", "transport", "stop")
        ),
    ]


#: Numbers of `twx_statistics`, in its order.
_MEASURES = ("cost", "error", "stationarity", "violation", "complementarity", "barrier", "cost_scale", "minimum")
_COUNTS = (
    *("status", "iterations", "evaluations", "factorizations", "corrections", "restorations"),
    *("restoration_iterations", "filter_resets", "inertia_corrections"),
)


class _Statistics(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double) for name in _MEASURES),
        *((name, ctypes.c_int32) for name in _COUNTS),
        ("log", ctypes.c_void_p),
        ("log_rows", ctypes.c_int32),
    ]


#: Arrays of `twx_solution`, in its order.
_MULTIPLIERS = ("v", "s", "lam", "y", "ye", "zl", "zu")


class _Solution(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in _MULTIPLIERS]


class Described(NamedTuple):
    """A problem as the core reads it, and the arrays that its addresses are of."""

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
    by_name = {"lower": lower, "upper": upper, "largest_step": largest_step, **units._asdict()}
    cost_size = by_name.pop("cost")
    variables, rows, equalities = stages.variables, sum(stages.inequalities), sum(stages.equalities)
    lengths = dict.fromkeys(("lower", "upper", "largest_step", "size"), variables)
    lengths |= {"row_size": rows, "equality_size": equalities}
    arrays = {name: _checked(name, a, lengths[name]) for name, a in by_name.items() if a is not None}
    arrays |= {
        name: np.asarray(getattr(stages, name), np.int32)
        for name in ("states", "controls", "inequalities", "equalities", "point_states")
        if getattr(stages, name) is not None
    }
    structure = ProblemStructure(len(stages.states) - 1, stages.parameters, cost_size=cost_size)
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
    statistics, problem = _Statistics(), described.structure
    stop = _StopFunction(should_stop, statistics, stages.points)
    for name, address in stop.addresses.items():
        setattr(problem, name, address)
    chosen = dataclasses.replace(options or Options(), warm_start=float(warm is not None)).as_structure()
    core = library()
    workspace = np.empty(core.workspace_size(ctypes.byref(problem)))
    log = np.zeros((int(chosen.iterations) + 1, 10))
    statistics.log, statistics.log_rows = log.ctypes.data, len(log)
    multipliers = _Solution(*(arrays[name].ctypes.data for name in _MULTIPLIERS))
    references = [ctypes.byref(part) for part in (problem, chosen, multipliers, statistics)]
    pointers = (arrays["z"].ctypes.data, references[2], workspace.ctypes.data, references[3])
    status = CoreStatus(core.solve(*references[:2], *pointers))
    stop.check()
    functions.check()
    if status is CoreStatus._BAD_PROBLEM:
        raise TrajectoryError(
            "solve: bounds expect lower <= upper, and units positive numbers; "
            "bounds may be equal for x_0, controls and parameters alone\n"
            "  fix: fix a state after the first by an equality"
        )
    numbers = {name: getattr(statistics, name) for name in (*_MEASURES, *_COUNTS[1:])}
    return CoreSolution(status=status, **arrays, statistics=numbers, log=log[: statistics.iterations])


class _StopFunction:
    """The function that the core asks whether to stop. Python sees signals while it runs.

    Attributes:
        addresses: by the name that `twx_problem` has for it.
    """

    def __init__(self, should_stop: StopCheck | None, statistics: _Statistics, points: int) -> None:
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
        """Raise what it raised."""
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
