"""Solids as a core with a radius: all points within the radius of a point, a segment or a box."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import short
from ...errors import ModelError
from ...view import Box, Capsule, Sphere
from ..arguments import pose

#: Of differences of unit vectors that count as zero.
_SMALL = 1e-10


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


@dataclasses.dataclass(frozen=True, eq=False)
class Core:
    """A point, a segment or a polytope with a radius, as arrays.

    Attributes:
        at: pose T (4, 4) in the frame of the body.
        corners: (v, 3).
        edges: (e, 2, 3): both ends of each.
        sides: (e, 2, 3): the outward normals of the two faces that meet there; zero if there are none.
        faces: (f, 3, 3): corners of triangles.
        normals, offsets, planes: outward normals (g, 3) of faces, each direction once; (g,) with $n . p = offset$ on
            the face; (g, 3, 3) the corners of one of its triangles.
        radius: m.
    """

    at: NDArray[np.float64]
    corners: NDArray[np.float64]
    edges: NDArray[np.float64]
    sides: NDArray[np.float64]
    faces: NDArray[np.float64]
    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    planes: NDArray[np.float64]
    radius: float

    @classmethod
    def point(cls, p: NDArray[np.float64], at: Any = None, radius: float = 0.0) -> Core:
        """A point."""
        at, vectors, pairs, triangles = (
            np.eye(4) if at is None else at,
            *(np.zeros((0, *n, 3)) for n in ((), (2,), (3,))),
        )
        return cls(at, p[None], pairs, pairs, triangles, vectors, np.zeros(0), triangles, radius)

    @classmethod
    def of_hull(cls, hull: Any, at: NDArray[np.float64], radius: float) -> Core:
        """The core of a `scipy.spatial.ConvexHull`, without edges within a face."""
        points, triangles, planes = hull.points, hull.simplices, hull.equations
        edges, sides = [], []
        for i, near in enumerate(hull.neighbors):
            for k, j in enumerate(near):  # the neighbour opposite to corner k
                if i < j and np.abs(planes[i] - planes[j])[:3].max() > _SMALL:
                    edges.append(points[np.delete(triangles[i], k)])
                    sides.append(planes[[i, j], :3])
        kept: list[int] = []
        for i, plane in enumerate(planes):
            if not any(np.abs(plane[:3] - planes[j, :3]).max() < _SMALL for j in kept):
                kept.append(i)
        corners = points[np.sort(hull.vertices)]
        faces = points[triangles]
        normals, offsets = planes[kept, :3], -planes[kept, 3]
        return cls(at, corners, np.array(edges), np.array(sides), faces, normals, offsets, faces[kept], radius)

    @functools.cached_property
    def directions(self) -> NDArray[np.float64]:
        """The unit vectors (e, 3) along edges, in the sense of the product of the second and the first side."""
        d = self.edges[:, 1] - self.edges[:, 0]
        d = d / np.linalg.norm(d, axis=1)[:, None]
        turn = np.sum(d * np.cross(self.sides[:, 1], self.sides[:, 0]), axis=1)
        return np.asarray(d * np.where(turn < 0.0, -1.0, 1.0)[:, None])

    @functools.cached_property
    def face_normals(self) -> NDArray[np.float64]:
        """The outward normals (f, 3) of the triangles."""
        corner, u, v = self.faces[:, 0], *(self.faces[:, k] - self.faces[:, 0] for k in (1, 2))
        n = np.cross(u, v)
        # Corners of triangles are in any order: outward is away from the mean of all.
        n = n * np.sign(np.sum(n * (corner - self.corners.mean(axis=0)), axis=1))[:, None]
        return np.asarray(n / np.linalg.norm(n, axis=1)[:, None])

    @functools.cached_property
    def face_offsets(self) -> NDArray[np.float64]:
        """(f,) with $n . p = offset$ on each triangle."""
        return np.asarray(np.sum(self.face_normals * self.faces[:, 0], axis=1))

    @functools.cached_property
    def face_duals(self) -> NDArray[np.float64]:
        """Vectors (f, 2, 3) whose products with p - c_0 are s and t of p = c_0 + s (c_1 - c_0) + t (c_2 - c_0), for
        the corners c of each triangle.
        """
        u, v = (self.faces[:, k] - self.faces[:, 0] for k in (1, 2))
        n = np.cross(u, v)
        size = np.sum(n**2, axis=1)[:, None]
        return np.stack([np.cross(v, n) / size, np.cross(n, u) / size], axis=1)


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
