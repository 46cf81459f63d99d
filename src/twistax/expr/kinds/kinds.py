"""The kinds that a leaf may declare: its frames, and whether it is a motion or dual to one."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from typing import Any, ClassVar

from ...errors import ModelError
from .bodies import Acts, Bodies, BodyMotion
from .unit import JOULE, KILOGRAM, METRE, ONE, SECOND, Unit, parsed

Shape = tuple[int, ...]


class Space(enum.Enum):
    """The space of an axis of length six: that of twists, or its dual."""

    MOTION = "a twist"
    FORCE = "a wrench or momentum"

    @property
    def dual(self) -> Space:
        """The dual space, whose pairing with this one is a power or an energy."""
        return Space.FORCE if self is Space.MOTION else Space.MOTION


@dataclasses.dataclass(frozen=True)
class Kind:
    """Base class of kinds. The unit of a six-vector is that of its angular part; that of the linear part differs by
    metres.

    Attributes:
        unit: the unit that the kind implies; None if it implies none.
    Raises: ModelError if a leaf has another shape, or a frame is not a name. A frame without a name is undetermined.
    """

    shapes: ClassVar[tuple[Shape, ...]] = ()
    unit: ClassVar[Unit | None] = None
    #: The space of each axis of length six.
    space: ClassVar[Space | None] = None
    #: The usual units of the linear and of the angular part of a six-vector.
    halves: ClassVar[tuple[str, str] | None] = None

    def __str__(self) -> str:
        names = [repr(getattr(self, field.name)) for field in dataclasses.fields(self) if getattr(self, field.name)]
        return f"{type(self).__name__}({', '.join(names)})"

    def frames(self) -> dict[int, str]:
        """The frame of each axis, counted from the last; only named frames."""
        return {axis: name for axis, name in self.axes().items() if name}

    def axes(self) -> dict[int, str]:
        """The frame of each axis, counted from the last; "" for an undetermined one."""
        raise NotImplementedError

    def bodies(self) -> Bodies:
        """The body and the body that it moves relative to, or the body on which a wrench acts; None if not declared."""
        return None

    def names(self) -> set[str]:
        """All frames and bodies that are named."""
        return {getattr(self, field.name) for field in dataclasses.fields(self)} - {""}

    def moving(self) -> set[str]:
        """The frames and bodies that move with the value, of which a copy of a system has its own."""
        return set()

    def renamed(self, names: Mapping[str, str]) -> Kind:
        """The same kind with other names of frames and bodies."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return dataclasses.replace(self, **{field: names.get(name, name) for field, name in fields.items()})

    def check(self, name: str, shape: Shape) -> None:
        """Raise ModelError if a leaf (or the elements of a stack) has another shape, or if a frame is not a name."""
        if shape not in self.shapes and shape[1:] not in self.shapes:
            wanted = " or ".join(map(str, self.shapes))
            raise ModelError(f"{name!r}: {type(self).__name__} is for shape {wanted}, got {shape}")
        for field in dataclasses.fields(self):
            frame = getattr(self, field.name)
            if not isinstance(frame, str):
                raise ModelError(f"{name!r}: {type(self).__name__} expects the name of a frame, got {frame!r}")


@dataclasses.dataclass(frozen=True)
class _OfSix(Kind):
    """Base of six-vectors in one frame."""

    frame: str = ""
    shapes: ClassVar[tuple[Shape, ...]] = ((6,),)

    def axes(self) -> dict[int, str]:
        return {-1: self.frame}


@dataclasses.dataclass(frozen=True)
class Twist(_OfSix):
    """A twist (6,): m/s and rad/s. With `unit="1/s2"` it is the rate of a twist, with `unit="rad"` a displacement.

    Attributes:
        frame: the frame of its coordinates.
        of, relative_to: the moving body, and the body that it moves relative to. Sums of twists and rates of poses are
            checked for consistency.
    Raises: ModelError if a leaf has another shape, or a frame is not a name.
    Example: `tx.State("V", (6,), kind=tx.Twist("body", of="craft", relative_to="world"))`.
    """

    of: str = ""
    relative_to: str = ""
    unit = ONE / SECOND
    space = Space.MOTION
    halves = ("m/s", "rad/s")

    def bodies(self) -> Bodies:
        known = {self.of: 1, self.relative_to: -1}
        return BodyMotion({name: n for name, n in known.items() if name}) if self.of != self.relative_to else None

    def moving(self) -> set[str]:
        return {self.of} - {""}


@dataclasses.dataclass(frozen=True)
class Wrench(_OfSix):
    """A wrench (6,): force in N and torque in N m. Its pairing with a twist of the same frame is a power.

    Attributes:
        frame: the frame of its coordinates.
        on: the body on which it acts; wrenches on two bodies cannot be added.
    Raises: ModelError if a leaf has another shape, or the frame is not a name.
    Example: `tx.Control("F", (6,), kind=tx.Wrench("body"))`.
    """

    on: str = ""
    unit = JOULE
    space = Space.FORCE
    halves = ("N", "N m")

    def bodies(self) -> Bodies:
        return Acts(self.on) if self.on else None

    def moving(self) -> set[str]:
        return {self.on} - {""}


@dataclasses.dataclass(frozen=True)
class Momentum(_OfSix):
    """A spatial momentum (6,): linear in N s and angular in N m s. Its rate is a wrench.

    Attributes:
        frame: the frame of its coordinates.
    Raises: ModelError if a leaf has another shape, or if the frame is not a name.
    Example: `tx.State("h", (6,), kind=tx.Momentum("body"))`.
    """

    unit = JOULE * SECOND
    space = Space.FORCE
    halves = ("N s", "N m s")


@dataclasses.dataclass(frozen=True)
class Inertia(_OfSix):
    """An inertia, spatial (6, 6) or rotational (3, 3): it maps a twist or rate to a momentum in the same frame.

    The unit is that of its angular block, kg m2.

    Attributes:
        frame: the frame of its coordinates.
    Raises: ModelError if a leaf has another shape, or if the frame is not a name.
    Example: `tx.Parameter("M", (6, 6), kind=tx.kinds.Inertia("body"))`.
    """

    shapes = ((6, 6), (3, 3))
    unit = KILOGRAM * METRE**2
    space = Space.FORCE  # of both axes: the frame of the result, and the dual of the argument's

    def axes(self) -> dict[int, str]:
        return {-2: self.frame, -1: self.frame}


@dataclasses.dataclass(frozen=True)
class FreeVector(Kind):
    """A vector (3,) without a point of application: a force, a velocity, an angular rate. `unit=` distinguishes them.

    Attributes:
        frame: the axes of its coordinates.
    Raises: ModelError if a leaf has another shape, or if the frame is not a name.
    Example: `tx.Control("F", (3,), kind=tx.FreeVector("body"), unit="N")`.
    """

    frame: str = ""
    shapes = ((3,),)

    def axes(self) -> dict[int, str]:
        return {-1: self.frame}


@dataclasses.dataclass(frozen=True)
class Point(FreeVector):
    """The position (3,) of a point, in m.

    Attributes:
        frame: the frame of its coordinates.
    Raises: ModelError if a leaf has another shape, or if the frame is not a name.
    Example: `tx.State("p", (3,), kind=tx.Point("world"))`.
    """

    unit = METRE


@dataclasses.dataclass(frozen=True)
class Rotation(Kind):
    """A rotation (3, 3), or a quaternion (4,), R_ab, without unit: from coordinates in frame b to those in frame a.

    Attributes:
        to, source: the frames a and b.
    Raises: ModelError if a leaf has another shape, or if a frame is not a name.
    Example: `tx.State("R", group=tx.SO3, kind=tx.kinds.Rotation("world", "body"))`.
    """

    to: str = ""
    source: str = ""
    shapes: ClassVar[tuple[Shape, ...]] = ((3, 3), (4,))
    unit: ClassVar[Unit | None] = ONE

    def axes(self) -> dict[int, str]:
        return {-2: self.to, -1: self.source}

    def moving(self) -> set[str]:
        return {self.source} - {""}


@dataclasses.dataclass(frozen=True)
class Pose(Rotation):
    """A pose (4, 4), T_ab: it maps points in frame b to frame a, in m. The rate of a state is its twist in frame b.

    Attributes:
        to, source: the frames a and b.
    Raises: ModelError if a leaf has another shape, or if a frame is not a name.
    Example: `tx.State("g", group=tx.SE3, kind=tx.kinds.Pose("world", "body"))`.
    """

    shapes = ((4, 4),)
    unit = None


def declared(name: str, shape: Shape, kind: Any, unit: Any) -> dict[str, Any]:
    """The kind and the unit that a leaf says of itself, checked. Raises ModelError."""
    if kind is not None:
        if not isinstance(kind, Kind):
            made = f"; did you mean {kind.__name__}(...)?" if isinstance(kind, type) else ""
            raise ModelError(f"{name!r} expects a kind such as tx.Twist('body'), got {kind!r}{made}")
        kind.check(name, shape)
    if unit is not None:
        unit = parsed(name, unit)
    if kind is not None and unit is None:
        unit = kind.unit
    return {"kind": kind, "unit": unit}
