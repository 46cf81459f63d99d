"""The errors of a search for positions as arrays: targets of frames, further tasks, and constraints that are broken.

With the pose [R p] of a frame and its target [R_d p_d] the error is

    e = [p_d - p; l Log(R^T R_d)]        e' = -J qd

of a position and an orientation. A constraint c(q) <= 0 has the error max(c, 0), which is zero where it holds.

Source: K. Lynch, F. Park, Modern Robotics (2017), section 6.2, for the error of a pose.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from ...checks import listed
from ...errors import ModelError
from ...expr import State
from ..kinematic_tree import KinematicTree
from ..tasks.configuration_space import Arrays, ConfigurationSpace
from ..tasks.frame import OrientationTask, PositionTask
from ..tasks.rows import ConstraintRows, TaskRows, inputs_of
from ..tasks.task import Task


class ReachErrors:
    """The errors of a search.

    Args:
        mechanism: without closures.
        shapes: by frame (4, 4) for a pose, (3,) for a position.
        length: l, m.
        tasks: further ones, whose targets are numbers.
        secondary: tasks that are minimised where all others are done.
        constraints: inequalities of positions.
    Attributes:
        space: the positions.
        blocks: the rows of each position, orientation and task, and of each entry of the constraints.
        turns: by block whether it is an orientation of a target.
        size: the number of rows.
    Raises: ModelError for frames that are not known; a mechanism with closures, or joints on other groups; tasks whose
        targets are controls.
    """

    def __init__(
        self,
        mechanism: KinematicTree,
        shapes: Mapping[str, tuple[int, ...]],
        length: float,
        tasks: Iterable[Task] = (),
        secondary: Iterable[Task] = (),
        constraints: Any = (),
    ) -> None:
        self.space, self.shapes, self.length = ConfigurationSpace("reach", mechanism), dict(shapes), length
        every: list[Task] = []
        self.turns: list[bool] = []
        for frame, shape in shapes.items():
            target, pose = State(f"target of {frame}", shape), shape == (4, 4)
            every.append(PositionTask(frame, target[:3, 3] if pose else target))
            self.turns += [False, True] if pose else [False]
            if pose:
                every.append(OrientationTask(frame, target[:3, :3], weight=length))
        further = TaskRows("reach", self.space, tasks)
        self._tasks = TaskRows("reach", self.space, [*every, *further.tasks])
        self._secondary = TaskRows("reach", self.space, secondary)
        self.constraints = ConstraintRows("reach", self.space, constraints)
        parts = [*(further.expressions or ()), *(self._secondary.expressions or ())]
        parts += [] if self.constraints.expression is None else [self.constraints.expression]
        controls, _ = inputs_of("reach", self.space, parts)
        if controls:
            raise ModelError(f"reach expects tasks with targets, got none for {listed(c.name for c in controls)}")
        sizes = [*self._tasks.sizes, *([1] * sum(self.constraints.sizes.values()))]
        self.turns += [False] * (len(sizes) - len(self.turns))
        ends = [sum(sizes[:k]) for k in range(len(sizes) + 1)]
        self.blocks = [slice(*pair) for pair in itertools.pairwise(ends)]
        self.size = ends[-1]

    @property
    def has_secondary(self) -> bool:
        return bool(self._secondary.tasks)

    def __call__(self, x: Arrays, targets: Arrays) -> tuple[jax.Array, jax.Array]:
        """The errors (m,) and the Jacobian J (m, n): their rate is -J qd."""
        e, J = self._weighted(self._tasks, {**x, **{f"target of {frame}": T for frame, T in targets.items()}})
        if self.constraints.expression is None:
            return e, J
        c, C = self.constraints(x, {}, {})
        broken = c > 0.0
        zero = jnp.zeros((), c.dtype)
        active = jnp.where(broken[:, None], -C, zero)
        return jnp.concatenate([e, jnp.where(broken, c, zero)]), jnp.concatenate([J, active])

    def secondary(self, x: Arrays) -> tuple[jax.Array, jax.Array]:
        """The weighted errors and the Jacobian of the secondary tasks."""
        return self._weighted(self._secondary, x)

    @staticmethod
    def _weighted(tasks: TaskRows, x: Arrays) -> tuple[jax.Array, jax.Array]:
        e, J = tasks(x, {}, {})
        weights = jnp.asarray(tasks.weights, e.dtype)
        return weights * e, weights[:, None] * J
