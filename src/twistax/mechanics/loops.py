"""Loop constraints: constraints between two frames of a mechanism in addition to its tree.

A loop constraint is a bearing between two frames. It carries wrenches in the span of a basis W (6, m), the constraint
wrenches H-bar* of a joint, in the axes of the second frame. Let T be the pose of the second frame in the first, and V
the twist of the second relative to the first, in the second's axes. A closed loop satisfies

    gap(T) = 0 (m,)        W' V = 0 (m,)

and the rate of the gap is W' V if the loop is closed. See `joints` for H-bar*.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ..checks import listed, number, short
from ..errors import ModelError
from ..expr import Concat, Constant, Cross, Expr
from ..expr.lie import SO3Log
from ..expr.lie.base import unit_vector
from ..expr.moved import earlier_classes
from .arguments import of_kind
from .joints import complement

__all__ = ["AxisLoop", "Loop", "Metric", "PointLoop", "PoseLoop"]

__getattr__ = earlier_classes(__name__)


@dataclasses.dataclass(frozen=True)
class Metric:
    """The norm in which rows of loop constraints and constraint wrenches are compared, to find redundant constraints.

    A length l combines units: a rotation counts as l times its angle, a translation as its distance, and a moment tau
    as a force tau / l. A closure row is independent if its distance from the span of the others exceeds `tolerance`
    times the length of the longest row, which is taken as at least 1. Redundant rows do not change the motion.
    Constraint wrenches are the minimum-norm solution: the smallest sum of $|f|^2 + |tau / l|^2$ over all closures.
    The norm does not depend on masses, so the mass of links may be arbitrarily small.

    Attributes:
        length: l (), m; None for the mean distance between successive joints (for joints on the base, from the first of
            them). Set it for loops that are much smaller than that.
        tolerance: (), between 0 and 1. Choose it above the round-off of the angles of the model's axes. In single
            precision it is at least 2e-3.
    Raises: ModelError for a length that is not positive, or a tolerance out of its range.
    """

    length: float | None = None
    tolerance: float = 1e-5

    def __post_init__(self) -> None:
        if self.length is not None:
            number("Metric: length", self.length, "a positive length in m", lambda x: 0.0 < x < np.inf, ModelError)
        number("Metric: tolerance", self.tolerance, "a number between 0 and 1", lambda x: 0.0 < x < 1.0, ModelError)


class Loop(ABC):
    """A loop closure: a constraint between two frames of a mechanism that closes a loop of its tree.

    Args:
        name: of the closure, unique within the mechanism.
        frame, other: names of the two frames: each of a link, a joint, or the base. Add frames by links on `Fixed`
            joints.
        wrenches: W (6, m), a basis of the constraint wrenches, in the axes of `other`.
    Raises: ModelError for a missing name, or a frame that is named twice.
    """

    def __init__(self, name: str, frame: str, other: str, wrenches: np.ndarray) -> None:
        for what, text in (("name", name), ("frame", frame), ("other", other)):
            if not isinstance(text, str) or not text:
                raise ModelError(f"{type(self).__name__} expects {what} to be a non-empty string, got {text!r}")
        if frame == other:
            raise ModelError(f"loop {name!r} expects two different frames, got {frame!r} twice")
        self.name, self.frame, self.other = name, frame, other
        self.constraint_basis = Constant(wrenches)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {self.frame!r}, {self.other!r})"

    @property
    def rows(self) -> int:
        """The number m of rows of the constraint."""
        return self.constraint_basis.shape[1]

    @abstractmethod
    def gap(self, T: Expr) -> Expr:
        """The closure residual (m,), m and rad."""


class PointLoop(Loop):
    """A ball-and-socket constraint between two frames: their origins coincide. The closure residual is $R^T p$ (3,), m.

    Args:
        name, frame, other: as for `Loop`.
    Raises: ModelError as `Loop` does.
    """

    def __init__(self, name: str, frame: str, other: str) -> None:
        super().__init__(name, frame, other, np.eye(6)[:, :3])

    def gap(self, T: Expr) -> Expr:
        return T[:3, :3].T @ T[:3, 3]


class AxisLoop(Loop):
    """A hinge constraint between two frames: their origins coincide, and an axis of one is parallel to that of the
    other.

    With U (3, 2) two unit vectors perpendicular to the axis a, the closure residual is $[R^T p; U^T (R^T a x a)]$ (5,).

    Args:
        name, frame, other: as for `Loop`.
        axis: a (3,), the same in both frames; any non-zero length.
    Raises:
        ShapeError: axis is not of shape (3,).
        ModelError: as `Loop` does; an axis that is zero or not finite.
    """

    def __init__(self, name: str, frame: str, other: str, axis: Any) -> None:
        self.axis = unit_vector(f"AxisLoop {name!r}", "axis", axis)
        self._across = complement(self.axis[:, None])
        turning = np.concatenate([np.zeros((3, 2)), self._across])
        super().__init__(name, frame, other, np.concatenate([np.eye(6)[:, :3], turning], axis=1))

    def gap(self, T: Expr) -> Expr:
        turned = Cross(T[:3, :3].T @ self.axis, Constant(self.axis))
        return Concat(T[:3, :3].T @ T[:3, 3], self._across.T @ turned)


class PoseLoop(Loop):
    """A weld constraint between two frames: they coincide. The closure residual is $[R^T p; Log R]$ (6,).

    Args:
        name, frame, other: as for `Loop`.
    Raises: ModelError as `Loop` does.
    """

    def __init__(self, name: str, frame: str, other: str) -> None:
        super().__init__(name, frame, other, np.eye(6))

    def gap(self, T: Expr) -> Expr:
        return Concat(T[:3, :3].T @ T[:3, 3], SO3Log(T[:3, :3]))


def check_loops(loops: Iterable[Any], metric: Any, segment: Callable[[str], int]) -> None:
    """Raise ModelError for an object that is not a loop constraint, for one that connects a body with itself, and for a
    repeated name.

    Args:
        segment: a function from the name of a frame to the index of the segment that it is fixed to.
    """
    of_kind("Mechanism", "loop_metric", metric, Metric)
    for loop in loops:
        if not isinstance(loop, Loop):
            raise ModelError(f"Mechanism expects loops, such as loops.PointLoop, got {short(loop)}")
        if segment(loop.frame) == segment(loop.other):
            raise ModelError(f"{loop!r} connects two frames of one body, which cannot move relative to each other")
    names = [loop.name for loop in loops]
    if len(set(names)) < len(names):
        raise ModelError(f"loops must have different names, got {listed(names)}")
