"""The mesh of a trajectory: the positions of its nodes in time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...checks import reals, short, whole
from ...errors import TrajectoryError

if TYPE_CHECKING:
    from .methods import Collocation, MultipleShooting


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """The times of the nodes, as fractions of the duration of the trajectory.

    Args:
        nodes: the number of nodes, for intervals of equal length; or an increasing sequence of fractions from 0 to 1.
        free: whether interval lengths are unknowns, which is useful for controls that jump at unknown times. True, or
            limits (low, high) of the lengths as multiples of those in `nodes`; True means (0.01, inf).

    Attributes:
        shares: (nodes,).
        free: the limits of interval lengths; None for fixed nodes.

    Raises:
        TrajectoryError: fewer than two nodes; fractions that do not increase from 0 to 1; limits that do not contain 1.
    """

    shares: Array
    free: tuple[float, float] | None

    def __init__(self, nodes: Any, *, free: Any = False) -> None:
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
                    "nodes expects a whole number of 2 or more, or increasing fractions of the final time from 0 to 1, "
                    f"got {short(nodes)}; e.g. nodes=[0.0, 0.1, 0.4, 1.0]"
                )
        shares.setflags(write=False)
        object.__setattr__(self, "shares", shares)
        object.__setattr__(self, "free", _limits(free))

    @property
    def nodes(self) -> int:
        """The number of nodes."""
        return len(self.shares)

    @property
    def is_even(self) -> bool:
        """Whether all intervals have equal length."""
        return self.free is None and bool(np.allclose(self.widths, 1.0 / len(self.widths), rtol=1e-9, atol=0.0))

    @property
    def widths(self) -> Array:
        """(nodes - 1,) the lengths of the intervals, as fractions of the duration."""
        return np.diff(self.shares)


def _limits(free: Any) -> tuple[float, float] | None:
    if isinstance(free, (bool, np.bool_)):
        return (0.01, np.inf) if free else None
    limits = reals("Mesh: free", free, TrajectoryError)
    if limits.shape != (2,) or not 0.0 < limits[0] < 1.0 < limits[1]:
        raise TrajectoryError(f"Mesh: free expects True, False or limits 0 < low < 1 < high, got {short(free)}")
    return float(limits[0]), float(limits[1])


def mesh_of(nodes: Any) -> Mesh:
    """The argument itself if it is a mesh; else the mesh with this number of nodes, or with
    nodes at these fractions.
    """
    return nodes if isinstance(nodes, Mesh) else Mesh(nodes)


class Remeshed(NamedTuple):
    """The properties of a problem of one phase, or of a phase, that change with the mesh; `numbers` are the new node
    indices.
    """

    mesh: Mesh
    transcription: MultipleShooting | Collocation
    numbers: Array

    def stated(self, at: Mapping[int, Any] | None) -> dict[str, Any]:
        """The arguments of its statement on the new mesh, from conditions at inner nodes; without a guess."""
        return {
            "nodes": self.mesh,
            "transcription": self.transcription,
            "at": None if at is None else {int(self.numbers[k]): constraints for k, constraints in at.items()},
            **dict.fromkeys(("method", "substeps", "guess")),
        }
