"""Solids as a core with a radius: all points within the radius of a point, a segment or a box."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import short
from ...errors import ModelError
from ...view import Box, Capsule, Sphere
from ..arguments import pose


@dataclasses.dataclass(frozen=True)
class HalfSpace:
    """All points below a plane, such as the ground: $z < 0$, in m, in the frame of the plane.

    Attributes:
        at: pose T (4, 4) of the plane in the frame of its body; the identity by default.
    Raises: ModelError, ShapeError if `at` is not a pose of numbers.
    """

    at: Any = dataclasses.field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", np.asarray(getattr(pose("HalfSpace", "at", self.at), "value", self.at)))


@dataclasses.dataclass(frozen=True)
class Rounded:
    """A core with a radius. Its half lengths are along x, y and z of its frame; they are zero for a point, and across a
    segment.

    Attributes:
        at: pose T (4, 4) of the core in the frame of the body.
        half: half lengths (3,), m.
        radius: m.
    """

    at: NDArray[np.float64]
    half: NDArray[np.float64]
    radius: float

    @property
    def directions(self) -> list[int]:
        """The axes along which the core has edges."""
        return [int(i) for i in np.flatnonzero(self.half)]

    @property
    def corners(self) -> NDArray[np.float64]:
        """The corners (k, 3) of the core."""
        ends = [(-h, h) if h else (0.0,) for h in self.half]
        return np.array(list(itertools.product(*ends)))

    def edges(self, i: int) -> NDArray[np.float64]:
        """The centres (k, 3) of the edges along an axis."""
        corners = self.corners
        return np.unique(np.where(np.arange(3) == i, 0.0, corners), axis=0)


def rounded(owner: str, shape: Any) -> Rounded:
    """A shape as a core with a radius. Raises ModelError for other shapes."""
    if isinstance(shape, Sphere):
        return Rounded(shape.at, np.zeros(3), float(shape.radius))
    if isinstance(shape, Capsule):
        return Rounded(shape.at, np.array([0.0, 0.0, 0.5 * shape.length]), float(shape.radius))
    if isinstance(shape, Box):
        return Rounded(shape.at, 0.5 * np.asarray(shape.lengths), 0.0)
    raise ModelError(
        f"{owner} expects a Sphere, Capsule, Box or Cylinder of tx.view, or a HalfSpace, got {short(shape)}"
    )
