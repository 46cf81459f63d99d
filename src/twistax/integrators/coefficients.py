"""The numbers of a method, checked when it is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError

__all__ = ["coefficients"]


def coefficients(field: str, given: Any, error: Callable[[str], ModelError]) -> NDArray[Any]:
    """Finite numbers as a read-only array in double precision; raises what `error` makes of a sentence."""
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as wrong:
        raise error(f"{field} is not an array of numbers: {wrong}") from None
    if not np.isfinite(array).all():
        raise error(f"{field} has entries that are not finite")
    array.setflags(write=False)
    return array
