"""Scalar programs worked out by NumPy, operation by operation: what kernels are checked against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scalar.program import ScalarProgram

__all__ = ["work_out"]


def work_out(program: ScalarProgram, arguments: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
    """The results for rows of arguments, (rows, entries) each; the program calls no functions."""
    g = program.graph
    count = len(arguments[0]) if arguments else 1
    values: dict[int, NDArray[Any]] = {}
    with np.errstate(all="ignore"):
        for i in program.live:
            place, operation = g.input_of(i), g.operation(i)
            if place is not None:
                values[i] = arguments[place[0]][:, place[1]]
            elif operation is None:
                values[i] = np.full(count, g.numbers[i], g.dtypes[i])
            else:
                values[i] = np.asarray(operation.number(*(values[a] for a in g.arguments(i)))).astype(g.dtypes[i])
    return [
        np.stack([values[i] for i in nodes.reshape(-1).tolist()], 1) if nodes.size else np.zeros((count, 0), dtype)
        for nodes, dtype in zip(program.outputs, program.types, strict=True)
    ]
