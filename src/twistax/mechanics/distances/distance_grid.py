"""Signed distances on a grid."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...expr import Dot, Expr, Max, Min, Sqrt, Where
from ...expr.lie import Act
from ...expr.tables.interpolation import Interp
from ...expr.tables.kinds import BSpline
from ..arguments import pose


@dataclasses.dataclass(frozen=True, eq=False)
class DistanceGrid:
    r"""Signed distances of a solid at the points of a grid, such as those of a scanned room.

    Between points, `tx.tables.BSpline()` gives two continuous derivatives. The error of `tx.tables.Linear()` is at most
    half of the diagonal of a cell, $|h| / 2$, because the gradient of a distance has at most the length 1.

    Outside of the grid, at a distance r from the nearest point of its border, where the value is $\phi$, the value is
    $\sqrt{\phi^2 + r^2}$ if $\phi \ge 0$, and otherwise $\phi + r$. It is continuous and increases with r, so that
    an optimiser that starts there has a gradient. The gradient is discontinuous at the border. If $\phi \ge 0$,
    it is a lower bound of the distance to a solid within the grid, up to the error of the interpolation, because the
    grid is convex.

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
        value = Interp(p[0], p[1], p[2], axes=list(self.axes), values=self.values, kind=self.kind)
        low, high = (np.array([float(axis[k]) for axis in self.axes]) for k in (0, -1))
        beyond = p - Max(low, Min(p, high))
        square = Dot(beyond, beyond)
        outside = square > 0.0
        r, away = Sqrt(Where(outside, square, 1.0)), Where(value > 0.0, value, 0.0)
        return Where(outside, Where(value > 0.0, Sqrt(away * away + r * r), value + r), value)
