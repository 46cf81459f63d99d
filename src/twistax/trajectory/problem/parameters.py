"""Parameter values of a problem, with checks."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ...checks import listed, reals, short
from ...errors import InputError, ModelError, ShapeError
from ...expr import Control, Parameter
from .by_node import ByNode
from .guess import control_guess
from .stated_phase import StatedPhase


def parameters_of(parts: Sequence[StatedPhase], names: Sequence[str], params: Collection[str]) -> dict[str, Parameter]:
    """The parameters of all phases by name.

    Raises:
        ModelError: a parameter has different values in two phases, and `params` has none.
    """
    leaves: dict[str, Parameter] = {}
    for part, phase in zip(parts, names):
        for name, leaf in part.parameters.items():
            known = leaves.setdefault(name, leaf)
            if name not in params and not _is_same(known.value, leaf.value):
                raise ModelError(
                    f"the parameter {name!r} has different values in {phase!r} and in an earlier phase.\n"
                    f"  fix: pass params={{{name!r}: ...}}, or give it another name"
                )
    return leaves


def _is_same(a: Array | None, b: Array | None) -> bool:
    return a is b if a is None or b is None else bool(np.array_equal(a, b))


def parameter_values(
    leaves: Mapping[str, Parameter],
    read: Collection[str],
    boxes: Sequence[Control],
    by_nodes: Sequence[ByNode],
    params: Mapping[str, Any],
) -> dict[str, Array]:
    """Values of all parameters: those in `params`, else the declared values. A free parameter without a value starts at
    the middle of its limits.

    Args:
        read: names of those that the problem reads.
        boxes: limits of the free parameters.
        by_nodes: the `ByNode` of each phase.

    Raises:
        InputError: an unknown name; a parameter that is read and has no value; values that are not finite.
        ShapeError: a value of another shape.
    """
    for name in params:
        if name not in leaves:
            raise InputError(f"unknown key {name!r} in params; expected: {listed(leaves, name)}")
    middle = {box.name: control_guess(box, None, 1)[0] for box in boxes}
    values = {}
    for name, leaf in leaves.items():
        value = params.get(name, leaf.value)
        value = middle.get(name) if value is None else value
        if value is None:
            if name in read:
                raise InputError(
                    f"the problem reads the parameter {name!r}, which has no value; pass params={{{name!r}: ...}}"
                )
            continue
        by_node = next((candidate for candidate in by_nodes if name in candidate.leaves), None)
        if by_node is not None:
            values[name] = by_node.values(name, value)
            continue
        values[name] = reals(f"params[{name!r}]", value, InputError)
        if values[name].shape != leaf.shape:
            raise ShapeError(f"params[{name!r}] expects shape {leaf.shape}, got {values[name].shape}")
        if not np.isfinite(values[name]).all():
            raise InputError(f"params[{name!r}] expects finite numbers, got {short(values[name].tolist())}")
    return values
