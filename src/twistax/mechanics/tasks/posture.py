"""Tasks of joint coordinates: a posture, and the middle of their limits."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np

from ...checks import listed
from ...errors import ModelError
from ...expr import Constant, Expr
from ...expr.fields import ExprLike
from ..kinematic_tree import KinematicTree
from .configuration_space import ConfigurationSpace
from .task import Task


@dataclasses.dataclass(frozen=True, eq=False)
class PostureTask(Task):
    """Moves joints to coordinates: $e = q_d - q$, rad or m. With a small weight, it determines the motion that other
    tasks leave free.

    Joints on groups, such as a floating base, have no coordinates; use `FrameTask` for them.

    Attributes:
        target: $q_d$ (w,), all entries of "q"; None: the Control "posture".
        joints: the joints whose coordinates count; None: all of them.
        weight, gain, damping: as for `Task`.
    Raises: ModelError for an unknown joint, or one on a group.
    Example: `PostureTask(q, weight=1e-2)`.
    """

    target: ExprLike | None = None
    joints: Collection[str] | None = None

    def error(self, mechanism: KinematicTree) -> Expr:
        space = ConfigurationSpace("PostureTask", mechanism)
        rows = _rows(space, self.joints)
        return (self._target("posture", self.target, (space.width,)) - space.vector)[rows]

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        space = ConfigurationSpace("PostureTask", mechanism)
        return space.coordinate_rates[_rows(space, self.joints)]


@dataclasses.dataclass(frozen=True, eq=False)
class JointLimitTask(Task):
    """Keeps joints near the middle of their limits: $e_i = (m_i - q_i) / h_i$ with the middle m and half of the range
    h, so that $|e_i|$ is 1 at a limit. Coordinates without two limits are omitted.

    Source: A. Liegeois, Automatic supervisory control of the configuration and behavior of multibody mechanisms, IEEE
    Transactions on Systems, Man and Cybernetics 7 (1977), equation 28.

    Attributes:
        joints: the joints whose coordinates count; None: all of them.
        weight, gain, damping: as for `Task`.
    Raises: ModelError for an unknown joint, a joint on a group, or if no joint has two limits.
    Example: `JointLimitTask(weight=1e-3)`.
    """

    joints: Collection[str] | None = None

    def _ranges(self, mechanism: KinematicTree) -> tuple[ConfigurationSpace, list[int], np.ndarray, np.ndarray]:
        space = ConfigurationSpace("JointLimitTask", mechanism)
        low, high = space.limits.lower, space.limits.upper
        rows = [i for i in _rows(space, self.joints) if np.isfinite(high[i] - low[i]) and high[i] > low[i]]
        if not rows:
            raise ModelError("JointLimitTask expects joints with a lower and an upper limit, got none")
        return space, rows, 0.5 * (low[rows] + high[rows]), 0.5 * (high[rows] - low[rows])

    def error(self, mechanism: KinematicTree) -> Expr:
        space, rows, middle, half = self._ranges(mechanism)
        return (Constant(middle) - space.vector[rows]) / Constant(half)

    def jacobian(self, mechanism: KinematicTree) -> Expr:
        space, rows, _, half = self._ranges(mechanism)
        return space.coordinate_rates[rows] / Constant(half[:, None])


def _rows(space: ConfigurationSpace, joints: Collection[str] | None) -> list[int]:
    """The coordinates of joints in "q"."""
    if joints is None and space.width:
        return list(range(space.width))
    rows = list[int]()
    for name in joints or ():
        segment = space.mechanism.segment_of(name)
        if segment.coordinates is None:
            raise ModelError(f"{space.owner}: joint {name!r} has no coordinates in q, it is on a group")
        rows += [i for i in range(space.width)[segment.coordinates] if i not in rows]
    if not rows:
        raise ModelError(f"{space.owner} expects joints with coordinates, got {listed(joints or [])}")
    return rows
