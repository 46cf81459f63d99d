"""Where the nodes of a trajectory lie in time."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..checks import reals, short, whole
from ..errors import TrajectoryError


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """The times of the nodes, as shares of how long the trajectory takes.

    Args:
        nodes: their number, for intervals of equal length, or an increasing sequence of shares from 0 to 1.

    Attributes:
        shares: (nodes,).

    Raises:
        TrajectoryError: fewer than two nodes; shares that do not increase from 0 to 1.
    """

    shares: Array

    def __init__(self, nodes: Any) -> None:
        if np.ndim(nodes) == 0:
            whole("nodes", nodes, 2, TrajectoryError)
            shares = np.linspace(0.0, 1.0, int(nodes))
        else:
            shares = reals("nodes", nodes, TrajectoryError)
            if (
                shares.ndim != 1
                or len(shares) < 2
                or not (np.diff(shares) > 0.0).all()
                or (shares[[0, -1]] != (0, 1)).any()
            ):
                raise TrajectoryError(
                    "nodes expects a whole number of 2 or more, or shares of the final time that increase from 0 to 1, "
                    f"got {short(nodes)}; e.g. nodes=[0.0, 0.1, 0.4, 1.0]"
                )
        shares.setflags(write=False)
        object.__setattr__(self, "shares", shares)

    @property
    def nodes(self) -> int:
        """How many."""
        return len(self.shares)

    @property
    def is_even(self) -> bool:
        """Whether all intervals are equally long."""
        return bool(np.allclose(self.widths, 1.0 / len(self.widths), rtol=1e-9, atol=0.0))

    @property
    def widths(self) -> Array:
        """(nodes - 1,) of the intervals."""
        return np.diff(self.shares)


def mesh_of(nodes: Any) -> Mesh:
    """The mesh that was given, or that of so many nodes, or with nodes at these shares."""
    return nodes if isinstance(nodes, Mesh) else Mesh(nodes)
