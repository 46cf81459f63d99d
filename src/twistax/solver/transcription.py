"""Transcribed phases as `transcription.h` has them: their numbers, their kernels, and where their rows stand."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from .core import StageFunctions, Stages
from .kernels import BatchKernel, KernelStructure, SmoothKernels, SmoothStructure
from .library import library

#: Newton steps of an implicit method at most, and the size of a step, relative, after which one more is the last.
_NEWTON, _CLOSE = 20, 1e-9

#: What rows of a stage are: dropped, or the number of an inequality, or -2 minus that of an equality.
DROPPED = -1


@dataclasses.dataclass(frozen=True)
class Method:
    """A Runge-Kutta method of intervals, with weights of the running cost.

    Attributes:
        a, b, c: its coefficients.
        implicit: whether its stages are solved for.
        weights: of the ends of substeps, then of all stages, for a unit interval.
    """

    a: Array
    b: Array
    c: Array
    substeps: int
    implicit: bool
    weights: Array


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


@dataclasses.dataclass(frozen=True)
class Phase:
    """A phase of a transcribed problem.

    Attributes:
        n, m, point: tangents and controls of a stage, entries of a node's point.
        starts, widths: of intervals, shares of the duration.
        data: numbers that kernels read.
        path: (intervals, substeps + 1, rows) what each path row is: an inequality, an equality, or neither.
        conditions: the same of the conditions of each node.
        path_margins, margins: by which these are tightened.
    """

    n: int
    m: int
    point: int
    method: Method
    kernels: PhaseKernels
    starts: Array
    widths: Array
    data: Array
    path: Array
    conditions: Sequence[Array]
    path_margins: Array
    margins: Sequence[Array]

    @property
    def intervals(self) -> int:
        return len(self.widths)


#: Kinds of rows.
NONE, INEQUALITY, EQUALITY = 0, 1, 2


class _Node(ctypes.Structure):
    _fields_ = [
        ("function", SmoothStructure),
        ("stage", ctypes.c_int32),
        ("place", ctypes.c_void_p),
        ("margins", ctypes.c_void_p),
    ]


_OFFSETS = ("z", "v", "c", "h", "e", "F", "Jh", "Je", "H")


class _Offsets(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in (*_OFFSETS, "inequalities", "equalities")]


_COUNTS = ("n", "m", "p", "point", "intervals", "substeps", "stages", "implicit", "path_rows", "nodes", "iterations")


class _Phase(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int32) for name in _COUNTS),
        ("close", ctypes.c_double),
        ("parameters_z", ctypes.c_int64),
        ("parameters_v", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("a", "b", "c", "weights", "starts", "widths", "data", "place", "margins")),
        ("at", _Offsets),
        *((name, SmoothStructure) for name in ("rate", "rows", "gap")),
        *((name, KernelStructure) for name in ("retract", "turn")),
        ("node", ctypes.c_void_p),
        ("work", ctypes.c_void_p),
    ]


class _Transcription(ctypes.Structure):
    _fields_ = [("phases", ctypes.c_int32), ("phase", ctypes.c_void_p)]


class Transcription:
    """Phases as the functions of a problem in stages.

    Args:
        phase: what is transcribed.
        parameters: entries of p.

    Attributes:
        stages: sizes for the core.
        functions: for the core.
        path_places: (intervals, substeps + 1, rows) the number of each path row among the inequalities, or among the
            equalities, of all stages; -1 where it is neither.
        node_places: the same of the conditions of nodes.
    """

    def __init__(self, phase: Phase, parameters: int) -> None:
        self._phase = phase
        K, n, m = phase.intervals, phase.n, phase.m
        kinds = [_by_stage(phase, kind) for kind in (INEQUALITY, EQUALITY)]
        counts = [np.array([sum(part.sum() for part in stage) for stage in kind], np.int64) for kind in kinds]
        self.stages = Stages(
            [n] * (K + 1), [m] * K + [0], *(c.tolist() for c in counts), parameters, [phase.point] * (K + 1)
        )
        places = [_numbered(phase, kind) for kind in (INEQUALITY, EQUALITY)]
        self.path_places, self.node_places = _global(phase, places, counts)
        self._memory: list[Any] = []
        self._structure = self._made(places, counts, parameters)
        work = self._array(np.zeros(library().phase_work(ctypes.addressof(self._structure))))
        self._structure.work = work
        self._user = _Transcription(1, ctypes.addressof(self._structure))
        self.functions = StageFunctions(
            **library().transcribed, user=ctypes.addressof(self._user), owner=self
        )

    def check(self) -> None:
        """Raise what a function that JAX runs has raised."""
        kernels = self._phase.kernels
        smooth = [kernels.rate, kernels.rows, kernels.gap, *(own for _, own in kernels.nodes)]
        every = [k for own in smooth for k in own.kernels] + [kernels.retract, kernels.turn]
        for kernel in every:
            error = getattr(getattr(kernel, "owner", None), "error", None)
            if error is not None:
                kernel.owner.error = None
                raise error

    def _array(self, array: Array) -> int:
        """The address of an array that lives as long as this."""
        array = np.ascontiguousarray(array)
        self._memory.append(array)
        return int(array.ctypes.data)

    def _made(self, places: list[Any], counts: list[Array], parameters: int) -> _Phase:
        phase, method, kernels = self._phase, self._phase.method, self._phase.kernels
        K, n, m = phase.intervals, phase.n, phase.m
        columns = np.array(self.stages.columns)
        after, every = np.array(self.stages.after), np.arange(K + 1)
        blocks = {"h": counts[0], "e": counts[1], "F": after * columns, "H": columns**2}
        blocks |= {"Jh": counts[0] * columns, "Je": counts[1] * columns}
        offsets = {name: np.cumsum(size) - size for name, size in blocks.items()}
        offsets |= {"z": every * (phase.point + m), "v": every * (n + m), "c": every * n}
        at = {name: self._array(offsets[name].astype(np.int64)) for name in _OFFSETS}
        names = ("inequalities", "equalities")
        at |= {name: self._array(c.astype(np.int32)) for name, c in zip(names, counts)}
        codes = [_codes(of_path, of_equality) for of_path, of_equality in zip(*([p[0], *p[1]] for p in places))]
        nodes = (_Node * len(kernels.nodes))()
        for node, (stage, function), code, margins in zip(nodes, kernels.nodes, codes[1:], phase.margins):
            node.function, node.stage = function.structure, stage
            node.place, node.margins = self._array(code), self._array(margins)
        self._memory += [nodes, kernels]
        numbers = {"a": method.a, "b": method.b, "c": method.c, "weights": method.weights, "starts": phase.starts}
        numbers |= {"widths": phase.widths, "data": phase.data, "margins": phase.path_margins}
        sizes = (n, m, parameters, phase.point, K, method.substeps, len(method.b), int(method.implicit))
        return _Phase(
            *sizes,
            phase.path.shape[2],
            len(nodes),
            _NEWTON,
            close=_CLOSE,
            parameters_z=(K + 1) * phase.point + K * m,
            parameters_v=(K + 1) * n + K * m,
            **{name: self._array(np.asarray(a, float)) for name, a in numbers.items()},
            place=self._array(codes[0]),
            at=_Offsets(**at),
            **{name: getattr(kernels, name).structure for name in ("rate", "rows", "gap")},
            **{name: k.structure for name in ("retract", "turn") if (k := getattr(kernels, name)) is not None},
            node=ctypes.addressof(nodes),
        )

    def set_data(self, data: Array) -> None:
        """Other numbers for the kernels."""
        self._structure.data = self._array(np.asarray(data, float))


def _by_stage(phase: Phase, kind: int) -> list[list[Array]]:
    """Which rows of each stage are of a kind: of the path, then of conditions."""
    path = list((phase.path == kind).reshape(phase.intervals, -1)) + [np.zeros(0, bool)]
    found = [[own] for own in path]
    for (stage, _), rows in zip(phase.kernels.nodes, phase.conditions):
        found[stage].append(rows == kind)
    return found


def _numbered(phase: Phase, kind: int) -> tuple[Array, list[Array]]:
    """The number of each row within its stage among those of a kind, -1 where it is none."""
    stages = [np.concatenate(parts) for parts in _by_stage(phase, kind)]
    numbers = [np.where(own, np.cumsum(own) - 1, -1) for own in stages]
    width = phase.path[0].size
    path = np.stack([own[:width] for own in numbers[:-1]]).reshape(phase.path.shape)
    used, nodes = [width] * phase.intervals + [0], []
    for (stage, _), rows in zip(phase.kernels.nodes, phase.conditions):
        nodes.append(numbers[stage][used[stage] : used[stage] + len(rows)])
        used[stage] += len(rows)
    return path, nodes


def _codes(inequality: Array, equality: Array) -> Array:
    """Numbers among inequalities and among equalities as the core reads them."""
    return np.where(inequality >= 0, inequality, np.where(equality >= 0, -2 - equality, DROPPED)).astype(np.int32)


def _global(phase: Phase, places: list[Any], counts: list[Array]) -> tuple[Array, list[Array]]:
    """Numbers among the rows of all stages."""
    firsts = [np.cumsum(c) - c for c in counts]
    path, nodes = -np.ones(phase.path.shape, int), [-np.ones(len(own), int) for own in phase.conditions]
    for (of_path, of_nodes), first in zip(places, firsts):
        path = np.where(of_path >= 0, of_path + first[:-1, None, None], path)
        nodes = [
            np.where(own >= 0, own + first[stage], before)
            for own, before, (stage, _) in zip(of_nodes, nodes, phase.kernels.nodes)
        ]
    return path, nodes
