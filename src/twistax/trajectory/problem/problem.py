"""An optimal-control problem on compiled systems. It is transcribed and compiled once, and may be solved many times."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import known_arguments
from ...errors import ModelError, TrajectoryError, in_phase
from ...expr import Parameter, leaves_of
from ...linear.free_parameters import boxes_of
from ...progress import watching
from ...scalar.walk import uncollected
from ...system import free_name, name_of
from ...system.dynamics import need_compiled
from ..controllers.controller import Controller
from ..result.many import TrajectoryResults
from ..result.result import TrajectoryResult
from ..strategy.accuracy import MESH
from ..strategy.core_solver import CoreSolver
from ..strategy.outcome import Callback
from ..strategy.redundant_rows import redundant_rows
from ..strategy.stiffness import IMPLICIT
from ..strategy.strategies import Strategy
from ..transcription.border import Border
from ..transcription.iterate import Instance, Iterate
from ..transcription.mesh import Remeshed
from ..transcription.staged import Staged
from .bridges.lifted_functionals import InPhase
from .by_node import only_once
from .links import joined, links_of
from .parameters import parameter_values, parameters_of
from .phase import Phase, check_phases, initials_of, kind_of
from .solve import SolveOptions, solved, solved_many
from .start import Started, started
from .stated_phase import StatedPhase
from .statement import Objective

#: Threads that solve the same problem build its first solver once, because that determines the redundant rows.
_MAKING = threading.RLock()
#: Other methods with the arguments of `solve`.
_ELSEWHERE = {"tx.trajectory.Problem": lambda: Problem.__init__}


class Problem:
    """Find controls, states and final time that optimise an objective under a system's constraints.

    minimise J subject to $x' = f(t, x, u)$, the system's constraints and the bounds of its leaves along the path,
    conditions at both ends, and limits of the final time. By default controls are constant over each of nodes - 1
    intervals. Constraints on states are imposed at the nodes and at the ends of the substeps between them.

    The problem is always solved in double precision, whatever the global setting.

    Args:
        dynamics: a compiled system; or a list of `Phase` in order, with only `links`, `params` and `free` as further
            arguments. States of the same name and kind then continue from phase to phase, time continues, objectives
            are added, and parameters of the same name are the same in all phases.
        objective: `tx.Minimize(...)` or `tx.Maximize(...)`.
        links: for problems of several phases, a list with one entry for each transition: a dict from states of the next
            phase to expressions of parameters and of the last states of the previous phase, or None for a transition
            without changes. The value None in a dict leaves a state free.
        nodes: number of state nodes, two or more, at equal distances; or their positions, as an increasing sequence of
            fractions of the final time from 0 to 1; or a `tx.trajectory.Mesh`, whose intervals may be free.
        final_time: a number in s, or limits (low, high) to leave it free.
        initial, final: values by state or name, which override those of leaves, or constraints on the first or last
            node such as `g[:3, 3] == 0`, or a list of both. Entries that are NaN or None are free; of a pose, only the
            whole position or the whole attitude can be free.
        at: constraints at inner nodes by the number of the node, 1 to nodes - 2, each one or a list.
        params: values of parameters by leaf or name, also those of the objective; by default the declared values.
        free: parameters that are unknowns, by leaf or name, each with limits (low, high): numbers or arrays of its
            shape. None or an infinite value means no limit. A list of parameters means no limits.
        by_node: a list of parameters of the objective (references and weights) whose values in `params` have a row for
            each node, or one row for all. They are linear in time between nodes; the final cost uses the last row.
        controls: the interpolation of controls between nodes: `tx.trajectory.Held()` (the default),
            `tx.trajectory.Linear()` or `tx.trajectory.Spline(degree)`, for all controls, or a dict by leaf or name.
        guess: values by leaf or name, in place of the declared guesses: one value for all nodes or intervals, or one
            for each node (states, continuous controls) or interval (piecewise constant controls). The default for a
            free parameter is its value, or the nearest point within its limits.
        final_time_guess: the guess of a free final time; by default the middle of its limits, or their geometric mean
            where the upper one is more than a hundred times the lower.
        transcription: the integration of an interval, in exponential coordinates about its first node:
            `tx.trajectory.MultipleShooting(method, substeps)` or `tx.trajectory.Collocation(tableau)`.
        method, substeps: the arguments of multiple shooting, as an alternative to `transcription`: an RKMK method with
            an explicit tableau, RK4 by default, and the number of steps in an interval, 2 by default.
        hessian: approximate second derivatives: `tx.trajectory.GaussNewton()` or `tx.trajectory.QuasiNewton()`.
    Raises:
        ModelError: unknown names or invalid values; for phases all messages begin with the name of the phase.
        ShapeError: a wrong shape.
        TrajectoryError: impossible nodes, times or end values.
        InputError: parameters without a value.
    """

    shooting: Any

    @known_arguments("Problem", TrajectoryError, {"problem.solve": lambda: Problem.solve})
    def __init__(
        self,
        dynamics: Any,
        objective: Any = None,
        *,
        links: Any = None,
        nodes: Any = 25,
        final_time: Any = None,
        initial: Any = None,
        final: Any = None,
        at: Any = None,
        params: Mapping[Any, Any] | None = None,
        free: Any = None,
        by_node: Any = None,
        controls: Any = None,
        guess: Mapping[Any, Any] | None = None,
        final_time_guess: Any = None,
        transcription: Any = None,
        method: Any = None,
        substeps: Any = None,
        hessian: Any = None,
    ) -> None:
        arguments = {name: value for name, value in locals().items() if name != "self"}
        #: The arguments of the statement: `Problem(**problem.stated)` is the same problem.
        self.stated = arguments
        of_phase = {field.name: arguments[field.name] for field in dataclasses.fields(Phase) if field.name in arguments}
        #: Whether the problem was stated without a list of phases: then names have no prefix of a phase.
        self.alone = not isinstance(dynamics, (list, tuple))
        if self.alone:
            self.phases = [Phase(**of_phase)]
            if links is not None:
                raise ModelError("links connects phases; a problem of one phase has no links")
            if not isinstance(objective, Objective):
                need_compiled("Problem", dynamics)
                raise ModelError(
                    "Problem expects tx.Minimize(...) or tx.Maximize(...) as its objective, got "
                    f"{type(objective).__name__}"
                )
        else:
            self.phases, links = list(dynamics), objective if links is None else links
            check_phases(self.phases, of_phase)
        self.stands_in = False  #: whether it replaces a problem whose explicit steps are unstable
        self.names: list[str] = []
        for index, phase in enumerate(self.phases):
            self.names.append(free_name(phase.name or f"phase {index}", self.names))
        kind = kind_of(self.phases)
        self.sign = kind.sign
        self.parts = self._parts(kind)
        self.sources = links_of(self.parts, self.names, links)
        self._state_parameters(params, free)
        self._build()

    @watching("problem")
    def _parts(self, kind: type[Objective]) -> list[StatedPhase]:
        """The phases, with their bridges applied."""
        carried = [initials_of(phase) for phase in self.phases]
        parts, last = [], len(self.phases) - 1
        for index, (phase, name) in enumerate(zip(self.phases, self.names)):
            need_compiled("Problem" if self.alone else "Phase", phase.dynamics)
            initials = () if self.alone else tuple(leaf for leaves in carried[index:] for leaf in leaves)
            within = InPhase("" if self.alone else name, initials, index == 0, index == last)
            with self.errors_of(name):
                parts.append(StatedPhase(phase, kind(0.0) if phase.objective is None else phase.objective, within))
        return parts

    def _state_parameters(self, params: Mapping[Any, Any] | None, free: Any) -> None:
        """Collect the parameters and the free unknowns of all phases."""
        params = {name_of(key): value for key, value in (params or {}).items()}
        exprs = [e for sources in self.sources for e in sources.values() if e is not None]
        read = {leaf.name: leaf for leaf in leaves_of(*exprs) if isinstance(leaf, Parameter)}
        read |= {leaf.name: leaf for part in self.parts for leaf in part.readable}
        #: All parameters by name, and the names of the parameters that the problem reads.
        self.leaves = {**read, **parameters_of(self.parts, self.names, params)}
        self._read = set(read)
        baked = {name for part in self.parts for name in part.baked} - set(self.leaves)
        added = [box for part in self.parts for box in part.bounds]
        boxes = (*boxes_of(free, read.values(), baked), *added)
        times = ("final time",) if self.alone else tuple(f"duration of {name}" for name in self.names)
        self.border = Border(times, np.array([part.time_limits for part in self.parts]), boxes)
        only_once([part.by_node for part in self.parts])
        self.params = self.values(params)

    def values(self, params: Mapping[str, Any]) -> dict[str, Array]:
        """Values of all parameters, checked."""
        by_nodes = [part.by_node for part in self.parts]
        values = parameter_values(self.leaves, self._read, self.border.boxes, by_nodes, params)
        for part, name in zip(self.parts, self.names):
            with self.errors_of(name):
                part.check_weights(values)
        return values

    def _build(self) -> None:
        """Transcribe the phases; solvers are made at the first solve."""
        for number, (part, name) in enumerate(zip(self.parts, self.names)):
            with self.errors_of(name):
                part.transcribe(number, self.border)
        self.shooting = self.parts[0].shooting if self.alone else joined(self.parts, self.sources, self.names)
        self.forget()

    def forget(self) -> None:
        """Free the compiled solvers; they are compiled again when needed."""
        self._cores: dict[tuple[float, int, int], CoreSolver] = {}
        self._implicit: Problem | None = None

    def errors_of(self, name: str) -> contextlib.AbstractContextManager[None]:
        """A context in which error messages begin with the name of the phase."""
        return contextlib.nullcontext() if self.alone else in_phase(name)

    def __repr__(self) -> str:
        parts = [repr(part) if self.alone else f"{name}: {part!r}" for name, part in zip(self.names, self.parts)]
        return f"Problem({', '.join(parts)})"

    def __getattr__(self, name: str) -> Any:
        """An attribute of the phase if there is only one, such as nodes, mesh, dynamics, objective and hessian."""
        parts = self.__dict__.get("parts", ())
        if name.startswith("_") or len(parts) != 1:
            raise AttributeError(f"a problem of {len(parts)} phases has no attribute {name!r}")
        return getattr(parts[0], name)

    def __getstate__(self) -> dict[str, Any]:
        """Everything but compiled functions, which compile again in another process."""
        return {k: v for k, v in self.__dict__.items() if k not in ("shooting", "_cores", "_implicit")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._build()

    # ---- the same problem otherwise ---------------------------------------------------------------------------------

    def with_phases(self, changes: Sequence[Mapping[str, Any]]) -> Problem:
        """The same problem with some arguments of its phases replaced."""
        if self.alone:
            return Problem(**{**self.stated, **changes[0]})
        phases = [dataclasses.replace(phase, **other) for phase, other in zip(self.phases, changes, strict=True)]
        return Problem(**self.stated | {"dynamics": phases})

    def on(self, meshes: Sequence[Remeshed]) -> Problem:
        """The same problem without its guess on other meshes, one for each phase."""
        triples = zip(self.phases, self.parts, meshes, strict=True)
        return self.with_phases([{"by_node": part.by_node} | mesh.stated(phase.at) for phase, part, mesh in triples])

    @property
    def implicit(self) -> Problem:
        """The same problem with an implicit transcription."""
        if self._implicit is None:
            other = {"transcription": IMPLICIT, "method": None, "substeps": None}
            self._implicit = self.with_phases([other] * len(self.parts))
            self._implicit.stands_in = True
        return self._implicit

    @property
    def soft(self) -> set[str]:
        """The names of soft constraints, entry by entry."""
        pairs = zip(self.shooting.segments, self.parts)
        return {self.shooting.named(segment, row) for segment, part in pairs for row in part.soft}

    def started(self, *arguments: Any, **named: Any) -> Started:
        """The initial point and the data of a solve with these arguments; see `start.started`."""
        return started(self, *arguments, **named)

    # ---- solving ----------------------------------------------------------------------------------------------------

    @known_arguments("solve", TrajectoryError, _ELSEWHERE)
    def solve(
        self,
        guess: Mapping[Any, Any] | None = None,
        *,
        warm: Any = None,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        params: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        final_time_guess: Any = None,
        free: Mapping[Any, Any] | None = None,
        guesses: int = 1,
        seed: int | None = None,
        callback: Callback | None = None,
        progress: Any = None,
        max_iterations: int = 1000,
        max_seconds: float | None = None,
        tolerance: float = 1e-6,
        solver: Any = None,
        between: float | None = None,
        refine: Any = None,
        mesh_tolerance: float = MESH,
        strategies: Collection[Any] = tuple(Strategy),
    ) -> TrajectoryResult:
        """Optimise from one guess or from several, and return the best result.

        The first call compiles, later calls do not. A problem that differs from an earlier one only in numbers or in
        the number of nodes does not recompile either: numbers in expressions are arguments of the compiled functions. A
        change of structure recompiles: for example a coefficient that becomes zero or one, another exponent, or another
        table. Several threads may solve the same problem.

        If explicit steps are unstable and the solve finds no optimum, the problem is solved by collocation with Radau
        IIA of order 5, and the message states this. `result.problem` is the problem that was solved: use it for a warm
        start from such a result.

        For a problem of phases the result is a `PhasedResult`. Then guess, initial, final, final_time and
        final_time_guess are dicts from names of phases to the values described here; omitted phases keep
        their values.

        Args:
            guess: values by leaf or name, in place of those of the problem's guess.
            warm: a result, or its `shifted(...)`, as the start in place of a guess. Its multipliers and scales are used
                too, with a barrier parameter that fits its violation of the present problem.
            initial, final: values by state or name in place of those of the problem. They must fix the same entries.
            params: values of parameters, by leaf or name, in place of those of the problem.
            free: other limits of free parameters, by leaf or name. A side without a limit must remain without one.
            final_time: a number if the problem has a number, limits if it has limits.
            final_time_guess: the guess of a free final time.
            guesses: the number of tries. The first starts from the guess or from `warm`, the others start from random
                perturbations of the guess.
            seed: also perturb the guess of the first try; equal seeds give equal tries. The standard deviation is 0.4
                of the scale for free tangents of states, final times and parameters, and 0.15 of the scale for
                controls, but at most a sixth of the distance between limits. Perturbations are halved until the defects
                of the dynamics are at most thirty times their scale, and at most thirty times the defects of the guess.
            callback: called with (iteration, cost, violation) before each iteration. If it returns True the solve ends
                with status STOPPED, and the result is the iterate with the smallest error. `IPOPT` and `Fatrop` ignore
                the return value.
            progress: True prints a line for each iteration (cost, violation, step), False nothing; a `Progress` formats
                the cost. By default lines appear after two seconds, on a terminal, unless there is a callback.
            max_iterations: the most iterations of a try.
            max_seconds: wall time after which the solve ends with status OUT_OF_TIME and the iterate of the smallest
                error; its mesh is checked afterwards. `IPOPT` and `Fatrop` have their own argument for it.
            tolerance: tolerance of the scaled first-order conditions.
            solver: another solver, `tx.trajectory.IPOPT()` or `tx.trajectory.Fatrop()`; by default the interior-point
                method of this package.
            between: the largest permitted violation of path constraints along a dense rollout, in their scales, such as
                1e-6. If it is exceeded, constraints are tightened, and the problem is solved again by a warm start.
            mesh_tolerance: the largest mesh error for status SOLVED; above it the status is COARSE. The mesh error is
                the larger of two errors: the distance between the end of an interval, integrated accurately from its
                first node, and the next node, in scales of the states; and the relative error of the objective. See
                `result.accuracy`. An infinite tolerance accepts any mesh.
            refine: refine the mesh until its error, as above, and the relative change of the objective between meshes
                are at most this, such as 1e-6. The result is that of the last mesh, on `result.problem`;
                `result.meshes` lists all meshes. The status is COARSE if a thousand nodes do not suffice.
            strategies: members of `Strategy` in addition to one run of the interior-point method; of this solver alone.
        Raises:
            ModelError, ShapeError, InputError: an invalid guess, end or parameter.
            TrajectoryError: ends that fix other entries; invalid times or numbers; limits of a parameter that is not
                free, or on other sides; a warm start from another problem, or together with a guess.
        """
        arguments = {name: value for name, value in locals().items() if name != "self"}
        return solved(self, SolveOptions(**arguments))

    @known_arguments("solve_many", TrajectoryError, _ELSEWHERE)
    def solve_many(
        self,
        guess: Mapping[Any, Any] | None = None,
        *,
        initial: Mapping[Any, Any] | None = None,
        final: Mapping[Any, Any] | None = None,
        params: Mapping[Any, Any] | None = None,
        final_time: Any = None,
        free: Mapping[Any, Any] | None = None,
        max_iterations: int = 1000,
        tolerance: float = 1e-6,
        mesh_tolerance: float = MESH,
    ) -> TrajectoryResults:
        """Solve many cases in one call, each as `solve` does; the failure of one case does not affect the others.

        Arguments are those of `solve`. A value with an additional leading axis has one entry for each case; other
        values are shared by all cases. A guess with an axis of cases must also have an axis of nodes or intervals.
        Cases run in parallel on all processors.

        Raises:
            ShapeError: arguments for different numbers of cases.
            TrajectoryError: no argument has an axis of cases.
            TwistaxError: as `solve` does, where all cases are invalid. If only some cases are invalid, each of them has
                status REFUSED, and its message begins with its number.
        """
        arguments = {"guess": guess, "initial": initial, "final": final, "params": params, "final_time": final_time}
        options = SolveOptions(max_iterations=max_iterations, tolerance=tolerance, mesh_tolerance=mesh_tolerance)
        return solved_many(self, arguments | {"free": free}, options)

    def controller(self, warm: Any = None, **options: Any) -> Controller:
        """A model-predictive controller for this problem; see `Controller` for the options."""
        return Controller(self, warm, **options)

    def to_c(
        self, directory: Any, *, name: str = "controller", warm: Any = None, dtype: Any = np.float64, **options: Any
    ) -> Any:
        """Write a controller as C99 in float64 or float32; see `Controller` for the options, and `Controller.to_c`."""
        return self.controller(warm, **options).to_c(directory, name=name, dtype=dtype)

    def core(self, tolerance: float, point: Iterate, instance: Instance) -> CoreSolver:
        """The solver for the current thread. Kernels compile once. The solver's memory serves one solve at a time."""
        key = (tolerance, threading.get_ident(), 0)
        while key in self._cores and self._cores[key].busy:
            key = (*key[:2], key[2] + 1)
        if key not in self._cores:
            with _MAKING, uncollected():
                first = next((core.staged for core in self._cores.values()), None)
                staged = Staged(self.shooting, self.parts, instance) if first is None else first.alone(instance)
                if first is None:
                    staged.drop(redundant_rows(staged, point, instance), instance)
                self._cores[key] = CoreSolver(staged, self.parts, instance, tolerance)
        return self._cores[key]
