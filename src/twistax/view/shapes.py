"""Simple solids as triangle meshes: shapes of bodies, and obstacles."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np
from numpy import ndarray as Array

from ..checks import number, reals
from ..errors import InputError
from ..groups import SE3
from ..plots import group_of

#: Sides of what is round.
_ROUND = 32

#: RGB from 0 to 255.
Color = tuple[int, int, int]
STEEL: Color = (92, 124, 160)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Shape:
    """Base class of solids: pose, colour and opacity.

    Attributes:
        at: its position or pose, in the axes of its body or of the world: a point (3,) in m, or a pose T (4, 4).
        color: red, green and blue from 0 to 255.
        opacity: from 0 to 1.
    Raises: InputError for invalid values, or a size that is not positive.
    """

    at: Any = (0.0, 0.0, 0.0)
    color: Color = STEEL
    opacity: float = 1.0
    #: Fields that are positive lengths, m, a number or three.
    single: ClassVar[tuple[str, ...]] = ()
    triple: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        name = type(self).__name__
        for field in self.single:
            number(f"{name}: {field}", getattr(self, field), "a positive length", lambda x: 0.0 < x < np.inf)
        for field in self.triple:
            lengths = reals(f"{name}: {field}", value := getattr(self, field), InputError)
            if lengths.shape != (3,) or not ((lengths > 0.0) & np.isfinite(lengths)).all():
                raise InputError(f"{name} expects {field} as three positive lengths, got {value!r}")
            object.__setattr__(self, field, lengths)
        at = reals(f"{name}: at", self.at, InputError)
        if at.shape == (3,):
            at, p = np.eye(4), at
            at[:3, 3] = p
        if group_of(at[None]) != SE3 or not np.isfinite(at).all():
            raise InputError(f"{name} expects at to be a point (3,) or a pose (4, 4), got {self.at!r}")
        color = reals(f"{name}: color", self.color, InputError)
        if color.shape != (3,) or not ((color >= 0.0) & (color <= 255.0)).all():
            raise InputError(f"{name} expects color as red, green and blue from 0 to 255, got {self.color!r}")
        number(f"{name}: opacity", self.opacity, "a number from 0 to 1", lambda x: 0.0 <= x <= 1.0)
        object.__setattr__(self, "at", at)

    def mesh(self) -> tuple[Array, Array]:
        """Vertices (n, 3) in its own axes, in m, and triangles (m, 3) of vertex indices, counter-clockwise from
        outside.
        """
        raise NotImplementedError

    def corners(self) -> Array:
        """The corners (n, 3) at its pose."""
        return self.mesh()[0] @ self.at[:3, :3].T + self.at[:3, 3]


@dataclasses.dataclass(frozen=True, eq=False)
class Box(Shape):
    """A box centred at its pose, with lengths (3,) along x, y and z, m."""

    lengths: Any
    triple = ("lengths",)

    def mesh(self) -> tuple[Array, Array]:
        corners = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
        faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        return corners * self.lengths, np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))])


@dataclasses.dataclass(frozen=True, eq=False)
class Ellipsoid(Shape):
    """An ellipsoid centred at its pose, with semi-axes `radii` (3,) along x, y and z, m."""

    radii: Any
    triple = ("radii",)

    @classmethod
    def of_inertia(cls, mass: Any, center_of_mass: Any, inertia: Any, **looks: Any) -> Ellipsoid:
        """The solid, homogeneous ellipsoid with a mass, kg, and an inertia tensor (3, 3) about its centre, kg m2.

        Its principal moments are $I_1 = m (b^2 + c^2) / 5$ and so on, so $a^2 = 5 (I_2 + I_3 - I_1) / (2 m)$. A flat or
        thin body is drawn with at least a hundredth of its largest semi-axis. Raises InputError if the tensor is zero.

        Args:
            center_of_mass: (3,), m, in the axes of the tensor.
            looks: the arguments `color` and `opacity`.
        """
        m = float(number("of_inertia: mass", mass, "a positive mass", lambda x: 0.0 < x < np.inf))
        tensor = reals("of_inertia: inertia", inertia, InputError)
        if tensor.shape != (3, 3) or not np.isfinite(tensor).all() or not tensor.any():
            raise InputError(f"of_inertia expects an inertia tensor (3, 3) that is not zero, got {inertia!r}")
        moments, axes = np.linalg.eigh(0.5 * (tensor + tensor.T))
        radii = np.sqrt(np.maximum(2.5 / m * (moments.sum() - 2.0 * moments), 0.0))
        at = np.eye(4)
        at[:3, :3], at[:3, 3] = axes * np.sign(np.linalg.det(axes)), center_of_mass
        return cls(np.maximum(radii, 0.01 * radii.max()), at=at, **looks)

    def mesh(self) -> tuple[Array, Array]:
        up = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ROUND // 2 + 1)
        corners, faces = _turned(np.cos(up), np.sin(up))
        return corners * self.radii, faces


@dataclasses.dataclass(frozen=True, eq=False)
class Sphere(Shape):
    """A ball centred at its pose; its number is the radius in m."""

    radius: float
    single = ("radius",)

    def mesh(self) -> tuple[Array, Array]:
        return Ellipsoid((self.radius,) * 3).mesh()


@dataclasses.dataclass(frozen=True, eq=False)
class Cylinder(Shape):
    """A cylinder centred at its pose, along z; its two numbers are radius and length in m."""

    radius: float
    length: float
    single = ("radius", "length")

    def mesh(self) -> tuple[Array, Array]:
        half = 0.5 * self.length
        return _turned(np.array([0.0, *(self.radius,) * 2, 0.0]), np.array([-half, -half, half, half]))


@dataclasses.dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """A cylinder centred at its pose, along z, with half a ball on each end; its two numbers are radius and length in
    m.

    The length is that of the cylinder, between the centres of the balls.
    """

    radius: float
    length: float
    single = ("radius", "length")

    def mesh(self) -> tuple[Array, Array]:
        up = np.linspace(0.0, 0.5 * np.pi, _ROUND // 4 + 1)
        r, z = self.radius * np.cos(up), 0.5 * self.length + self.radius * np.sin(up)
        return _turned(np.concatenate([r[::-1], r]), np.concatenate([-z[::-1], z]))


@dataclasses.dataclass(frozen=True, eq=False)
class Cone(Shape):
    """A cone with its tip at its pose, opening along z; its two numbers are the height in m and the `half_angle` from
    its axis in rad.
    """

    height: float
    half_angle: float
    opacity: float = dataclasses.field(default=0.25, kw_only=True)
    single = ("height",)

    def __post_init__(self) -> None:
        super().__post_init__()
        number("Cone: half_angle", self.half_angle, "an angle from 0 to pi/2", lambda x: 0.0 < x < 0.5 * np.pi)

    def mesh(self) -> tuple[Array, Array]:
        return _turned(np.array([0.0, self.height * np.tan(self.half_angle)]), np.array([0.0, self.height]))


def _turned(radii: Array, heights: Array) -> tuple[Array, Array]:
    """The surface of revolution about z of a line (radius, height) that rises along its outside."""
    turn = 2.0 * np.pi * np.arange(_ROUND) / _ROUND
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rings = [np.column_stack([r * around, np.full(_ROUND, z)]) for r, z in zip(radii, heights)]
    here = np.arange(_ROUND)
    after = (here + 1) % _ROUND
    faces = [
        np.stack(corners, axis=1)
        for low in range(0, _ROUND * (len(rings) - 1), _ROUND)
        for corners in (
            (low + here, low + after, low + _ROUND + after),
            (low + here, low + _ROUND + after, low + _ROUND + here),
        )
    ]
    return np.concatenate(rings), np.concatenate(faces)
