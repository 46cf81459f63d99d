"""A transcribed phase as constants of C99: a `twx_phase` with its arrays and kernels."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from ...scalar.targets.c import c_type
from ..kernels import SmoothKernels
from ..sources import constant
from ..structures import NodeStructure
from ..transcription import Transcription
from .kernel_code import NO_KERNEL, KernelCode, array

#: Arrays that a controller has in its own memory.
_OWN_MEMORY = ("data", "node_rows", "work", "scratch", "cost_slopes", "steps", "join", "window")

#: Intervals that the core has side by side.
LANES = constant("phase.h", "TWX_LANES")

#: The kernels of a `twx_smooth`.
_ORDERS = ("value", "slopes", "bends")


class PhaseCode:
    """The constants of a problem of one phase.

    Args:
        window: intervals that are evaluated together.

    Attributes:
        kernels: the functions.
        text: of the constants; the phase is called `phase_0`.
    """

    def __init__(self, transcription: Transcription, window: int) -> None:
        self.kernels = KernelCode()
        self._arrays, self._texts = transcription.arrays, list[str]()
        self._names = dict[int, str]()
        (phase,), (structure,) = transcription.phases, transcription.described
        fields = [self._field(structure, name) for name, _ in type(structure)._fields_ if name not in _OWN_MEMORY]
        kernels = phase.kernels
        fields.append(f".rate = {self._rate(kernels.rate)}")
        fields += [f".{name} = {self._smooth(getattr(kernels, name), name)}" for name in ("rows", "gap")]
        fields += [f".{name} = {self.kernels.structure(getattr(kernels, name), name)}" for name in ("retract", "turn")]
        places = {name: self._pointer(getattr(structure.at, name)) for name, _ in structure.at._fields_}
        offsets = ", ".join(f".{name} = {place}" for name, place in places.items())
        fields += [f".at = {{{offsets}}}", ".node = nodes_0", f".node_width = {structure.node_width}"]
        fields.append(f".window = {window}")
        nodes = self._nodes(structure, [function for _, function in kernels.nodes])
        body = ",\n    ".join(field for field in fields if field)
        self._texts += [nodes, f"static const twx_phase phase_0 = {{\n    {body}\n}};\n"]

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
            return f".{name} = {c_type(np.dtype(float)).literal(value)}"
        return f".{name} = {self._pointer(value)}" if kind is ctypes.c_void_p and name != "node" else ""

    def _pointer(self, address: int | None) -> str:
        if not address or not self._arrays[address].size:
            return "NULL"
        if address not in self._names:
            self._names[address] = f"array_{len(self._names)}"
            self._texts.append(array(self._names[address], self._arrays[address]))
        return self._names[address]

    def _rate(self, rate: SmoothKernels) -> str:
        kernels = {f"rate_{order}": kernel for order, kernel in zip(_ORDERS, rate.kernels)}
        parts, width = self.kernels.sharing(kernels)
        parts[-1:-1] = [NO_KERNEL] * (len(_ORDERS) + 1 - len(parts))
        return "{" + ", ".join([*parts, str(rate.rows), str(width)]) + "}"

    def _smooth(self, smooth: SmoothKernels, name: str) -> str:
        parts = [self.kernels.structure(k, f"{name}_{order}") for k, order in zip(smooth.kernels, _ORDERS)]
        parts += [NO_KERNEL] * (len(_ORDERS) + 1 - len(parts))
        return "{" + ", ".join([*parts, str(smooth.rows), "0"]) + "}"

    def _nodes(self, structure: ctypes.Structure, functions: list[SmoothKernels]) -> str:
        rows = []
        for k, function in enumerate(functions):
            node = self._node_of(structure, k)
            place, margins = (self._pointer(getattr(node, name)) for name in ("place", "margins"))
            rows.append(f"    {{{self._smooth(function, f'node_{k}')}, {node.stage}, {place}, {margins}}}")
        return "static const twx_node nodes_0[] = {\n" + ",\n".join(rows) + "\n};\n"

    @staticmethod
    def _node_of(structure: ctypes.Structure, k: int) -> ctypes.Structure:
        return NodeStructure.from_address(structure.node + k * ctypes.sizeof(NodeStructure))
