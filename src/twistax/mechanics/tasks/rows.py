"""Tasks and constraints of a mechanism as arrays: errors and residuals, with their Jacobians."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import listed, short
from ...errors import ModelError, ShapeError
from ...expr import Concat, Constant, Control, Expr, Leaf, Parameter, State, Time, Vstack, leaves_of
from ...expr.operations.comparisons import Constraint, Inequality
from ...system.declared import need_finite
from ...system.lower import lower
from ...system.system import constraints_by_name
from .configuration_space import Arrays, ConfigurationSpace
from .task import NUMBERS, Task


class TaskRows:
    """The stacked errors and Jacobians of tasks.

    Attributes:
        sizes: the number of rows of each task.
        weights, gains, damping: by row; the gain is NaN if the task has none.
        expressions: the errors (m,) and the Jacobian (m, n); None without tasks.
    Raises: ModelError for an object that is not a task; ShapeError if the shapes of error and Jacobian do not match.
    """

    def __init__(self, owner: str, space: ConfigurationSpace, tasks: Iterable[Task]) -> None:
        self.tasks, self._dofs = task_list(owner, tasks), space.mechanism.dofs
        for task in self.tasks:
            if not isinstance(task, Task):
                raise ModelError(f"{owner} expects tasks, such as FrameTask, got {short(task)}")
        errors = [task.error(space.mechanism) for task in self.tasks]
        jacobians = [task.jacobian(space.mechanism) for task in self.tasks]
        for task, e, J in zip(self.tasks, errors, jacobians, strict=True):
            if len(e.shape) != 1 or J.shape != (*e.shape, self._dofs):
                kind = type(task).__name__
                raise ShapeError(
                    f"{owner}: {kind} has an error {e.shape} and a Jacobian {J.shape}; expected (m,), (m, {self._dofs})"
                )
        self.sizes = [e.shape[0] for e in errors]
        self.weights, self.gains, self.damping = _numbers(self.tasks, self.sizes)
        self.expressions = (Concat(*errors), Vstack(*jacobians)) if errors else None
        _need_one_target(owner, self.expressions or ())
        self._lowered = lower(list(self.expressions)) if self.expressions else None

    def with_numbers(self, owner: str, tasks: Iterable[Task]) -> TaskRows:
        """The same rows with the weights, gains and damping of other tasks. Raises ModelError if the tasks differ in
        anything else.
        """
        rows = copy.copy(self)
        rows.tasks = task_list(owner, tasks)
        if list(map(_program, rows.tasks)) != list(map(_program, self.tasks)):
            raise ModelError(
                f"{owner}: replace expects the tasks of the controller with another weight, gain or damping.\n"
                "  fix: use dataclasses.replace(task, weight=...), or make a new controller for other tasks"
            )
        rows.weights, rows.gains, rows.damping = _numbers(rows.tasks, rows.sizes)
        return rows

    def __call__(self, x: Arrays, u: Arrays, params: Arrays) -> tuple[jax.Array, jax.Array]:
        """The errors e (m,) and the Jacobian J (m, n)."""
        if self._lowered is None:
            return jnp.zeros(0, dtype_of(x)), jnp.zeros((0, self._dofs), dtype_of(x))
        e, J = self._lowered(0.0, x, *of_leaves(leaves_of(*(self.expressions or ())), u, params))
        return e, J


def task_list(owner: str, tasks: Iterable[Task]) -> tuple[Task, ...]:
    """The tasks of a list. Raises ModelError for another object, such as one task."""
    if not isinstance(tasks, Iterable) or isinstance(tasks, str):
        raise ModelError(f"{owner} expects a list of tasks, got {short(tasks)}.\n  fix: [task] is a list of one task")
    return tuple(tasks)


def _numbers(tasks: Sequence[Task], sizes: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, gains and damping by row."""
    weights = np.concatenate([np.zeros(0), *(task.weights(size) for task, size in zip(tasks, sizes, strict=True))])
    gains = np.repeat([np.nan if task.gain is None else task.gain for task in tasks], sizes)
    return weights, gains, np.repeat([float(task.damping) for task in tasks], sizes)


def _program(task: Any) -> Any:
    """What a task consists of besides its numbers: its class, and the objects that it holds."""
    if not isinstance(task, Task):
        return task
    names = [field.name for field in dataclasses.fields(task) if field.name not in NUMBERS]
    return type(task), tuple((name, id(getattr(task, name))) for name in names)


class ConstraintRows:
    """The residuals of inequalities, satisfied if not positive, with their derivatives along velocities.

    Attributes:
        sizes: the number of rows of each constraint, by name.
        expression: the residuals (k,); None without constraints.
    Raises: ModelError for objects that are not inequalities, or that depend on states other than the positions.
    """

    def __init__(self, owner: str, space: ConfigurationSpace, constraints: Any) -> None:
        self._space = space
        residuals, self.sizes = list[Expr](), dict[str, int]()
        for name, constraint in constraints_by_name(constraints).items():
            if not isinstance(constraint, Constraint) or not isinstance(constraint, Inequality):
                raise ModelError(f"{owner} expects inequalities as constraints, got {name!r}: {short(constraint)}")
            need_finite(f"{owner}: constraint {name!r}", constraint)
            residual = constraint.residual()
            if len(residual.shape) > 1:
                raise ModelError(f"{owner} expects constraints of shape () or (k,), got {name!r} {residual.shape}")
            residuals.append(residual if residual.shape else residual[None])
            self.sizes[name] = residuals[-1].shape[0]
        self.expression = Concat(*residuals) if residuals else None
        self._lowered = None if self.expression is None else lower(self.expression)

    def values(self, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """c (k,)."""
        if self._lowered is None or self.expression is None:
            return jnp.zeros(0, dtype_of(x))
        values: jax.Array = self._lowered(0.0, x, *of_leaves(leaves_of(self.expression), u, params))
        return values

    def __call__(self, x: Arrays, u: Arrays, params: Arrays) -> tuple[jax.Array, jax.Array]:
        """The residuals c (k,) and the matrix C (k, n) with $c' = C qd$."""
        n = self._space.mechanism.dofs
        if self._lowered is None:
            return jnp.zeros(0, dtype_of(x)), jnp.zeros((0, n), dtype_of(x))
        moved = lambda step: self.values(self._space.after(x, step), u, params)  # noqa: E731
        at, back = jax.vjp(moved, jnp.zeros(n, dtype_of(x)))
        # Row by row: the arrays of a batch are too wide to be converted to scalars.
        C = jnp.stack([back(unit)[0] for unit in np.eye(len(at), dtype=at.dtype)])
        return at, C


def of_leaves(leaves: Iterable[Leaf], u: Mapping[str, Any], params: Mapping[str, Any]) -> tuple[Arrays, Arrays]:
    """The controls and parameters that an expression reads."""
    names = {leaf.name for leaf in leaves}
    return {k: v for k, v in u.items() if k in names}, {k: v for k, v in params.items() if k in names}


def inputs_of(
    owner: str, space: ConfigurationSpace, expressions: Sequence[Expr]
) -> tuple[list[Control], list[Parameter]]:
    """The controls and the parameters of expressions. Raises ModelError for states other than the positions."""
    _need_one_target(owner, expressions)
    leaves: dict[tuple[type, str], Leaf] = {}
    for leaf in leaves_of(*expressions):
        if not isinstance(leaf, Constant):
            leaves.setdefault((type(leaf), leaf.name), leaf)
    unknown = [leaf.name for leaf in leaves.values() if isinstance(leaf, Time)]
    unknown += [leaf.name for leaf in leaves.values() if isinstance(leaf, State) and leaf.name not in space.names]
    if unknown:
        raise ModelError(
            f"{owner} expects expressions of positions, controls and parameters, got expressions of {listed(unknown)}"
        )
    return (
        [leaf for leaf in leaves.values() if isinstance(leaf, Control)],
        [leaf for leaf in leaves.values() if isinstance(leaf, Parameter)],
    )


def _need_one_target(owner: str, expressions: Sequence[Expr]) -> None:
    """Raise ModelError if tasks have targets of the same name with different numbers."""
    named: dict[str, Parameter] = {}
    for leaf in leaves_of(*expressions):
        if not isinstance(leaf, Parameter):
            continue
        first, value = (np.asarray(one.value, float) for one in (named.setdefault(leaf.name, leaf), leaf))
        if not np.array_equal(first, value, equal_nan=True):  # NaN represents None
            raise ModelError(
                f"{owner}: two tasks have targets named {leaf.name!r} with different numbers.\n"
                "  fix: remove one task, or pass target=tx.Parameter(name, shape, value=...) with different names"
            )


def dtype_of(x: Arrays) -> Any:
    """The dtype of positions."""
    return next(iter(x.values())).dtype
