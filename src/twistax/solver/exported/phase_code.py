"""Transcribed phases as constants of C99: each a `twx_phase` with its arrays and kernels."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...scalar.targets.c import CType
from ..kernels import SmoothKernels
from ..sources import constant
from ..structures import JoinStructure, NodeStructure
from ..transcription import NONE, CorePhase, Transcription
from .kernel_code import NO_KERNEL, KernelCode, array
from .precision import CodePrecision

#: Arrays that a controller has in its own memory.
_OWN_MEMORY = ("data", "of_phase", "node_rows", "work", "scratch", "cost_slopes", "steps", "join", "window")

#: Intervals that the core has side by side.
LANES = constant("phase.h", "TWX_LANES")

#: Epsilons of a Newton step of an implicit method after which one more is exact to rounding.
_CLOSE = 1024.0

#: The kernels of a `twx_smooth`.
_ORDERS = ("value", "slopes", "bends")


class PhaseCode:
    """The constants of the phases of a problem.

    Args:
        real: the type of numbers.

    Attributes:
        kernels: the functions.
        shared_widths: of each phase, the number of elementary functions that the rate and its derivatives share.
        text: of the constants; the array of phases is called `phases`.
    """

    def __init__(self, transcription: Transcription, real: CType) -> None:
        self.kernels, self._real, self.shared_widths = KernelCode(real), real, list[int]()
        self._arrays, self._texts = transcription.arrays, list[str]()
        self._names, self._phases = dict[int, str](), transcription.phases
        bodies, self._operations = list[str](), list[dict[str, int]]()
        for k, structure in enumerate(transcription.described):
            before = len(self.kernels.operations)
            bodies.append(self._body(k, structure))
            self._operations.append(dict(list(self.kernels.operations.items())[before:]))
        self._texts.append("static const twx_phase phases[] = {\n" + ",\n".join(bodies) + "\n};\n")

    def _body(self, number: int, structure: Any) -> str:
        """The initialiser of a phase, after what it points to."""
        phase = self._phases[number]
        kernels = phase.kernels
        fields = [self._field(structure, name) for name, _ in type(structure)._fields_ if name not in _OWN_MEMORY]
        fields.append(f".rate = {self._rate(kernels.rate)}")
        fields += [f".{name} = {self._smooth(getattr(kernels, name), name)}" for name in ("rows", "gap")]
        fields += [f".{name} = {self.kernels.structure(getattr(kernels, name), name)}" for name in ("retract", "turn")]
        places = {name: self._pointer(getattr(structure.at, name)) for name, _ in structure.at._fields_}
        offsets = ", ".join(f".{name} = {place}" for name, place in places.items())
        fields += [f".at = {{{offsets}}}", f".node = nodes_{number}", f".node_width = {structure.node_width}"]
        self._texts.append(self._nodes(number, structure, [function for _, function in kernels.nodes]))
        if phase.join is not None:
            turn = self.kernels.structure(self._phases[number + 1].kernels.turn, "turn")
            free = self._pointer(JoinStructure.from_address(structure.join).free)
            gap = self._smooth(phase.join.gap, "join")
            self._texts.append(
                f"static const twx_join join_{number} = {{{gap}, {turn}, {len(phase.join.free)}, {free}}};\n"
            )
            fields.append(f".join = &join_{number}")
        return "  {" + ",\n    ".join(field for field in fields if field) + "}"

    def work(self, parameters: int) -> dict[str, int]:
        """The number of scalar operations of an iteration: those of the kernels, and those of matrix products from
        their sizes.
        """
        counts = [self._work_of(*of_phase, parameters) for of_phase in zip(self._phases, self._operations)]
        return {name: sum(count[name] for count in counts) for name in counts[0]}

    @staticmethod
    def _work_of(phase: CorePhase, operations: Mapping[str, int], p: int) -> dict[str, int]:
        method, K = phase.method, phase.intervals
        stages, evaluated = method.substeps * len(method.b), method.weights != 0
        evaluated[: method.substeps + 1] |= (phase.path != NONE).any(axis=(0, 2))
        points = int(np.count_nonzero(evaluated))

        def rows(name: str) -> int:
            at_once = 1 if "_node" in name or "_join" in name else K
            return at_once * (stages if "_rate" in name else points if "_rows" in name else 1)

        of_kernels = {name: count * rows(name) for name, count in operations.items()}
        values = sum(count for name, count in of_kernels.items() if not name.endswith(("slopes", "bends")))
        n, m = phase.n, phase.m
        size = n + m + p
        products = K * stages * (4 * n * n * size + 4 * size * size * n)
        riccati = (K + 1) * (2 * n * n * size + 2 * n * size * size + m**3 + 2 * m * size * size)
        every = [phase.path, *phase.conditions]
        riccati += 2 * size * size * sum(int((kinds != NONE).sum()) for kinds in every)
        return {"functions": sum(of_kernels.values()) + products, "trial": values, "riccati": riccati}

    @property
    def text(self) -> str:
        return "\n".join([self.kernels.text, *self._texts])

    def _field(self, structure: ctypes.Structure, name: str) -> str:
        """A number or an array; nothing for what is no plain field."""
        kinds: Any = type(structure)._fields_
        kind, value = dict(kinds)[name], getattr(structure, name)
        if kind in (ctypes.c_int32, ctypes.c_int64):
            return "" if name == "node_width" else f".{name} = {value}"
        if kind is ctypes.c_double:
            return f".{name} = {self._real.literal(CodePrecision(self._real).at_least(value, _CLOSE))}"
        return f".{name} = {self._pointer(value)}" if kind is ctypes.c_void_p and name != "node" else ""

    def _pointer(self, address: int | None) -> str:
        if not address or not self._arrays[address].size:
            return "NULL"
        if address not in self._names:
            self._names[address] = f"array_{len(self._names)}"
            self._texts.append(array(self._names[address], self._arrays[address], self._real))
        return self._names[address]

    def _rate(self, rate: SmoothKernels) -> str:
        kernels = {f"rate_{order}": kernel for order, kernel in zip(_ORDERS, rate.kernels)}
        parts, width = self.kernels.sharing(kernels)
        self.shared_widths.append(width)
        parts[-1:-1] = [NO_KERNEL] * (len(_ORDERS) + 1 - len(parts))
        return "{" + ", ".join([*parts, str(rate.rows), str(width)]) + "}"

    def _smooth(self, smooth: SmoothKernels, name: str) -> str:
        parts = [self.kernels.structure(k, f"{name}_{order}") for k, order in zip(smooth.kernels, _ORDERS)]
        parts += [NO_KERNEL] * (len(_ORDERS) + 1 - len(parts))
        return "{" + ", ".join([*parts, str(smooth.rows), "0"]) + "}"

    def _nodes(self, number: int, structure: ctypes.Structure, functions: list[SmoothKernels]) -> str:
        rows = []
        for k, function in enumerate(functions):
            node = self._node_of(structure, k)
            place, margins = (self._pointer(getattr(node, name)) for name in ("place", "margins"))
            rows.append(f"    {{{self._smooth(function, f'node_{k}')}, {node.stage}, {place}, {margins}}}")
        return f"static const twx_node nodes_{number}[] = {{\n" + ",\n".join(rows) + "\n};\n"

    @staticmethod
    def _node_of(structure: ctypes.Structure, k: int) -> ctypes.Structure:
        return NodeStructure.from_address(structure.node + k * ctypes.sizeof(NodeStructure))
