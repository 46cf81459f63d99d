"""Joint types: their states, kinematics, and motion and force subspaces (see `screws.py`).

Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 3 and 4.
"""

from __future__ import annotations

import copy
import functools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from ..checks import number
from ..errors import ModelError
from ..expr import Block, Concat, Constant, Expr, Parameter, Solve, Stack, State
from ..expr.fields import ExprLike
from ..expr.kinds.declare import known_as
from ..expr.lie import AxisRotation, Pose, SO3Exp, SO3Log
from ..expr.lie.base import unit_vector
from ..groups import SE3, SO3, Group
from .arguments import of_shape
from .screws import Screws, Subspaces, across, checked_actuation, checked_motion, complement, direction, kinds_of, screw

# fmt: off
__all__ = [
    "Cylindrical", "Fixed", "Free", "Helical", "Joint", "Planar", "Prismatic", "Revolute", "Screws", "Spherical",
    "universal",
]
# fmt: on

#: The tolerance for two axes to be parallel.
_ROUND_OFF = 1e-12


class Joint(Subspaces, ABC):
    """A joint of k degrees of freedom between a parent and a child; its motion subspace H is constant in the child.

    To define a joint type, subclass it: call `super().__init__` with H, and define `placement`. H may be an expression
    (6, 1); then set `constraint_basis`. Six-vectors are [v; w] and [f; tau].

    Args:
        name: the prefix of the names of the states, `<name>_position` and `<name>_velocity`.
        motion: H (6, k), or (6,) for one degree of freedom, in the child's joint frame.
        actuation_basis: h* (6, k) with $h*^T H = I$; $H (H^T H)^-1$ by default. Pass it if H mixes m and rad.

    Attributes:
        name: the name of the joint.
        dofs: k, from 0 to 6.
        position: the State of shape (k,), or on the `group` of a subclass; None for k = 0.
        velocity: the State of shape (k,), in m/s for translations and rad/s for rotations. None for k = 0.
        motion_subspace, actuation_basis, constraint_basis: H, h* and H-bar* in the child's joint frame; see `Screws`.

    Raises:
        ModelError: no name; H or h* not numeric; H not finite or with dependent columns; $h*^T H$ is not I; a group
            whose dimension is not k.
        ShapeError: H or h* with a wrong shape.
    """

    #: The group of the position; None for k coordinates whose rate is the velocity.
    group: ClassVar[Group | None] = None
    #: Further arguments of the constructor, for test suites that run over all joints.
    cases: ClassVar[Sequence[Mapping[str, Any]]] = ()

    def __init__(self, name: str, motion: Any, actuation_basis: Any = None) -> None:
        self.name = name
        if isinstance(motion, Expr):
            self.dofs = 1
            self.motion_subspace = self.actuation_basis = motion
        else:
            self._fix(motion, actuation_basis)
        self._declare(name)

    def _declare(self, name: str) -> None:
        """Set the name, and declare the states with this name."""
        if not isinstance(name, str) or not name:
            raise ModelError(f"{type(self).__name__} needs a name: a non-empty string, got {name!r}")
        self.name = name
        self.position: State | None = None
        self.velocity: State | None = None
        if self.dofs:
            shape, known = (self.dofs,) if self.group is None else None, kinds_of(self.motion_subspace, self.group)
            self.position = known_as(State(f"{name}_position", shape, group=self.group), *known[0])
            self.velocity = known_as(State(f"{name}_velocity", (self.dofs,)), *known[1])

    def renamed(self, name: str) -> Joint:
        """The same joint with another name, and with states of that name. Raises ModelError for an empty name."""
        joint = copy.copy(self)
        joint.__dict__.pop("transform", None)  # it depends on the position with the old name
        joint._declare(name)
        return joint

    def reversed(self) -> Joint:
        """The reversed joint, from the child to the parent: its pose is $T_pc^-1$ at the same position.

        On a group the position becomes its inverse.

        Raises: ModelError if no joint of this kind has that pose.
        """
        raise ModelError(f"{self!r} cannot be reversed: {type(self).__name__} has no method `reversed`")

    def _fix(self, motion: Any, actuation_basis: Any) -> None:
        """Compute the subspaces, as numbers."""
        H = checked_motion(repr(self), motion)
        self.dofs = H.shape[1]
        if self.group is not None and self.group.dimension != self.dofs:
            raise ModelError(
                f"{self!r} expects a group of dimension {self.dofs}, one for each column of motion, "
                f"got {self.group.name} of dimension {self.group.dimension}"
            )
        h = H @ np.linalg.inv(H.T @ H) if actuation_basis is None else checked_actuation(repr(self), actuation_basis, H)
        self.motion_subspace, self.actuation_basis = Constant(H), Constant(h)
        self.constraint_basis = Constant(complement(H))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"

    @abstractmethod
    def placement(self, position: Expr) -> Expr:
        """T_pc (4, 4) as a function of the position, which has shape (0,) for a joint without one. Its rate must be
        $T_pc hat(H velocity)$.
        """

    def rate(self, position: Expr, velocity: Expr) -> Expr:
        """The rate of the position: the velocity, unless a subclass overrides it."""
        return velocity

    def deflection(self, position: Expr) -> Expr | None:
        """The deflection (k,) of a spring: by default the coordinates; None if there is no spring."""
        return position if self.group is None else None

    def velocity_of(self, position: Expr, rate: Expr) -> Expr:
        """The velocity from the rate of the position: the inverse of `rate`. The default solves a linear system with
        the matrix of `rate`.
        """
        if type(self).rate is Joint.rate:
            return rate
        columns = [self.rate(position, Constant(unit)) for unit in np.eye(self.dofs)]
        return Solve(Stack(*columns).T, rate)

    @functools.cached_property
    def transform(self) -> Expr:
        """T_pc (4, 4): maps coordinates of the child's joint frame to the parent's.

        Raises: ShapeError if `placement` of a subclass returns another shape.
        """
        position = Constant(np.zeros(0)) if self.position is None else self.position
        return of_shape(repr(self), "its placement", self.placement(position), (4, 4))

    @property
    def screws(self) -> Screws:
        """The motion, actuation and constraint subspaces in the child's joint frame."""
        return Screws(self.motion_subspace, self.actuation_basis, self.constraint_basis)

    @property
    def rates(self) -> dict[State | str, ExprLike]:
        """The kinematics {position: its rate}, for the rates of a System; empty for a fixed joint."""
        if self.position is None or self.velocity is None:
            return {}
        return {self.position: self.rate(self.position, self.velocity)}

    @property
    def twist(self) -> Expr:
        """H @ velocity (6,): the twist of the child relative to the parent, in the child's joint frame."""
        return Constant(np.zeros(6)) if self.velocity is None else self.motion_subspace @ self.velocity

    def screws_in(self, T: ExprLike) -> Screws:
        """The subspaces in another frame; T (4, 4) maps coordinates of the child's joint frame to that frame. Raises
        ShapeError for another shape of T.
        """
        return self.screws.in_frame(T)


class Fixed(Joint):
    """A joint without motion: H has shape (6, 0), $T_pc = I$, and the bearing carries every wrench. There are no
    states.

    Args:
        name: the name of the joint.
    Raises: ModelError for an empty name.
    """

    cases = ({},)

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.zeros((6, 0)))

    def placement(self, position: Expr) -> Expr:
        return Constant(np.eye(4))

    def reversed(self) -> Fixed:
        return self


class Revolute(Joint):
    """Rotation about a fixed axis a through the joint's origin: $H = [0; a]$, $T_pc = [Rot(a, q), 0; 0, 1]$, q in rad.

    Args:
        name: the name of the joint.
        axis: a (3,), the same in both joint frames; any non-zero length, normalised. Numbers, or a Parameter.
    Raises:
        ShapeError: axis is not of shape (3,).
        ModelError: no name; an axis that is zero or not finite.
    Example: `Revolute("elbow", axis=(0.0, 1.0, 0.0))`.
    """

    cases = ({"axis": (0.0, 0.0, 2.0)}, {"axis": (2.0, -1.0, 2.0)}, {"axis": Parameter("axis", value=(0.0, 3.0, 4.0))})

    def __init__(self, name: str, axis: Any) -> None:
        self.axis = direction(f"Revolute {name!r}", axis)
        super().__init__(name, motion=screw(np.zeros(3), self.axis))
        if isinstance(self.axis, Expr):
            self.constraint_basis = Block([[np.eye(3), np.zeros((3, 2))], [np.zeros((3, 3)), across(self.axis)]])

    def placement(self, position: Expr) -> Expr:
        known = not isinstance(self.axis, Expr)
        R = AxisRotation(position[0], self.axis) if known else SO3Exp(self.axis * position[0])
        return Pose(R, np.zeros(3))

    def reversed(self) -> Revolute:
        return Revolute(self.name, -self.axis)


class Prismatic(Joint):
    """Translation along a fixed axis a: $H = [a; 0]$, $T_pc = [I, q a; 0, 1]$, q in m.

    Args:
        name, axis: as for `Revolute`.
    Raises:
        ShapeError, ModelError: as for `Revolute`.
    Example: `Prismatic("slide", axis=(1.0, 0.0, 0.0))`.
    """

    cases = ({"axis": (2.0, -1.0, 2.0)}, {"axis": Parameter("axis", value=(0.0, 3.0, 4.0))})

    def __init__(self, name: str, axis: Any) -> None:
        self.axis = direction(f"Prismatic {name!r}", axis)
        super().__init__(name, motion=screw(self.axis, np.zeros(3)))
        if isinstance(self.axis, Expr):
            self.constraint_basis = Block([[across(self.axis), np.zeros((3, 3))], [np.zeros((3, 2)), np.eye(3)]])

    def placement(self, position: Expr) -> Expr:
        return Pose(np.eye(3), self.axis * position[0])

    def reversed(self) -> Prismatic:
        return Prismatic(self.name, -self.axis)


class Helical(Joint):
    """A helical (screw) joint: rotation about a fixed axis a with a proportional translation along it, $H = [h a; a]$,
    q in rad.

    The motor exerts a torque about the axis: h* = [0; a].

    Args:
        name, axis: as for `Revolute`.
        pitch: h in m/rad, the translation along the axis for each rad; finite.
    Raises:
        ShapeError: axis is not of shape (3,).
        ModelError: no name; an axis that is zero or not finite; a pitch that is not a finite number.
    Example: `Helical("spindle", axis=(0.0, 0.0, 1.0), pitch=0.002)`.
    """

    cases = ({"axis": (2.0, -1.0, 2.0), "pitch": 0.05},)

    def __init__(self, name: str, axis: Any, pitch: float) -> None:
        self.axis = unit_vector(f"Helical {name!r}", "axis", axis)
        self.pitch = number(f"Helical {name!r}: pitch", pitch, error=ModelError)
        motor = np.concatenate([np.zeros(3), self.axis])
        super().__init__(name, np.concatenate([self.pitch * self.axis, self.axis]), motor)

    def placement(self, position: Expr) -> Expr:
        return Pose(AxisRotation(position[0], self.axis), (self.pitch * self.axis) * position[0])

    def reversed(self) -> Helical:
        return Helical(self.name, -self.axis, self.pitch)


class Cylindrical(Joint):
    """Translation along a fixed axis a and rotation about it: $H = [a, 0; 0, a]$, q = [distance in m, angle in rad].

    Args:
        name, axis: as for `Revolute`.
    Raises:
        ShapeError, ModelError: as for `Revolute`.
    """

    cases = ({"axis": (2.0, -1.0, 2.0)},)

    def __init__(self, name: str, axis: Any) -> None:
        self.axis = unit_vector(f"Cylindrical {name!r}", "axis", axis)
        zero = np.zeros(3)
        super().__init__(name, np.block([[self.axis, zero], [zero, self.axis]]).T)

    def placement(self, position: Expr) -> Expr:
        return Pose(AxisRotation(position[1], self.axis), self.axis * position[0])

    def reversed(self) -> Cylindrical:
        return Cylindrical(self.name, -self.axis)


class Planar(Joint):
    """Motion in a plane of the parent, through the origin with normal z: q = [x, y, angle], in m and rad.

    The velocity is [v_x, v_y, w] in the CHILD's axes, where H is constant: [x', y'] is [v_x, v_y] rotated by the
    angle. Mount the joint with z along the normal of the plane.

    Args:
        name: the name of the joint.
    Raises: ModelError for an empty name.
    """

    cases = ({},)

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.eye(6)[:, [0, 1, 5]])

    def placement(self, position: Expr) -> Expr:
        return Pose(AxisRotation(position[2], (0.0, 0.0, 1.0)), Concat(position[0], position[1], 0.0))

    def rate(self, position: Expr, velocity: Expr) -> Expr:
        turned = AxisRotation(position[2], (0.0, 0.0, 1.0)) @ Concat(velocity[0], velocity[1], 0.0)
        return Concat(turned[0], turned[1], velocity[2])

    def velocity_of(self, position: Expr, rate: Expr) -> Expr:
        return self.rate(-position, rate)


class Spherical(Joint):
    """A ball joint, rotation about its origin: $H = [0; I]$, $T_pc = [R, 0; 0, 1]$.

    The position is R (3, 3) on SO(3). The velocity is the body rate w (3,) in rad/s, with $R' = R [w]x$.

    Args:
        name: the name of the joint.
    Raises: ModelError for an empty name.
    """

    cases = ({},)
    group = SO3

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.eye(6)[:, 3:])

    def placement(self, position: Expr) -> Expr:
        return Pose(position, np.zeros(3))

    def deflection(self, position: Expr) -> Expr:
        """Log R, in rad: the shortest rotation from the rest position."""
        return SO3Log(position)

    def reversed(self) -> Spherical:
        return Spherical(self.name)


class Free(Joint):
    """A joint with six degrees of freedom: $H = I$. The position is T_pc on SE(3), and the velocity is the body twist
    [v; w] (6,).

    There are no constraint wrenches: H-bar* has shape (6, 0).

    Args:
        name: the name of the joint.
    Raises: ModelError for an empty name.
    Example: `Link(Free("trunk"), body, tx.pose())` is a floating base.
    """

    cases = ({},)
    group = SE3

    def __init__(self, name: str) -> None:
        super().__init__(name, motion=np.eye(6))

    def placement(self, position: Expr) -> Expr:
        return position

    def reversed(self) -> Free:
        return Free(self.name)


def universal(name: str, first: Any, second: Any) -> tuple[Revolute, Revolute]:
    """A universal joint: a rotation about an axis of the parent, then one about an axis of the child.

    Its H varies in the child frame, so it is modelled as two joints, `<name>_1` and `<name>_2`. Connect them by a link
    without a body, with an identity mount.

    Args:
        name: the prefix of the names of both joints.
        first, second: the two axes (3,), each the same in both frames when both angles are zero.
    Raises:
        ShapeError, ModelError: as for `Revolute`. ModelError: parallel axes.
    """
    joints = Revolute(f"{name}_1", first), Revolute(f"{name}_2", second)
    if np.linalg.norm(np.cross(joints[0].axis, joints[1].axis)) < _ROUND_OFF:
        raise ModelError(f"universal {name!r} expects two axes in different directions, got {first} and {second}")
    return joints
