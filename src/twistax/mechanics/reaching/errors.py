"""The errors of inverse kinematics as arrays: targets of frames, further tasks, and violated constraints.

For the pose [R p] of a frame and its target [R_d p_d], the error is

    e = [p_d - p; l Log(R^T R_d)]        e' = -J qd

with the position and the orientation. The error of a constraint c(q) <= 0 is max(c, 0), which is zero if it is
satisfied.

Source: K. Lynch, F. Park, Modern Robotics (2017), section 6.2, for the error of a pose.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import listed
from ...errors import ModelError
from ...expr import State, leaves_of, to_expr
from ..kinematic_tree import KinematicTree
from ..tasks.configuration_space import Arrays, ConfigurationSpace
from ..tasks.frame import OrientationTask, PositionTask
from ..tasks.manipulability import ManipulabilityTask
from ..tasks.rows import ConstraintRows, TaskRows, inputs_of
from ..tasks.task import Task


class ReachErrors:
    """The errors of inverse kinematics. They are equal if they differ only in numbers: those of tasks and parameters.

    Args:
        mechanism: a mechanism without loop constraints.
        shapes: by frame (4, 4) for a target pose, (3,) for a target position.
        tasks: additional tasks, whose targets are numbers.
        secondary: tasks that are minimised once all others are satisfied.
        constraints: inequalities of positions, by name.
    Attributes:
        space: the configuration space.
        blocks: the rows of each position, orientation and task, and of each entry of the constraints.
        turns: by block whether it is the orientation of a target.
        key: equal for errors that one compiled search serves.
        rows_of_tasks, size: the number of rows of the tasks, and of all.
    Raises: ModelError for unknown frames; a mechanism with loop constraints, or with joints on other groups; tasks
        whose targets are controls, or whose errors do not depend on positions.
    """

    def __init__(
        self,
        mechanism: KinematicTree,
        shapes: Iterable[tuple[str, tuple[int, ...]]],
        tasks: Iterable[Task] = (),
        secondary: Iterable[Task] = (),
        constraints: Iterable[tuple[str, Any]] = (),
    ) -> None:
        self.space, self.shapes = ConfigurationSpace("reach", mechanism), dict(shapes)
        every: list[Task] = []
        self.turns: list[bool] = []
        for frame, shape in self.shapes.items():
            target, pose = State(f"target of {frame}", shape), shape == (4, 4)
            every.append(PositionTask(frame, target[:3, 3] if pose else target))
            self.turns += [False, True] if pose else [False]
            if pose:
                every.append(OrientationTask(frame, target[:3, :3]))
        further = TaskRows("reach", self.space, tasks)
        self._secondary = TaskRows("reach", self.space, secondary)
        for task in (*further.tasks, *self._secondary.tasks):
            self._need_positions(task)
        self._tasks = TaskRows("reach", self.space, [*every, *further.tasks])
        self.constraints = ConstraintRows("reach", self.space, dict(constraints))
        parts = [*(further.expressions or ()), *(self._secondary.expressions or ())]
        parts += [] if self.constraints.expression is None else [self.constraints.expression]
        controls, parameters = inputs_of("reach", self.space, parts)
        if controls:
            raise ModelError(f"reach expects tasks with targets, got none for {listed(c.name for c in controls)}")
        sizes = [*self._tasks.sizes, *([1] * sum(self.constraints.sizes.values()))]
        self.turns += [False] * (len(sizes) - len(self.turns))
        ends = [sum(sizes[:k]) for k in range(len(sizes) + 1)]
        self.blocks = [slice(*pair) for pair in itertools.pairwise(ends)]
        self.rows_of_tasks, self.size = sum(self._tasks.sizes), ends[-1]
        self._parameters = {leaf.name: leaf.value for leaf in parameters if leaf.value is not None}
        shared = (tuple(self.shapes.items()), tuple(self.constraints.sizes.items()), tuple(self._secondary.sizes))
        self._traced = jax.jit(self._residuals)  # once for all parts of a search
        self.key = (mechanism, tuple(further.sizes), *shared, *(part.key() for part in parts))

    def _need_positions(self, task: Task) -> None:
        """Raise ModelError for a task of velocities, whose error no positions reduce."""
        if not any(isinstance(leaf, State) for leaf in leaves_of(to_expr(task.error(self.space.mechanism)))):
            fix = "pass target=" if isinstance(task, ManipulabilityTask) else "use it in a DifferentialController"
            raise ModelError(
                f"reach expects tasks whose errors depend on positions, got {type(task).__name__}.\n  fix: {fix}"
            )

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def of(*arguments: Any) -> ReachErrors:
        return ReachErrors(*arguments)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ReachErrors) and self.key == other.key

    def numbers(self, length: float) -> Arrays:
        """The numbers that do not belong to the structure: parameters by name, and the weights of all rows.

        Args:
            length: the length l, m, that converts angles.
        """
        weights = self._tasks.weights.copy()
        for block, is_turn in zip(self.blocks, self.turns, strict=True):
            if is_turn:
                weights[block] = length
        rows = {"weights": weights, "secondary": self._secondary.weights, "length": np.asarray(length)}
        return {"parameters": self._parameters, **rows}

    @property
    def has_secondary(self) -> bool:
        return bool(self._secondary.tasks)

    def __call__(self, x: Arrays, targets: Arrays, numbers: Arrays) -> tuple[jax.Array, jax.Array]:
        """The residuals r (m,) and the matrix J (m, n), with r' = -J qd: the errors, but all residuals of constraints,
        violated or not.
        """
        residuals: tuple[jax.Array, jax.Array] = self._traced(x, targets, numbers)
        return residuals

    def _residuals(self, x: Arrays, targets: Arrays, numbers: Arrays) -> tuple[jax.Array, jax.Array]:
        at = {**x, **{f"target of {frame}": T for frame, T in targets.items()}}
        e, J = self._weighted(self._tasks, at, numbers, "weights")
        c, C = self.constraints(x, {}, numbers["parameters"])
        return jnp.concatenate([e, c]), jnp.concatenate([J, -C])

    def active(self, r: jax.Array, J: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The errors e (m,) and their Jacobian, from all residuals. Those of a satisfied constraint are zero."""
        k = self.rows_of_tasks
        violated = r[k:] > 0.0
        c, C = jnp.where(violated, r[k:], 0.0), jnp.where(violated[:, None], J[k:], 0.0)
        return jnp.concatenate([r[:k], c]), jnp.concatenate([J[:k], C])

    def secondary(self, x: Arrays, numbers: Arrays) -> tuple[jax.Array, jax.Array]:
        """The weighted errors and the Jacobian of the secondary tasks."""
        return self._weighted(self._secondary, x, numbers, "secondary")

    @staticmethod
    def _weighted(tasks: TaskRows, x: Arrays, numbers: Arrays, name: str) -> tuple[jax.Array, jax.Array]:
        e, J = tasks(x, {}, numbers["parameters"])
        return numbers[name] * e, numbers[name][:, None] * J
