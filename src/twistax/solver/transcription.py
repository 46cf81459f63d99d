"""Transcribed phases in the form of `transcription.h`: their numbers, kernels and rows."""

from __future__ import annotations

import ctypes
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from .core import StageFunctions
from .kernels import BatchKernel, Callback, KernelStructure, SmoothKernels
from .library import library
from .stages import Stages
from .structures import JoinStructure, NodeStructure, OffsetsStructure, PhaseStructure, TranscriptionStructure

#: Newton steps of an implicit method at most, and the size of a step, relative, after which one more is the last.
_NEWTON, _CLOSE = 60, 1e-9

#: What rows of a stage are: dropped, or the number of an inequality, or -2 minus that of an equality.
DROPPED = -1


@dataclasses.dataclass(frozen=True)
class Scheme:
    """A Runge-Kutta method of intervals.

    Attributes:
        a, b, c: its coefficients.
        implicit: whether its stages are solved for.
    """

    a: Array
    b: Array
    c: Array
    substeps: int
    implicit: bool

    @property
    def at_end(self) -> bool:
        """Whether the rates are evaluated only at the end of an interval, as by the backward Euler method."""
        return self.implicit and self.substeps == 1 and self.c.tolist() == [1.0]

    @property
    def weights(self) -> Array:
        """The weights b of the running cost: of the ends of substeps, then of all stages, for a unit interval.

        The first stage of an explicit method is the start of its substep, and the last stage of a stiffly accurate one
        is its end: there path rows are evaluated with the cost.
        """
        ends, stages = np.zeros(self.substeps + 1), np.tile(self.b / self.substeps, (self.substeps, 1))
        if not self.implicit:
            ends[:-1], stages[:, 0] = stages[:, 0], 0.0
        elif np.array_equal(self.a[-1], self.b):
            ends[1:], stages[:, -1] = stages[:, -1], 0.0
        return np.concatenate([ends, stages.ravel()])


@dataclasses.dataclass(frozen=True)
class PhaseKernels:
    """Functions of a phase.

    Attributes:
        rate: of (eta, u, p), the share, the node and the data.
        rows: of the same; path constraints, then the density of the running cost.
        gap: log(target^-1 base exp(eta)).
        nodes: conditions of (eta, p) by node; the last one is the end, with its cost after its conditions.
        retract, turn: of manifolds that are not flat: base exp(d), and the left Jacobian of a defect.
    """

    rate: SmoothKernels
    rows: SmoothKernels
    gap: SmoothKernels
    nodes: Sequence[tuple[int, SmoothKernels]]
    retract: BatchKernel | None = None
    turn: BatchKernel | None = None

    @property
    def every(self) -> list[BatchKernel]:
        smooth = [self.rate, self.rows, self.gap, *(node for _, node in self.nodes)]
        of_group = [kernel for kernel in (self.retract, self.turn) if kernel is not None]
        return [kernel for function in smooth for kernel in function.kernels] + of_group


@dataclasses.dataclass(frozen=True)
class JoinKernels:
    """The functions between a phase and the next.

    Attributes:
        gap: log(start^-1 jump(end)) of (eta, p), the last node and the next one; zero in entries that are free.
        free: entries of the next start that nothing decides.
    """

    gap: SmoothKernels
    free: Array


@dataclasses.dataclass(frozen=True)
class CorePhase:
    """A phase of a transcribed problem.

    Attributes:
        n, m, point: tangents and controls of a stage, entries of a node's point.
        starts, widths: of intervals, shares of the duration.
        path: (intervals, substeps + 1, rows) what each path row is: NONE, an INEQUALITY or an EQUALITY.
        conditions: the same of the conditions of each node.
        join: to the next phase.
        node_rows: where in the data the numbers of the nodes begin, and how many each has.
        of_phase: where in the data the numbers of the phase begin.
    """

    n: int
    m: int
    point: int
    method: Scheme
    kernels: PhaseKernels
    starts: Array
    widths: Array
    path: Array
    conditions: Sequence[Array]
    join: JoinKernels | None = None
    node_rows: tuple[int, int] = (0, 0)
    of_phase: int = 0

    @property
    def intervals(self) -> int:
        return len(self.widths)

    @property
    def controls(self) -> list[int]:
        """The number of controls of every stage; those of the last stage belong to the join."""
        return [self.m] * self.intervals + [0 if self.join is None else len(self.join.free)]

    def rows_by_stage(self, kind: int) -> list[Array]:
        """The rows of each stage that are of a kind: path rows, then conditions."""
        rows = [[path] for path in (self.path == kind).reshape(self.intervals, -1)] + [[np.zeros(0, bool)]]
        for (stage, _), of_node in zip(self.kernels.nodes, self.conditions):
            rows[stage].append(of_node == kind)
        return [np.concatenate(parts) for parts in rows]

    def numbered(self, kind: int) -> tuple[Array, list[Array]]:
        """The number of each path row and condition within its stage among those of a kind, -1 where it is none."""
        numbers = [np.where(rows, np.cumsum(rows) - 1, -1) for rows in self.rows_by_stage(kind)]
        width = self.path[0].size
        path = np.stack([rows[:width] for rows in numbers[:-1]]).reshape(self.path.shape)
        used, nodes = [width] * self.intervals + [0], []
        for (stage, _), rows in zip(self.kernels.nodes, self.conditions):
            nodes.append(numbers[stage][used[stage] : used[stage] + len(rows)])
            used[stage] += len(rows)
        return path, nodes


#: Kinds of rows.
NONE, INEQUALITY, EQUALITY = 0, 1, 2


_POINTERS = [ctypes.c_void_p] * 6
_SIGNATURES = {
    "values": ctypes.CFUNCTYPE(ctypes.c_int32, *_POINTERS),
    "jacobians": ctypes.CFUNCTYPE(ctypes.c_int32, *_POINTERS),
    "hessians": ctypes.CFUNCTYPE(ctypes.c_int32, *_POINTERS[:2], ctypes.c_double, *_POINTERS[:4]),
    "retract": ctypes.CFUNCTYPE(ctypes.c_int32, *_POINTERS[:4]),
}


class Transcription:
    """Phases as the functions of a multi-stage problem.

    Args:
        phases: what is transcribed, one after the other.
        parameters: entries of p.
        data: numbers that kernels read.

    Attributes:
        stages: sizes for the core.
        functions: for the core.
        structure: its phases, for the core.
        first: the first stage of each phase.
        path_places: of each phase (intervals, substeps + 1, rows), the number of each path row among the inequalities,
            or among the equalities, of all stages; -1 where it is neither.
        node_places: the same of the conditions of nodes.
        data: numbers that kernels read.
        cost_slopes: of each phase (stages, parameters), what each stage adds to the gradient of the cost by parameters,
            of the last Jacobians.
    """

    def __init__(self, phases: Sequence[CorePhase], parameters: int, data: Array) -> None:
        self.phases = phases
        counts = [
            np.array([int(rows.sum()) for phase in phases for rows in phase.rows_by_stage(kind)], np.int64)
            for kind in (INEQUALITY, EQUALITY)
        ]
        self.stages = Stages(
            [phase.n for phase in phases for _ in phase.controls],
            [count for phase in phases for count in phase.controls],
            counts[0].tolist(),
            counts[1].tolist(),
            parameters,
            [phase.point for phase in phases for _ in phase.controls],
        )
        lengths = [len(phase.controls) for phase in phases]
        self.first = (np.cumsum(lengths) - lengths).tolist()
        self._memory: list[Any] = []
        self._offsets = self._placed(counts)
        numbers = [[phase.numbered(kind) for kind in (INEQUALITY, EQUALITY)] for phase in phases]
        places = [self._among_all(*of_phase) for of_phase in zip(phases, self.first, numbers)]
        self.path_places: list[Array] = [path for path, _ in places]
        self.node_places: list[list[Array]] = [nodes for _, nodes in places]
        self.cost_slopes = [np.zeros((len(phase.controls), parameters)) for phase in phases]
        self.data = np.array(data, float)
        #: By which rows are tightened: those of the path, then those of each node.
        self._margins = [[np.zeros(rows.shape) for rows in (phase.path, *phase.conditions)] for phase in phases]
        described = (self._described(k, *of_phase) for k, of_phase in enumerate(numbers))
        self._structures = (PhaseStructure * len(phases))(*described)
        for structure in self._structures:
            structure.work, structure.scratch = (self._array(np.zeros(size)) for size in _doubles(structure))
        self.structure = TranscriptionStructure(len(phases), ctypes.addressof(self._structures))
        addresses: dict[str, Any] = {"user": ctypes.addressof(self.structure), **library().transcribed}
        self.functions = StageFunctions(owner=self, **addresses)

    @property
    def arrays(self) -> dict[int, Array]:
        """The arrays that structures point to, by address."""
        return {array.ctypes.data: array for array in self._memory if isinstance(array, np.ndarray)}

    def phase_numbers(self, phase: int, window: int, shared_width: int) -> tuple[int, int]:
        """Numbers of the memory of a phase, for functions and for derivatives, where so many intervals are evaluated
        together, and the rate shares so many functions.
        """
        structure = PhaseStructure.from_buffer_copy(self._structures[phase])
        structure.window, structure.rate.shared_width = window, shared_width
        return _doubles(structure)

    @property
    def described(self) -> ctypes.Array[Any]:
        """The structures of all phases, as `twx_phase` has them."""
        return self._structures

    def set_data(self, data: Array) -> None:
        """Set other numbers for the kernels."""
        self.data[:] = data
        for structure in self._structures:  # integrated states are out of date
            ctypes.c_double.from_address(structure.work).value = 0.0

    def set_margins(self, phase: int, path: Array, nodes: Sequence[Array]) -> None:
        """Tighten the rows of a phase."""
        for array, values in zip(self._margins[phase], [path, *nodes]):
            array[...] = values

    def use_charts(self) -> None:
        """State nodes of manifolds as steps in charts at points that stay: derivatives are exact at any step.

        Defects are c - d of the next node then, with no factor, and `retract` means nothing.
        """
        self.steps = [np.zeros((phase.intervals + 1, phase.n)) for phase in self.phases]
        for phase, structure, steps in zip(self.phases, self._structures, self.steps):
            if phase.kernels.turn is not None:
                structure.steps = steps.ctypes.data

    def set_steps(self, steps: Sequence[Array]) -> None:
        """Steps (nodes, n) of the nodes of each phase from the points that functions get."""
        for structure, memory, values in zip(self._structures, self.steps, steps):
            if not np.array_equal(memory, values):
                memory[...] = values
                ctypes.c_double.from_address(structure.work).value = 0.0  # integrated states are out of date

    def states(self, phase: int, substep: int) -> Array:
        """Coordinates eta (intervals, n) at the end of a substep, at the point that was evaluated last."""
        eta = np.zeros((self.phases[phase].intervals, self.phases[phase].n))
        library().phase_states(ctypes.addressof(self._structures[phase]), substep, eta.ctypes.data)
        return eta

    @functools.cached_property
    def _calls(self) -> dict[str, Any]:
        return {name: signature(getattr(self.functions, name)) for name, signature in _SIGNATURES.items()}

    def call(self, name: str, *arguments: Any) -> bool:
        """Call a function of `functions` with arrays and numbers; whether it failed."""
        pointers = [a if isinstance(a, float) else a.ctypes.data for a in arguments]
        return bool(self._calls[name](self.functions.user, *pointers))

    @property
    def called_back(self) -> list[str]:
        """The functions without native form, which JAX runs."""
        called = dict[str, None]()
        for phase in self.phases:
            groups = {
                "rates": [phase.kernels.rate],
                "path constraints or the running cost": [phase.kernels.rows],
                "conditions at nodes or the final cost": [node for _, node in phase.kernels.nodes],
            }
            for name, smooth in groups.items():
                if any(isinstance(kernel.owner, Callback) for function in smooth for kernel in function.kernels):
                    called[name] = None
        return list(called)

    def check(self) -> None:
        """Raise the error of a function that JAX runs."""
        for kernel in self._run_by_jax:
            kernel.check()

    @functools.cached_property
    def _run_by_jax(self) -> list[BatchKernel]:
        kernels = [
            kernel
            for phase in self.phases
            for kernel in (*phase.kernels.every, *(phase.join.gap.kernels if phase.join else []))
        ]
        return [kernel for kernel in kernels if isinstance(kernel.owner, Callback)]

    def _array(self, array: Array) -> int:
        array = np.ascontiguousarray(array)
        self._memory.append(array)
        return int(array.ctypes.data)

    def _placed(self, counts: list[Array]) -> dict[str, Array]:
        stages = self.stages
        columns, after = np.array(stages.columns), np.array(stages.after)
        blocks = {"h": counts[0], "e": counts[1], "c": after, "F": after * columns, "H": columns**2}
        blocks |= {"Jh": counts[0] * columns, "Je": counts[1] * columns}
        places = {name: np.cumsum(size) - size for name, size in blocks.items()}
        places |= {"z": stages.first_point, "v": stages.first}
        places = {name: place.astype(np.int64) for name, place in places.items()}
        return places | {name: rows.astype(np.int32) for name, rows in zip(("inequalities", "equalities"), counts)}

    def _described(self, number: int, of_path: Any, of_nodes: Any) -> PhaseStructure:
        """A phase in the form of the core.

        Args:
            of_path, of_nodes: numbers of its rows among inequalities and among equalities, each (path, nodes).
        """
        phase, stages, margins = self.phases[number], self.stages, [self._array(a) for a in self._margins[number]]
        method, kernels, parameters = phase.method, phase.kernels, stages.parameters
        part = slice(self.first[number], self.first[number] + len(phase.controls))
        inequalities, equalities = ([path, *nodes] for path, nodes in (of_path, of_nodes))
        codes = [self._array(_codes(*both)) for both in zip(inequalities, equalities)]
        nodes = (NodeStructure * len(kernels.nodes))()
        for node, (stage, function), code, margin in zip(nodes, kernels.nodes, codes[1:], margins[1:]):
            node.function, node.stage, node.place, node.margins = function.structure, stage, code, margin
        self._memory.append(nodes)
        numbers = {name: getattr(method, name) for name in ("a", "b", "c", "weights")}
        numbers |= {"starts": phase.starts, "widths": phase.widths}
        sizes = (phase.n, phase.m, parameters, phase.point, phase.intervals, method.substeps, len(method.b))
        return PhaseStructure(
            *sizes,
            int(method.implicit),
            phase.path.shape[2],
            len(nodes),
            _NEWTON,
            close=_CLOSE,
            parameters_z=stages.points - parameters,
            parameters_v=stages.variables - parameters,
            **{name: self._array(np.asarray(a, float)) for name, a in numbers.items()},
            data=int(self.data.ctypes.data),
            of_phase=int(self.data.ctypes.data) + 8 * phase.of_phase,
            node_rows=int(self.data.ctypes.data) + 8 * phase.node_rows[0],
            node_width=phase.node_rows[1],
            place=codes[0],
            margins=margins[0],
            at=OffsetsStructure(**{name: self._array(places[part]) for name, places in self._offsets.items()}),
            **{name: getattr(kernels, name).structure for name in ("rate", "rows", "gap")},
            **{n: k.structure for n in ("retract", "turn") if (k := getattr(kernels, n)) is not None},
            node=ctypes.addressof(nodes),
            join=self._join(number),
            cost_slopes=self._array(self.cost_slopes[number]),
        )

    def _join(self, number: int) -> int | None:
        join = self.phases[number].join
        if join is None:
            return None
        turn = self.phases[number + 1].kernels.turn
        turned = KernelStructure() if turn is None else turn.structure
        free = self._array(np.asarray(join.free, np.int32))
        structure = JoinStructure(join.gap.structure, turned, len(join.free), free)
        self._memory.append(structure)
        return ctypes.addressof(structure)

    def _among_all(self, phase: CorePhase, first: int, numbers: Any) -> tuple[Array, list[Array]]:
        """Numbers among the rows of all stages."""
        path, nodes = -np.ones(phase.path.shape, int), [-np.ones(len(rows), int) for rows in phase.conditions]
        for (of_path, of_nodes), name in zip(numbers, ("h", "e")):
            before = self._offsets[name][first : first + len(phase.controls)]
            path = np.where(of_path >= 0, of_path + before[:-1, None, None], path)
            for k, (rows, (stage, _)) in enumerate(zip(of_nodes, phase.kernels.nodes)):
                nodes[k] = np.where(rows >= 0, rows + before[stage], nodes[k])
        return path, nodes


def _doubles(structure: PhaseStructure) -> tuple[int, int]:
    core, address = library(), ctypes.addressof(structure)
    return int(core.phase_work(address)), int(core.phase_scratch(address))


def _codes(inequality: Array, equality: Array) -> Array:
    return np.where(inequality >= 0, inequality, np.where(equality >= 0, -2 - equality, DROPPED)).astype(np.int32)
