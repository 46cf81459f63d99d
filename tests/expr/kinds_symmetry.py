"""Whether a model is the same in other units and in other axes: what a check of kinds can see of an error.

A right model maps leaves in other units of kilogram, metre, second and kelvin, and in turned axes of any frame, to
rates in those units and axes. A mutant that still does so differs by a sign or by a factor without unit.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from expr_cases import function_of

import twistax as tx

Array = np.ndarray
_PER_SECOND = tx.kinds.Unit.of("1/s")
_METRE = tx.kinds.Unit.of("m")


def rotation(axis: Any) -> Array:
    return np.asarray(tx.lie.so3.exp(jnp.asarray(axis, float)))


@dataclasses.dataclass(frozen=True)
class Change:
    """New units, so many of which make an old one, and turned axes of one frame."""

    scales: tuple[float, ...] = (1.0,) * 4
    frame: str = ""
    turn: Any = None

    def factor(self, unit: Any) -> float:
        return float(np.prod([s ** float(n) for s, n in zip(self.scales, unit.exponents, strict=True)]))

    def turned(self, frame: str) -> Array:
        return rotation(self.turn) if frame == self.frame else np.eye(3)

    def six(self, frame: str, unit: Any, dual: bool, angular_first: bool) -> Array:
        """The matrix of a six-vector."""
        linear = unit / _METRE if dual else unit * _METRE
        parts = [self.factor(linear) * self.turned(frame), self.factor(unit) * self.turned(frame)]
        a, b = reversed(parts) if angular_first else parts
        zero = np.zeros((3, 3))
        return np.block([[a, zero], [zero, b]])

    def rate_of_group(self, state: Any, angular_first: bool) -> Array:
        source = state.kind.source
        if state.shape == (3, 3):
            return self.factor(_PER_SECOND) * self.turned(source)
        return self.six(source, _PER_SECOND, False, angular_first)

    def linear_map(self, leaf: Any, angular_first: bool) -> Any:
        """What the value of a flat leaf is multiplied by from the left."""
        kind = leaf.kind
        if leaf.shape == (6,):
            return self.six(kind.frame, leaf.unit, kind.space.name == "FORCE", angular_first)
        if isinstance(kind, tx.FreeVector):
            return self.factor(leaf.unit) * self.turned(kind.frame)
        if leaf.shape == (4,) and kind is not None:
            return _of_quaternion(self.turned(kind.to), True) @ _of_quaternion(self.turned(kind.source), False)
        return self.factor(leaf.unit)

    def value(self, leaf: Any, value: Array, angular_first: bool) -> Array:
        kind = leaf.kind
        if isinstance(kind, tx.kinds.Inertia):
            if leaf.shape == (3, 3):
                turn = self.turned(kind.frame)
                return self.factor(leaf.unit) * turn @ value @ turn.T
            of_twist = self.six(kind.frame, _PER_SECOND, False, angular_first)
            of_momentum = self.six(kind.frame, leaf.unit * _PER_SECOND, True, angular_first)
            return of_momentum @ value @ np.linalg.inv(of_twist)
        if leaf.shape == (3, 3):
            return self.turned(kind.to) @ value @ self.turned(kind.source).T
        if leaf.shape == (4, 4):
            moved = value.copy()
            moved[:3, :3] = self.turned(kind.to) @ value[:3, :3] @ self.turned(kind.source).T
            moved[:3, 3] = self.factor(_METRE) * self.turned(kind.to) @ value[:3, 3]
            return moved
        by = self.linear_map(leaf, angular_first)
        return by @ value if np.ndim(by) else by * value


def _of_quaternion(R: Array, left: bool) -> Array:
    """The matrix of multiplying a quaternion by that of R from the left, or by its conjugate from the right."""
    w = np.sqrt(1.0 + np.trace(R)) / 2.0
    x, y, z = (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]) / (4.0 * w)
    if left:
        return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    x, y, z = -x, -y, -z
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


class Model:
    """A right model with numbers, and the changes of units and axes under which it is the same.

    Constants that declare something become parameters, so that they can be in other units and axes.
    """

    def __init__(self, build: Any) -> None:
        self.name = build.__name__
        rates = {state: tx.to_expr(rate) for state, rate in build().items()}
        constants = {
            id(leaf): leaf
            for rate in rates.values()
            for leaf in tx.expr.leaves_of(rate)
            if isinstance(leaf, tx.Constant) and leaf.declares and leaf.kind is not None
        }
        for number, constant in enumerate(constants.values()):
            leaf = tx.Parameter(f"constant{number}", value=constant.value, kind=constant.kind, unit=constant.unit)
            rates = {state: replaced(rate, constant, leaf) for state, rate in rates.items()}
        self.rates = rates
        leaves = [leaf for root in (*rates, *rates.values()) for leaf in tx.expr.leaves_of(root)]
        self.leaves = {leaf.name: leaf for leaf in leaves if not isinstance(leaf, tx.Constant)}
        self.last = any(getattr(leaf, "order", None) == tx.ANGULAR_FIRST for leaf in self.leaves.values())
        self.values = _values(self.leaves)
        self.changes = list(self._changes())

    def _changes(self) -> Iterator[Change]:
        for k in range(4):
            scales = [1.0] * 4
            scales[k] = 1.7
            yield Change(tuple(scales))
        frames = {
            name for leaf in self.leaves.values() if leaf.kind is not None for name in leaf.kind.frames().values()
        }
        for name in sorted(frames):
            change = Change(frame=name, turn=(0.4, -0.3, 0.8))
            if all(self.same(state, rate, change) for state, rate in self.rates.items()):
                yield change

    def same(self, state: tx.State, rate: tx.Expr, change: Change) -> bool:
        """Whether a rate of a state goes with a change."""
        before = evaluated(rate, self.values)
        values = {name: change.value(leaf, self.values[name], self.last) for name, leaf in self.leaves.items()}
        after = evaluated(rate, values)
        flat = state.group.flat
        by = change.linear_map(state, self.last) if flat else change.rate_of_group(state, self.last)
        wanted = (by @ before if np.ndim(by) else by * before) * (change.factor(_PER_SECOND) if flat else 1.0)
        size = np.abs(wanted).max()
        return bool(np.allclose(after, wanted, rtol=1e-7, atol=1e-9 * size))

    def sees(self, state: tx.State, rate: tx.Expr) -> bool:
        """Whether units or axes show that a rate is wrong."""
        return not all(self.same(state, rate, change) for change in self.changes)


def evaluated(rate: tx.Expr, values: Mapping[str, Array]) -> Array:
    return np.asarray(function_of(rate)({name: jnp.asarray(value) for name, value in values.items()})[0])


def replaced(root: tx.Expr, old: tx.Expr, new: tx.Expr) -> tx.Expr:
    """The tree with one object replaced."""
    done: dict[int, tx.Expr] = {}
    for node in tx.expr.postorder(root):
        done[id(node)] = new if node is old else node.with_children([done[id(child)] for child in node.children()])
    return done[id(root)]


def _values(leaves: Mapping[str, Any]) -> dict[str, Array]:
    rng = np.random.default_rng(3)
    values: dict[str, Array] = {}
    for name, leaf in leaves.items():
        turn = rotation(rng.normal(size=3))
        if leaf.is_group_element:
            values[name] = turn if leaf.shape == (3, 3) else tx.pose(rotation=turn, position=rng.normal(size=3))
        elif getattr(leaf, "value", None) is not None:
            values[name] = leaf.value
        else:
            values[name] = rng.uniform(0.3, 1.7, size=leaf.shape)
    return {name: np.asarray(value, float) for name, value in values.items()}
