"""The scales that leaves declare."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from ..expr import Control, State
from ..groups import Euclidean

#: A turn, in rad, after which a rotation's tangent space looks different.
_TURN = 0.5


def declared(leaves: Sequence[State | Control]) -> Array:
    """The scales that leaves declare, of all their tangents in one vector; 1, and half a radian, where they do not."""
    parts = [np.zeros(0)]
    for leaf in leaves:
        group = leaf.group if isinstance(leaf, State) else Euclidean(leaf.shape)
        plain = np.where(group.sized | group.flat, 1.0, _TURN)
        parts.append(plain if leaf.scale is None else np.ravel(leaf.scale))
    return np.concatenate(parts)
