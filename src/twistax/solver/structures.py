"""The structures of `transcription.h`."""

from __future__ import annotations

import ctypes

from .kernels import KernelStructure, SmoothStructure


class NodeStructure(ctypes.Structure):
    _fields_ = [
        ("function", SmoothStructure),
        ("stage", ctypes.c_int32),
        ("place", ctypes.c_void_p),
        ("margins", ctypes.c_void_p),
    ]


class JoinStructure(ctypes.Structure):
    _fields_ = [
        ("function", SmoothStructure),
        ("turn", KernelStructure),
        ("free_count", ctypes.c_int32),
        ("free", ctypes.c_void_p),
    ]


_OFFSETS = ("z", "v", "c", "h", "e", "F", "Jh", "Je", "H")


class OffsetsStructure(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in (*_OFFSETS, "inequalities", "equalities")]


_COUNTS = ("n", "m", "p", "point", "intervals", "substeps", "stages", "implicit", "path_rows", "nodes", "iterations")
_ARRAYS = ("a", "b", "c", "weights", "starts", "widths", "data", "of_phase", "node_rows")


class PhaseStructure(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int32) for name in _COUNTS),
        ("close", ctypes.c_double),
        ("parameters_z", ctypes.c_int64),
        ("parameters_v", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
        ("node_width", ctypes.c_int32),
        *((name, ctypes.c_void_p) for name in ("place", "margins", "steps")),
        ("at", OffsetsStructure),
        *((name, SmoothStructure) for name in ("rate", "rows", "gap")),
        *((name, KernelStructure) for name in ("retract", "turn")),
        ("node", ctypes.c_void_p),
        ("join", ctypes.c_void_p),
        ("window", ctypes.c_int32),
        *((name, ctypes.c_void_p) for name in ("cost_slopes", "work", "scratch")),
    ]


class TranscriptionStructure(ctypes.Structure):
    """`twx_transcription`."""

    _fields_ = [("phases", ctypes.c_int32), ("phase", ctypes.c_void_p)]
