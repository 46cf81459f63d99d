"""Free parameters, which are unknowns of a problem, with their limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..checks import listed, short
from ..errors import ModelError
from ..expr import Control, Parameter
from ..system import name_of


def limits_of(box: Control) -> np.ndarray:
    """(entries, 2) the limits of a leaf, infinite for no limit."""
    ends = [np.full(box.shape, far) if end is None else end for end, far in ((box.min, -np.inf), (box.max, np.inf))]
    return np.stack([np.ravel(end) for end in ends], axis=1)


def boxes_of(free: Any, parameters: Iterable[Parameter], baked: Iterable[str]) -> tuple[Control, ...]:
    """The free parameters with their limits, from `free={parameter or name: (low, high)}`.

    Raises:
        ModelError: an object that is not a parameter of the problem, or that is a constant of the compiled system;
            limits that are not a pair, or low above high.
        ShapeError: limits that cannot be broadcast to the parameter's shape.
    """
    if isinstance(free, (list, tuple)):
        free = dict.fromkeys(free, (None, None))
    if free is not None and not isinstance(free, Mapping):
        raise ModelError(
            f"free must be a dict from parameters to limits (low, high) or a list of parameters, got {short(free)}; "
            "e.g. free={'mass': (1.0, 3.0)}"
        )
    known, gone, boxes = {leaf.name: leaf for leaf in parameters}, set(baked), []
    for key, limits in (free or {}).items():
        name = name_of(key)
        if name in gone:
            raise ModelError(
                f"free names the parameter {name!r}, which is a constant of the compiled dynamics.\n"
                "  fix: leave it out of bake="
            )
        if name not in known or not isinstance(key, (str, Parameter)):
            raise ModelError(f"free names {name!r}, but the problem reads the parameters: {listed(known, name)}")
        if not isinstance(limits, (tuple, list)) or len(limits) != 2:
            raise ModelError(f"free[{name!r}] expects limits (low, high), got {short(limits)}")
        low, high = limits
        try:
            boxes.append(Control(name, known[name].shape, min=low, max=high))
        except ModelError as error:
            raise ModelError(f"free: {error}") from None
    return tuple(boxes)
