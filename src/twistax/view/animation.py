"""A scene as numbers: the objects and their motion. `stage.py` draws it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy import ndarray as Array

from ..checks import number, reals, short
from ..errors import InputError
from .shapes import Color, Shape

A = TypeVar("A", bound="Animation")

ORANGE: Color = (242, 140, 40)

#: Pictures a second, and the bounds of the default duration of an animation, in s.
RATE = 30
_SHORTEST, _LONGEST = 2.0, 20.0

#: The default length of the longest arrow, as a share of the size of the scene.
_LONG = 0.2

#: The width of the view of a body that the camera follows, in lengths of the body.
_LENGTHS = 4.0


@dataclasses.dataclass(frozen=True, eq=False)
class Body:
    """A moving body, with the shapes that are fixed to it.

    Attributes:
        name: the name of the state, or of the frame of a mechanism.
        poses: T (n, 4, 4) in the world at the times of the scene; positions in m.
        shapes: shapes in its axes.
        axes: whether x (red), y (green) and z (blue) are drawn.
        trail: whether the path of its origin is drawn.
    """

    name: str
    poses: Array
    shapes: tuple[Shape, ...] = ()
    axes: bool = True
    trail: bool = True


@dataclasses.dataclass(frozen=True, eq=False)
class Arrow:
    """The style of a vector: `solution.show(arrows={"T": tx.view.Arrow("g", at=engine)})`.

    A value (3,) is one arrow. A value (6,) is a wrench [f; tau] or a twist [v; w], and is drawn as two arrows.

    Attributes:
        on: the name of the body, or of the frame of a mechanism, from which it starts; optional for a single body.
        at: (3,) its start, in the axes of the body, m.
        world: whether the vector is in world axes; by default it is in those of the body.
        scale: metres per unit of the vector, also for a torque; a negative one reverses it. By default the largest
            vector along the motion is a fifth of the scene.
        color: red, green and blue from 0 to 255. A torque is drawn darker.
    Raises: InputError for a start that is not a point, or a scale that is zero.
    """

    on: str | None = None
    at: Any = (0.0, 0.0, 0.0)
    world: bool = False
    scale: float | None = None
    color: Color = ORANGE

    def __post_init__(self) -> None:
        at = reals("Arrow: at", self.at, InputError)
        if at.shape != (3,) or not np.isfinite(at).all():
            raise InputError(f"Arrow expects at to be a point (3,), got {short(self.at)}")
        object.__setattr__(self, "at", at)
        if self.scale is not None:
            number("Arrow: scale", self.scale, "a number other than 0", lambda x: np.isfinite(x) and x != 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Vector:
    """A vector along the motion: (n, 3) values, the body from which they start, and their style."""

    name: str
    body: Body
    values: Array
    looks: Arrow
    color: Color

    def ends(self, scale: float) -> Array:
        """Its start and end (n, 2, 3), in the world."""
        R, p = self.body.poses[:, :3, :3], self.body.poses[:, :3, 3]
        values = self.values if self.looks.world else np.einsum("nij,nj->ni", R, self.values)
        start = p + R @ self.looks.at
        return np.stack([start, start + scale * values], axis=1)


def _ends(shape: Shape) -> Array:
    """The corners (8, 3) of the box about a shape, in the axes of its body."""
    corners = shape.mesh()[0]
    sides = np.stack([corners.min(axis=0), corners.max(axis=0)])
    box = np.array([[sides[i, 0], sides[j, 1], sides[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return box @ shape.at[:3, :3].T + shape.at[:3, 3]


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """The objects of a scene over time, as numbers; the attributes are those of `Scene`."""

    ts: Array
    bodies: tuple[Body, ...]
    vectors: tuple[Vector, ...] = ()
    shapes: tuple[Shape, ...] = ()
    up: Sequence[float] | Array = (0.0, 0.0, 1.0)
    seconds: float | None = None
    follow: str | None = None
    caption: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    ground: bool = True

    @property
    def duration(self) -> float:
        """The duration of the animation, s."""
        return float(np.clip(self.ts[-1] - self.ts[0], _SHORTEST, _LONGEST) if self.seconds is None else self.seconds)

    @property
    def followed(self) -> Body | None:
        """The body at the centre of the picture."""
        return next((body for body in self.bodies if body.name == self.follow), None)

    @property
    def view_size(self) -> float:
        """The length that fills the picture, m: that of the whole scene, or some lengths of the followed body."""
        body = self.followed
        if body is None or not body.shapes:
            return self.size if body is None else 0.2 * self.size
        corners = np.concatenate([_ends(shape) for shape in body.shapes])
        return min(self.size, _LENGTHS * float(np.linalg.norm(np.ptp(corners, axis=0))))

    def extent(self) -> Array:
        """The smallest and largest coordinates (2, 3) of everything that is drawn except arrows, m."""
        low, high = [], []
        for body in self.bodies:
            ends = np.concatenate([np.zeros((1, 3)), *(_ends(shape) for shape in body.shapes)])
            corners = body.poses[:, None, :3, 3] + np.einsum("nij,kj->nki", body.poses[:, :3, :3], ends)
            low.append(corners.min(axis=(0, 1)))
            high.append(corners.max(axis=(0, 1)))
        for shape in self.shapes:
            low.append(shape.corners().min(axis=0))
            high.append(shape.corners().max(axis=0))
        return np.array([np.min(low, axis=0), np.max(high, axis=0)])

    @property
    def size(self) -> float:
        """The diagonal of the extent, m; 1 if the extent is a point."""
        low, high = self.extent()
        return float(np.linalg.norm(high - low)) or 1.0

    def scale_of(self, vector: Vector) -> float:
        """The scale of a vector: metres per unit."""
        if vector.looks.scale is not None:
            return float(vector.looks.scale)
        return _LONG * self.size / (float(np.linalg.norm(vector.values, axis=1).max()) or 1.0)

    def at(self: A, times: Array) -> A:
        """The scene at other times within its own.

        Between two saved times, positions and vectors are interpolated linearly, and rotations about a fixed axis.
        """
        from scipy.spatial.transform import Rotation, Slerp

        def line(values: Array) -> Array:
            return np.stack([np.interp(times, self.ts, column) for column in values.T], axis=1)

        moved = {}
        for body in self.bodies:
            poses = np.tile(np.eye(4), (len(times), 1, 1))
            poses[:, :3, :3] = Slerp(self.ts, Rotation.from_matrix(body.poses[:, :3, :3]))(times).as_matrix()
            poses[:, :3, 3] = line(body.poses[:, :3, 3])
            moved[body.name] = dataclasses.replace(body, poses=poses)
        # An arrow is as long as it would be at all of the old times.
        vectors = tuple(
            dataclasses.replace(
                vector,
                body=moved[vector.body.name],
                values=line(vector.values),
                looks=dataclasses.replace(vector.looks, scale=self.scale_of(vector)),
            )
            for vector in self.vectors
        )
        caption = {name: line(values.reshape(len(values), -1)) for name, values in self.caption.items()}
        return dataclasses.replace(
            self,
            ts=np.asarray(times),
            bodies=tuple(moved.values()),
            vectors=vectors,
            seconds=self.duration,
            caption=caption,
        )

    def frames(self: A) -> A:
        """The scene at the times of its frames, thirty for each second of the animation."""
        return self.at(np.linspace(self.ts[0], self.ts[-1], 1 + int(np.ceil(RATE * self.duration))))
