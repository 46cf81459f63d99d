"""Scalar programs of one operation each, and processors to write kernels for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from twistax.scalar.graph import ScalarGraph
from twistax.scalar.program import ScalarProgram
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import Processor
from twistax.scalar.targets.llvm.straight.body import Straight

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")


def program_of(operations: Sequence[Any], dtype: Any, arguments: int) -> ScalarProgram:
    """All operations on the same scalars, each argument one entry; the results in one row for each type."""
    dtype = np.dtype(dtype)
    real = dtype if dtype.kind == "f" else np.dtype(np.float64)
    graph = ScalarGraph(real, checked=True)
    nodes = [graph.input(k, 0, dtype) for k in range(arguments)]
    found = [graph.node(operation, *nodes) for operation in operations]
    outputs = tuple(np.array([i], np.int64) for i in found)
    return ScalarProgram(
        graph, tuple(np.array([i], np.int64) for i in nodes), outputs, tuple(graph.dtypes[i] for i in found)
    )


def run(program: ScalarProgram, processor: Processor, *columns: Any) -> list[np.ndarray]:
    """The results, one column each."""
    form = native_form(program)
    kernel = HostKernel(Straight(form, processor.lanes(form.graph.dtype)), processor)
    rows = np.broadcast_arrays(*columns)
    return [r[:, 0] for r in kernel.run([rows[k].reshape(-1, 1) for k in kernel.body.read])]


#: Every vector that this machine has: SSE2, AVX2, AVX-512.
PROCESSORS = [Processor.host(bits) for bits in Processor.widths()]
at_every_width = pytest.mark.parametrize("processor", PROCESSORS, ids=lambda p: f"{p.bits} bits")


def processors() -> list[Processor]:
    """These, and the narrowest with fused products, as ARM has it."""
    return [*PROCESSORS, dataclasses.replace(PROCESSORS[-1], bits=128, masks=False)]
