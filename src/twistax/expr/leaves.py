"""Leaves: the arguments of expressions. Their positions in vectors are determined elsewhere, by layouts."""

from __future__ import annotations

import dataclasses
import numbers
from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import numpy as np

from ..checks import reals
from ..errors import InputError, ModelError, ShapeError
from ..groups import SE3, SO3, Euclidean, Group, Order
from ..groups.arrays import element_defect
from .fields import freeze
from .kinds import rules
from .kinds.declared_values import boundary_value, chosen_values, group_of, shape_of
from .kinds.kinds import Kind, declared
from .kinds.unit import Unit, common_unit, units_in
from .node import Expr, Shape
from .printing.text import matrix_latex, name_latex, number_latex
from .spellings import Bounded, refuse_in_jax


@dataclasses.dataclass(frozen=True)
class Inputs:
    """The arguments of a lowered function, as arrays of one precision: JAX arrays, or NumPy arrays for a jitted
    function.
    """

    t: Any
    x: Mapping[str, Any]
    u: Mapping[str, Any]
    params: Mapping[str, Any]
    dtype: Any


class Leaf(Expr):
    """A named value without children. Leaves with equal names, classes and shapes have equal `key()`."""

    name: str
    abstract = True
    is_leaf = True
    kinds = rules.DECLARED
    #: What it says of its frame and space, and of its unit, for the check of a system. No program depends on them.
    kind: ClassVar[Kind | None] = None
    unit: ClassVar[Unit | None] = None

    def _declare(self, name: str, shape: Shape, **fields: Any) -> None:
        if not isinstance(name, str) or not name:
            raise ModelError(f"{type(self).__name__} needs a name: a non-empty string, got {name!r}")
        for value in fields.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        facts = declared(name, shape, fields.pop("kind", None), fields.pop("unit", None))
        fields |= {what: value for what, value in facts.items() if value is not None}
        self.__dict__.update(name=name, _shape=shape, **fields)
        self._seal()

    def _check_units(self, **values: Any) -> None:
        """Raise ModelError for a quantity of `tx.units` in another unit than the declared one."""
        if self.unit is None or (self.kind is not None and self.kind.space is not None):
            return
        for what, value in values.items():
            for unit in units_in(value):
                if unit != self.unit:
                    raise ModelError(
                        f"{self.name!r} is declared in {self.unit}, but {what}= is in {unit}.\n"
                        f"  fix: give {what}= in {self.unit}, or correct unit="
                    )

    @property
    def declares(self) -> bool:
        """Whether it declares a kind or a unit."""
        return "kind" in self.__dict__ or "unit" in self.__dict__

    def static_key(self) -> tuple[Any, ...]:
        return (self.name, self.shape)

    def read(self, inputs: Inputs) -> jax.Array:
        """The value of this leaf in the arguments of a lowered function."""
        raise NotImplementedError

    def check_in_system(self) -> None:
        """Raise ModelError if this leaf cannot have a value in a system."""

    def to_text(self, *operands: str) -> str:
        return self.name

    def to_latex(self, *operands: str) -> str:
        return name_latex(self.name)


#: How far a constant may be from orthonormal that counts as a rotation.
_ROUND_OFF = 1e-12


class Constant(Leaf):
    """A number or an array. Read-only; it is converted to the precision of the states when evaluated.

    Args:
        value: numbers. A value of `tx.units` includes its unit.
        kind, unit: see `State`.
    Raises:
        ModelError: not numeric, or a traced JAX value (use a Parameter for values that change between calls).
    """

    value: np.ndarray
    cases = ((lambda cls: cls([1.0, -2.0]), {}),)

    def __init__(self, value: Any, *, kind: Kind | None = None, unit: Any = None) -> None:
        if isinstance(value, jax.Array):  # of a function of JAX, perhaps, that was called with expressions
            refuse_in_jax(Expr)
        if callable(value) and not isinstance(value, type):
            raise ModelError(
                f"a Constant expects real numbers, got the function {getattr(value, '__name__', type(value).__name__)}"
                ".\n  fix: to apply it to expressions use tx.Function(f, shape)(x)"
            )
        array = reals("a Constant", value, ModelError).copy()
        if unit is None and kind is None:
            unit = common_unit(value)
        self._declare("constant", array.shape, value=array, kind=kind, unit=unit)
        self._check_units(value=value)
        if isinstance(value, numbers.Integral):
            self.__dict__["_whole"] = True

    @property
    def whole(self) -> bool:
        """Whether it was written as an integer, which is dimensionless."""
        return self.__dict__.get("_whole", False)

    def static_key(self) -> tuple[Any, ...]:
        return (freeze(self.value),)

    def makes_boolean(self, *operands: bool) -> bool:
        return self.value.dtype == bool

    def makes_group_element(self, *operands: bool) -> bool:
        return self.shape in (SO3.shape, SE3.shape) and not self.boolean and element_defect(self.value) < _ROUND_OFF

    @property
    def folded_from(self) -> Expr | None:
        """The structured matrix from which `canonicalize` folded this constant, if any."""
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


class Time(Leaf):
    """The time t, a scalar in s."""

    cases = ((lambda cls, t: cls(), {"t": 0.7}),)

    def __init__(self) -> None:
        self._declare("t", ())

    def read(self, inputs: Inputs) -> jax.Array:
        return inputs.t


class Variable(Bounded, Leaf):
    """A leaf that an optimiser may choose, with bounds, a guess and a scale.

    Attributes:
        min, max: bounds, broadcast to the shape; None for no bound.
        guess: one value of the leaf's shape, or a trajectory (n, *shape).
        scale: typical size of a change, positive, with the shape of the tangent (for a pose: (6,)), or a number.
    """

    min: np.ndarray | None
    max: np.ndarray | None
    guess: np.ndarray | None
    scale: np.ndarray | None
    abstract = True


class State(Variable):
    """A quantity that the system integrates: an array of any shape (Euclidean), or an element of a Lie group.

    The rate of a group-valued state is its left-trivialised (body) velocity: (3,) for SO3, (6,) for SE3.

    Args:
        name: unique among the states of a system.
        shape: shape of the value; () by default. A group determines it.
        group: `tx.SO3`, `tx.SE3` or a custom group; None for $R^m$.
        order: order of the twists of a pose; `tx.LINEAR_FIRST` by default.
        min, max: bounds, for Euclidean states only.
        initial, final: boundary values; None, or an entry None, means free.
        guess, scale: see `Variable`.
        kind: its kind and frames, such as `tx.Twist("body")`, which a system checks.
        unit: unit of all entries, such as "m/s" or `tx.units.metres`; for a six-vector, the unit of its angular part.
    Raises:
        ShapeError: a value of another shape.
        ModelError: bounds on a group, an order for a state that is not a pose, a value that is not in the group, a kind
            with another shape, an invalid unit.

    Example: `g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))`
    """

    group: Group
    initial: np.ndarray | None
    final: np.ndarray | None
    cases = ((lambda cls, x: x, {"x": np.arange(6.0).reshape(2, 3)}),)

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
        kind: Kind | None = None,
        unit: Any = None,
    ) -> None:
        group = group_of(name, shape, group, order)
        if not group.flat and (min is not None or max is not None):
            raise ModelError(
                f"State {name!r} is on {group.name}: bounds on its entries, of shape {group.shape}, are "
                "not defined.\n  fix: use a constraint on an expression of it, e.g. g[2, 3] >= 0"
            )
        ends = {
            "initial": boundary_value(name, "initial", initial, group),
            "final": boundary_value(name, "final", final, group),
        }
        choice = chosen_values(name, group, min, max, guess, scale)
        self._declare(name, group.shape, group=group, **ends, **choice, kind=kind, unit=unit)
        if group.rigid and self.kind is not None and group.shape not in self.kind.shapes:  # no stack of quaternions
            raise ModelError(
                f"{name!r} is on {group.name}, got kind={self.kind}.\n  fix: tx.kinds.Pose(...) on SE3, "
                "tx.kinds.Rotation(...) on SO3"
            )
        self._check_units(initial=initial, final=final, min=min, max=max, guess=guess, scale=scale)

    def replace(self, **changes: Any) -> State:
        # The group of a Euclidean state follows from its shape; shape and order of another from its group.
        implied = ("group",) if self.group.flat else ("shape", "order")
        return super().replace(**(dict.fromkeys(implied) | changes))

    def boundary(self, what: str, value: Any) -> np.ndarray | None:
        """A checked boundary value, "initial" or "final"."""
        return boundary_value(self.name, what, value, self.group)

    @property
    def order(self) -> Order | None:
        """Order of the twists of a pose; None for other states."""
        return self.group.twist_order

    def static_key(self) -> tuple[Any, ...]:
        return (self.name, self.shape, repr(self.group))

    def makes_group_element(self, *operands: bool) -> bool:
        return self.group.rigid

    def read(self, inputs: Inputs) -> jax.Array:
        return inputs.x[self.name]


class Control(Variable):
    """An input that a user or an optimiser chooses at every time, an array of any shape.

    Args:
        name: unique among the controls of a system.
        shape: shape of the value; () by default.
        min, max, guess, scale: see `Variable`.
        kind, unit: see `State`.
    """

    cases = ((lambda cls, u: cls("u", shape=(3,)), {"u": [0.3, -1.0, 2.0]}),)

    def __init__(
        self,
        name: str,
        shape: Shape | int = (),
        *,
        min: Any = None,
        max: Any = None,
        guess: Any = None,
        scale: Any = None,
        kind: Kind | None = None,
        unit: Any = None,
    ) -> None:
        group = Euclidean(shape_of(name, shape))
        self._declare(name, group.shape, **chosen_values(name, group, min, max, guess, scale), kind=kind, unit=unit)
        self._check_units(min=min, max=max, guess=guess, scale=scale)

    def read(self, inputs: Inputs) -> jax.Array:
        return inputs.u[self.name]


class Parameter(Leaf):
    """A value that is constant during a run and may change between runs, such as a mass, an inertia or a table.

    It is an input of the lowered function, unless `bake` makes it a constant of the compiled system.

    Args:
        name: unique among the parameters of a system.
        shape: shape of the value; by default that of `value`.
        value: the default value. A value of `tx.units` includes its unit.
        kind, unit: see `State`.
    Raises:
        ModelError, ShapeError: a value that does not consist of real numbers, or that has another shape.
    """

    value: np.ndarray | None
    cases = ((lambda cls, p: cls("p", value=[1.0, 2.0]), {"p": [0.5, 4.0]}),)

    def __init__(
        self,
        name: str,
        shape: Shape | int | None = None,
        *,
        value: Any = None,
        kind: Kind | None = None,
        unit: Any = None,
    ) -> None:
        if unit is None and kind is None:
            unit = common_unit(value)
        default = value
        if value is not None:
            value = reals(f"{name!r}: value", value, ModelError).astype(np.float64)
        shape = shape_of(name, shape if shape is not None else np.shape(value) if value is not None else ())
        if value is not None and value.shape != shape:
            raise ShapeError(f"{name!r}: value expects shape {shape}, got {value.shape}")
        self._declare(name, shape, value=value, kind=kind, unit=unit)
        self._check_units(value=default)

    def read(self, inputs: Inputs) -> jax.Array:
        if self.name in inputs.params:
            return inputs.params[self.name]
        if self.value is None:
            raise InputError(
                f"Parameter {self.name!r} has no value.\n"
                f"  fix: pass params={{{self.name!r}: ...}} of shape {self.shape}, or declare it with value=..."
            )
        return jax.numpy.asarray(self.value, inputs.dtype)
