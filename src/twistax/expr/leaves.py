"""Leaves: what an expression is a function of. Where a leaf sits in a vector is a layout's business, not the leaf's."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from ..errors import InputError, ModelError
from ..groups import SE3, SO3, Euclidean, Group, Order
from .fields import freeze
from .leaf_values import (
    ROUND_OFF,
    boundary_of,
    bounds_of,
    constant_of,
    defect_of,
    group_of,
    guess_of,
    scale_of,
    shape_of,
    value_of,
)
from .node import Example, Expr, Shape
from .printing import matrix_latex, number_latex


@dataclasses.dataclass(frozen=True)
class Inputs:
    """The arguments of a lowered function, as arrays of one precision."""

    t: jax.Array
    x: Mapping[str, jax.Array]
    u: Mapping[str, jax.Array]
    params: Mapping[str, jax.Array]
    dtype: Any


class Leaf(Expr):
    """A named value without children. Equal names, kinds and shapes mean the same leaf to `key()`."""

    name: str
    abstract = True
    is_leaf = True

    def _declare(self, name: str, shape: Shape, **fields: Any) -> None:
        if not isinstance(name, str) or not name:
            raise ModelError(f"{type(self).__name__} needs a name: a non-empty string, got {name!r}")
        self.__dict__.update(name=name, _shape=shape, **fields)
        self._seal()

    def static_key(self) -> tuple[Any, ...]:
        return (self.name, self.shape)

    def read(self, inputs: Inputs) -> jax.Array:
        """This leaf's value among a lowered function's arguments."""
        raise NotImplementedError

    def to_text(self, *operands: str) -> str:
        return self.name

    def to_latex(self, *operands: str) -> str:
        head, _, tail = self.name.partition("_")
        symbol = head if len(head) == 1 else rf"\mathrm{{{head}}}"
        tail = tail.replace("_", r"\_")
        return f"{symbol}_{{\\mathrm{{{tail}}}}}" if tail else symbol


class Constant(Leaf):
    """A number or an array. Read-only; takes the precision of the states when evaluated.

    Raises:
        ModelError: not numeric, or a traced JAX value (use a Parameter for what changes between calls).
    """

    value: np.ndarray

    def __init__(self, value: Any) -> None:
        shape, array = constant_of(value)
        self._declare("constant", shape, value=array)

    def static_key(self) -> tuple[Any, ...]:
        return (freeze(self.value),)

    @property
    def boolean(self) -> bool:
        return self.value.dtype == bool

    def makes_group_element(self, *operands: bool) -> bool:
        group = {SO3.shape: SO3, SE3.shape: SE3}.get(self.shape)
        return group is not None and not self.boolean and defect_of(self.value, group) < ROUND_OFF

    @property
    def folded_from(self) -> Expr | None:
        """The structured matrix whose numbers these are, if `canonicalize` made them of one."""
        origin: Expr | None = self.__dict__.get("_folded_from")
        return origin

    def applied_to(self, vector: Expr) -> Expr | None:
        origin = self.folded_from
        return None if origin is None else origin.applied_to(vector)

    def transposed(self) -> Expr | None:
        origin = self.folded_from
        return None if origin is None else origin.transposed()

    def inverted(self) -> Expr | None:
        origin = self.folded_from
        return None if origin is None else origin.inverted()

    def read(self, inputs: Inputs) -> jax.Array:
        return jax.numpy.asarray(self.value, bool if self.value.dtype == bool else inputs.dtype)

    def to_text(self, *operands: str) -> str:
        if self.value.size <= 6:
            return np.array2string(self.value, separator=", ").replace("\n", "")
        return f"Constant{self.shape}"

    def to_latex(self, *operands: str) -> str:
        if self.value.ndim == 0:
            return number_latex(self.value[()])
        if self.value.size > 36 or self.value.ndim > 2:
            sizes = r" \times ".join(map(str, self.shape))
            return rf"\mathrm{{const}}_{{{sizes}}}"
        rows = self.value.reshape(-1, 1) if self.value.ndim == 1 else self.value
        return matrix_latex([[number_latex(v, 4) for v in row] for row in rows])

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(Constant([1.0, -2.0]), {})]


class Time(Leaf):
    """The time t, a scalar in s."""

    def __init__(self) -> None:
        self._declare("t", ())

    def read(self, inputs: Inputs) -> jax.Array:
        return inputs.t

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(Time(), {"t": 0.7})]


class Variable(Leaf):
    """A leaf an optimiser may choose: bounds, guess and scale travel with it.

    Attributes:
        min, max: bounds, broadcast to the shape; None where there is none.
        guess: one value of the leaf's shape, or a trajectory (n, *shape) of it.
        scale: typical size of a change, positive, of the tangent's shape (for a pose: (6,) or a number).
    """

    min: np.ndarray | None
    max: np.ndarray | None
    guess: np.ndarray | None
    scale: np.ndarray | None
    abstract = True


class State(Variable):
    """What the system integrates: Euclidean of any shape, or an element of a Lie group.

    The rate of a group-valued state is its left-trivialised (body) velocity: (3,) for SO3, (6,) for SE3.

    Args:
        name: unique among the states of a system.
        shape: shape of the value; () if left out. A group brings its own.
        group: `tx.SO3` or `tx.SE3`; None for R^m.
        order: order of the twists of a pose; `tx.LINEAR_FIRST` unless given.
        min, max: bounds, Euclidean states only.
        initial, final: boundary values; None (or a None entry) leaves free.
        guess, scale: see `Variable`.
    Raises:
        ShapeError: a value does not fit the shape.
        ModelError: bounds on a group, an order without a pose, a value that is not in the group.
    """

    group: Group
    initial: np.ndarray | None
    final: np.ndarray | None

    def __init__(
        self,
        name: str,
        shape: Shape | int | None = None,
        *,
        group: Group | None = None,
        order: Order | None = None,
        min: Any = None,
        max: Any = None,
        initial: Any = None,
        final: Any = None,
        guess: Any = None,
        scale: Any = None,
    ) -> None:
        group = group_of(name, shape, group, order)
        if not isinstance(group, Euclidean) and (min is not None or max is not None):
            raise ModelError(
                f"State {name!r} lives on {group.name}: a box of {group.shape} entries has no meaning there.\n"
                "  fix: constrain an expression of it, e.g. g[2, 3] >= 0"
            )
        self._declare(
            name,
            group.shape,
            group=group,
            **bounds_of(name, group.shape, min, max),
            initial=boundary_of(name, "initial", initial, group),
            final=boundary_of(name, "final", final, group),
            guess=guess_of(name, guess, group.shape),
            scale=scale_of(name, scale, group),
        )

    def replace(self, **changes: Any) -> State:
        # The group of a Euclidean state follows from its shape; shape and order of another from its group.
        implied = ("group",) if isinstance(self.group, Euclidean) else ("shape", "order")
        return super().replace(**(dict.fromkeys(implied) | changes))

    @property
    def order(self) -> Order | None:
        """Order of the twists of a pose; None for other states."""
        return getattr(self.group, "order", None)

    def static_key(self) -> tuple[Any, ...]:
        return (self.name, self.shape, repr(self.group))

    def makes_group_element(self, *operands: bool) -> bool:
        return not isinstance(self.group, Euclidean)

    def read(self, inputs: Inputs) -> jax.Array:
        return inputs.x[self.name]

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(State("x", shape=(2, 3)), {"x": np.arange(6.0).reshape(2, 3)})]


class Control(Variable):
    """What an engineer or an optimiser chooses at every time; Euclidean of any shape.

    Args:
        name: unique among the controls of a system.
        shape: shape of the value; () if left out.
        min, max, guess, scale: see `Variable`.
    """

    def __init__(
        self,
        name: str,
        shape: Shape | int = (),
        *,
        min: Any = None,
        max: Any = None,
        guess: Any = None,
        scale: Any = None,
    ) -> None:
        shape = shape_of(name, shape)
        self._declare(
            name,
            shape,
            **bounds_of(name, shape, min, max),
            guess=guess_of(name, guess, shape),
            scale=scale_of(name, scale, Euclidean(shape)),
        )

    def read(self, inputs: Inputs) -> jax.Array:
        return inputs.u[self.name]

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(Control("u", shape=(3,)), {"u": np.array([0.3, -1.0, 2.0])})]


class Parameter(Leaf):
    """A value fixed during a run and free between runs: mass, inertia, a table.

    It is an input of the lowered function, not a constant, unless it is baked in.

    Args:
        name: unique among the parameters of a system.
        shape: shape of the value; taken from `value` if left out.
        value: used when a call gives none.
    """

    value: np.ndarray | None

    def __init__(self, name: str, shape: Shape | int | None = None, *, value: Any = None) -> None:
        if shape is None:
            shape = () if value is None else np.shape(value)
        shape = shape_of(name, shape)
        self._declare(name, shape, value=value_of(name, "value", value, shape))

    def read(self, inputs: Inputs) -> jax.Array:
        if self.name in inputs.params:
            return inputs.params[self.name]
        if self.value is None:
            raise InputError(
                f"Parameter {self.name!r} has no value.\n"
                f"  fix: pass params={{{self.name!r}: ...}} of shape {self.shape}, or declare it with value=..."
            )
        return jax.numpy.asarray(self.value, inputs.dtype)

    @classmethod
    def example(cls) -> list[Example]:
        return [Example(Parameter("p", value=[1.0, 2.0]), {"p": np.array([0.5, 4.0])})]
