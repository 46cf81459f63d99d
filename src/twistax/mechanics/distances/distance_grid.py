"""Signed distances on a grid."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...expr import Expr
from ...expr.lie import Act
from ...expr.tables.interpolation import Interp
from ...expr.tables.kinds import BSpline
from ..arguments import pose


@dataclasses.dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances of a solid at the points of a grid, such as those of a scanned room.

    Between points, `tx.tables.BSpline()` gives two continuous derivatives. The error of `tx.tables.Linear()` is at most
    half of the diagonal of a cell, $|h| / 2$, because the gradient of a distance has at most the length 1. Outside of
    the grid the value is that of the nearest point on its border.

    Attributes:
        axes: three arrays of coordinates, increasing, m, in the frame of the grid.
        values: signed distances (nx, ny, nz), m; negative inside the solid.
        kind: the interpolation.
        at: pose T (4, 4) of the grid in the frame of its body; the identity by default.
    Raises: ModelError for values of the wrong shape, and for numbers that are not a pose.
    """

    axes: Any
    values: Any
    kind: Any = dataclasses.field(default_factory=BSpline)
    at: Any = dataclasses.field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        T = pose("DistanceGrid", "at", self.at)
        object.__setattr__(self, "at", np.asarray(getattr(T, "value", self.at)))
        self.value(np.zeros(3))

    def value(self, point: Any) -> Expr:
        """The signed distance () of a point (3,) in the frame of the body, m."""
        p = Act(np.linalg.inv(self.at), point)
        return Interp(p[0], p[1], p[2], axes=list(self.axes), values=self.values, kind=self.kind)
