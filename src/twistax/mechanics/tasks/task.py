"""The base class of tasks: an error with its Jacobian, a weight and a gain."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import reals, short
from ...errors import ModelError
from ...expr import Control, Expr, Parameter
from ...expr.fields import ExprLike
from ..arguments import of_shape, pose
from ..kinematic_tree import KinematicTree

#: The fields of a task that are numeric arguments in the compiled function of a controller.
NUMBERS = ("weight", "gain", "damping")


@dataclasses.dataclass(frozen=True, eq=False)
class Task(abc.ABC):
    """An aim of a motion: an error, and the velocities that reduce it.

    A task is a linear equation for the velocities qd,

        $J(q) qd = k e(q)$,

    with an error e (m,), a Jacobian J (m, n) such that $e' = -J qd$, and a gain k. To define a task, subclass it and
    define the methods `error` and `jacobian`; a target that changes with time is a `tx.Control`.

    Attributes:
        weight: a number or (m,): the cost is $|weight (J qd - k e)|^2$; in 1/m for positions, 1/rad for angles.
        gain: k, 1/s. None means one over the period of the controller, so that the error vanishes in one step.
        damping: adds $damping |weight k e dt|^2 |qd|^2$ to the cost, which keeps velocities small while errors are
            large (the `lm_damping` of pink).
    Raises: ModelError for numbers that are negative or not finite.
    """

    weight: Any = dataclasses.field(default=1.0, kw_only=True)
    gain: float | None = dataclasses.field(default=None, kw_only=True)
    damping: float = dataclasses.field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        for name in NUMBERS:
            value = getattr(self, name)
            if value is None and name == "gain":
                continue
            array = reals(f"{type(self).__name__}: {name}", value, ModelError)
            if array.ndim > (name == "weight") or not np.isfinite(array).all() or (array < 0.0).any():
                raise ModelError(f"{type(self).__name__} expects {name} to be finite and 0 or more, got {short(value)}")

    @abc.abstractmethod
    def error(self, mechanism: KinematicTree) -> Expr:
        """The error e (m,): the target minus the present value, at the positions `mechanism.q`."""

    @abc.abstractmethod
    def jacobian(self, mechanism: KinematicTree) -> Expr:
        """The Jacobian J (m, n), with $e' = -J qd$ for a constant target."""

    def weights(self, rows: int) -> NDArray[np.float64]:
        """The weight of each row of the error. Raises ModelError for a weight of the wrong length."""
        weight = np.asarray(self.weight, float)
        if weight.shape not in ((), (rows,)):
            raise ModelError(f"{type(self).__name__} expects weight as a number or ({rows},), got {weight.shape}")
        return np.broadcast_to(weight, (rows,))

    def _target(self, name: str, value: ExprLike | None, shape: tuple[int, ...]) -> Expr:
        """The target: for None a Control with this name, for numbers a Parameter with this name,
        else the expression.
        """
        owner = type(self).__name__
        if value is None:
            return Control(name, shape)
        expr = pose(owner, "target", value) if shape == (4, 4) else of_shape(owner, "target", value, shape)
        if isinstance(value, Expr):
            return expr
        numbers = np.asarray(value, float)
        if not np.isfinite(numbers).all():
            raise ModelError(
                f"{owner} expects target to be finite, got {short(value)}.\n"
                "  fix: pass None for a target that is an argument of each call"
            )
        return Parameter(name, shape, value=numbers)
