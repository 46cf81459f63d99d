"""Conditions at single nodes: values of the states at both ends, and constraints at any node."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...checks import listed, short
from ...errors import ModelError, TrajectoryError
from ...expr import (
    Constant,
    Constraint,
    Control,
    Equality,
    Expr,
    Index,
    Inputs,
    Parameter,
    State,
    Time,
    evaluate_all,
    leaves_of,
    refuse_conditions,
)
from ...expr.lie import Compose, Inverse, SE3Log, SO3Log
from ...expr.operations.soft import Asked, hard
from ...system import entry_names, free_name, name_of
from ...system.dynamics import Dynamics
from ..transcription.point_values import PointValues
from .statement import bounds_of, check_leaves, limited, without_end
from .terms import linear_terms, sum_of

#: An end value beyond a limit by less than this fraction of the limit is moved to the limit.
_ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class Conditions:
    """Constraints at a node: inequalities (<= 0) first, then equalities."""

    names: tuple[str, ...]  # one for every entry
    residuals: tuple[Expr, ...]  # canonical
    equality: Array  # which entries are equalities

    def values(self, t: jax.Array, x: Any, params: Any) -> jax.Array:
        inputs = Inputs(t, x, {}, params, t.dtype)
        values = evaluate_all(self.residuals, lambda leaf: leaf.read(inputs))
        return jnp.concatenate([value.reshape(-1) for value in values]) if values else jnp.zeros(0, t.dtype)

    def determined(self, fixed: Mapping[str, Array], free: Iterable[str], at_known_time: bool) -> Array:
        """(entries,) residuals that are constant if these entries of the states are fixed."""
        fixed_states, loose = {name for name, mask in fixed.items() if mask.all()}, set(free)
        determined: list[bool] = []
        for residual in self.residuals:
            leaves = list(leaves_of(residual))
            is_free = any(
                (isinstance(leaf, State) and leaf.name not in fixed_states)
                or (isinstance(leaf, Parameter) and leaf.name in loose)
                or (isinstance(leaf, Time) and not at_known_time)
                for leaf in leaves
            )
            determined += [not is_free] * prod(residual.shape)
        return np.array(determined, bool)


def conditions(dynamics: Dynamics, place: str, constraints: Mapping[str, Constraint]) -> Conditions:
    """The residuals of the constraints at a node; the suffix of their names states the node."""
    names: list[str] = []
    residuals: list[Expr] = []
    equality: list[bool] = []
    for label, constraint in sorted(constraints.items(), key=lambda item: isinstance(item[1], Equality)):
        name = f"{place}: {label}"
        check_leaves(dynamics, name, constraint, controls=False)
        residual = residual_of(constraint)
        shape, is_equality = residual.check_shape(), isinstance(constraint, Equality)
        row = residual.canonicalize()
        finite = limited(name, row, is_equality)
        names += itertools.compress(entry_names(name, shape), finite.ravel())
        if finite.any():
            row = row if finite.all() else row[np.nonzero(finite)]
            residuals.append(row if is_equality else without_end(row))
        equality += [is_equality] * int(finite.sum())
    return Conditions(tuple(names), tuple(residuals), np.array(equality, bool))


def residual_of(constraint: Constraint) -> Expr:
    """lhs - rhs, or Log(rhs^-1 lhs) if both are rotations or poses, whose entries depend on each other."""
    left, right = constraint.lhs, constraint.rhs
    if isinstance(constraint, Equality) and left.is_group_element and right.is_group_element:
        log = SO3Log if left.shape == (3, 3) else SE3Log
        return log(Compose(Inverse(right), left))
    return constraint.residual()


def stated_values(
    states: Sequence[State], constraints: Iterable[Constraint], params: Mapping[str, Array]
) -> dict[str, Array]:
    """State -> the values that equalities at a node prescribe, NaN for free entries. States without prescribed values
    are omitted.

    An equality prescribes a value if one of its terms is a state, or a part of a state, and its other terms read only
    parameters.
    """
    known, known_values = {state.name: state for state in states}, dict[str, Array]()
    for constraint in constraints:
        equation = _stated_value(constraint) if isinstance(constraint, Equality) else None
        if equation is None:
            continue
        name, index, value = equation
        state = known[name]
        values = known_values.setdefault(name, np.full(state.shape, np.nan))
        numbers = value.value if isinstance(value, Constant) else PointValues.of([value])(np.zeros(1), {}, {}, params)
        values[index] = np.reshape(numbers, value.shape)
    for name, values in known_values.items():
        for part in () if known[name].group.flat else known[name].group.parts:
            if part.unit == "rad" and np.isnan(values[part.place]).any():
                values[part.place] = np.nan  # a part of a rotation prescribes no value
    return known_values


def _stated_value(constraint: Constraint) -> tuple[str, Any, Expr] | None:
    """The state, the index into it and the value that an equality prescribes; None if it prescribes none."""
    left, right = constraint.lhs, constraint.rhs
    moving = (State, Control, Time)
    if left.is_group_element and right.is_group_element:
        terms = [(1.0, left), (-1.0, right)]
    else:
        terms = linear_terms(constraint.residual().canonicalize())
    reading = [(factor, part) for factor, part in terms if any(isinstance(e, moving) for e in leaves_of(part))]
    if len(reading) != 1:
        return None
    ((factor, part),) = reading
    base, index = (part.base, part.index) if isinstance(part, Index) else (part, ...)
    value = sum_of([(-other / factor, term) for other, term in terms if term is not part]).canonicalize()
    shape = constraint.residual().check_shape() if not left.is_group_element else left.shape
    return (base.name, index, value) if isinstance(base, State) and part.shape == value.shape == shape else None


def split(what: str, end: Any) -> tuple[dict[Any, Any], dict[str, Asked]]:
    """The values and the named constraints of `initial=` or `final=`: a mapping, a constraint, or a list of both."""
    values: dict[Any, Any] = {}
    constraints: dict[str, Asked] = {}
    items: Sequence[Any] = list(end) if isinstance(end, (list, tuple)) else [] if end is None else [end]
    for item in items:
        refuse_conditions(what, item)
        if isinstance(item, Mapping):
            values |= item
        elif isinstance(hard(item), Constraint):
            constraints[free_name(repr(hard(item)), constraints)] = item
        else:
            raise ModelError(
                f"{what} expects values by name and constraints, or a list of them, got a {type(item).__name__}; "
                f"e.g. {what}=[{{'V': 0.0}}, g[2, 3] == 0]"
            )
    return values, constraints


def at_nodes(at: Any, nodes: int) -> dict[int, dict[str, Asked]]:
    """The constraints at inner nodes by name, from `at={node: constraint or list of constraints}`."""
    if at is not None and not isinstance(at, Mapping):
        raise ModelError(
            f"at must be a dict from numbers of nodes to constraints, got {short(at)}; e.g. at={{5: p >= 1}}"
        )
    by_node = {}
    for node, conditions_at in (at or {}).items():
        if isinstance(node, bool) or not isinstance(node, (int, np.integer)) or not 0 < node < nodes - 1:
            raise TrajectoryError(
                f"at names the node {short(node)}; inner nodes have the numbers 1 to {nodes - 2}.\n"
                "  fix: conditions on the first and the last node belong to initial= and final="
            )
        values, constraints = split(f"at[{node}]", conditions_at)
        if values:
            raise ModelError(
                f"at[{node}] expects constraints, got values of {listed(map(name_of, values))}; e.g. p == 1.0"
            )
        by_node[int(node)] = constraints
    return by_node


def end_values(
    states: Sequence[State], what: str, stated_end: Mapping[Any, Any] | None, declared: Collection[str]
) -> dict[str, Array | None]:
    """The initial or final value of every state: NaN for free entries, None for a free state."""
    leaves = {state.name: state for state in states}
    values: dict[str, Array | None] = {n: getattr(e, what) if n in declared else None for n, e in leaves.items()}
    if stated_end is not None and not isinstance(stated_end, Mapping):
        raise ModelError(f"{what} must be a mapping from state names to values, got {type(stated_end).__name__}")
    for key, value in (stated_end or {}).items():
        name = name_of(key)
        if name not in leaves:
            raise ModelError(f"{what} names {name!r}; the states are: {listed(leaves, name)}")
        values[name] = leaves[name].boundary(what, value)
    for bound in bounds_of(states):
        array = values[bound.leaf]
        number = np.nan if array is None else array.ravel()[bound.entry]
        excess = bound.sign * (number - bound.limit)
        if array is not None and 0.0 < excess <= _ROUNDING * abs(bound.limit):
            array = values[bound.leaf] = np.array(array)
            array.reshape(-1)[bound.entry] = bound.limit
        elif excess > 0.0:
            symbol = ">" if bound.sign > 0.0 else "<"
            raise TrajectoryError(
                f"the {what} value of {bound.place} must keep its bound, but is {number:.12g}: "
                f"{number:.12g} {symbol} {bound.limit:.12g}.\n"
                "  fix: clip a measured state with np.clip, or state the limit in constraints={...}: then this case "
                "alone is INFEASIBLE"
            )
    return values


@dataclasses.dataclass(frozen=True)
class Ends:
    """Values of the states at both ends: NaN for free entries, None for a free state."""

    initial: Mapping[str, Array | None]
    final: Mapping[str, Array | None]
    initial_fixed: dict[str, Array]  # name -> (dimension,) which entries of its tangent are fixed
    final_fixed: dict[str, Array]

    @property
    def initial_mask(self) -> Array:
        return np.concatenate([*self.initial_fixed.values(), np.zeros(0, bool)])

    @property
    def final_mask(self) -> Array:
        return np.concatenate([*self.final_fixed.values(), np.zeros(0, bool)])


def ends_of(
    states: Sequence[State], initial: Any, final: Any, declared: tuple[Collection[str], Collection[str]] = ((), ())
) -> Ends:
    """The checked values of the states at both ends.

    Args:
        declared: for each end, the names of the states whose declared initial or final values are used.
    """
    first = end_values(states, "initial", initial, declared[0])
    last = end_values(states, "final", final, declared[1])
    fixed = [{s.name: fixed_entries(s, side[s.name]) for s in states} for side in (first, last)]
    return Ends(first, last, *fixed)


def fixed_entries(state: State, value: Array | None) -> Array:
    """(dimension,) which entries of a state's tangent are fixed by an end value.

    A part of an element may be free if motions of the other part do not change it: a rotation x Exp([0; w]) preserves
    the position of a pose, and a translation x Exp([v; 0]) preserves its attitude.
    """
    if value is None:
        return np.zeros(state.group.dimension, bool)
    if state.group.flat:
        return ~np.isnan(value.ravel())
    fixed = np.ones(state.group.dimension, bool)
    for part in state.group.parts:
        fixed[list(part.entries)] = not np.isnan(value[part.place]).any()
    return fixed
