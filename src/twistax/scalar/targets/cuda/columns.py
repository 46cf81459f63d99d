"""Large programs as several kernels, each for some columns of the results.

A whole Jacobian in one thread needs more registers than there are, so values are spilled to memory. Its columns share
little except the function itself, which each kernel computes again.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from ...program import Rows, ScalarProgram

#: Operations in a kernel; how many times the operations of the program all its kernels may have together. For the
#: Jacobian of an arm's accelerations on an H100 (docs/report/gpu.md) 2,600 take longer in single precision, and are a
#: tenth faster in double; 6,000 are slower in both. A gradient by the reverse mode shares nearly all of its operations.
MOST_OPERATIONS, MOST_REPEATED = 4000, 1.5


def parts(program: ScalarProgram) -> list[ScalarProgram]:
    """Programs that compute some columns of the results each, in order; the program itself if splitting gives no
    speed-up.
    """
    if program.operations <= MOST_OPERATIONS or not all(nodes.ndim for nodes in program.outputs):
        return [program]
    programs = list[ScalarProgram]()
    widths = [nodes.shape[-1] for nodes in program.outputs]
    columns = [(k, j) for k, width in enumerate(widths) for j in range(width)]
    while columns:
        count = 1
        part = _of_columns(program, columns[:1])
        while count < len(columns):
            wider = _of_columns(program, columns[: count + 1])
            if wider.operations > MOST_OPERATIONS:
                break
            part, count = wider, count + 1
        programs.append(part)
        columns = columns[count:]
    repeated = sum(part.operations for part in programs) / program.operations
    return programs if repeated <= MOST_REPEATED else [program]


def _of_columns(program: ScalarProgram, columns: Sequence[tuple[int, int]]) -> ScalarProgram:
    """Neighbouring columns (result, number); of other results none."""
    taken: list[list[int]] = [[j for k, j in columns if k == result] for result in range(len(program.outputs))]
    return program.restricted([nodes[..., js] for nodes, js in zip(program.outputs, taken, strict=True)])


def joined(kernels: Sequence[Rows]) -> Rows:
    """The kernels of all parts as one."""

    def run(rows: int, *arguments: jax.Array) -> list[jax.Array]:
        results = [kernel(rows, *arguments) for kernel in kernels]
        return [jnp.concatenate(pieces, -1) for pieces in zip(*results, strict=True)]

    return run
