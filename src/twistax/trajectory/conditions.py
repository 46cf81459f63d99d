"""What is asked at single nodes: values of the states at both ends, and constraints at any node."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..checks import listed, short
from ..errors import ModelError, TrajectoryError
from ..expr import (
    Constraint,
    Equality,
    Expr,
    Inputs,
    Parameter,
    State,
    Time,
    evaluate_all,
    leaves_of,
    refuse_conditions,
)
from ..expr.lie import Compose, Inverse, SE3Log, SO3Log
from ..expr.operations.soft import Asked, hard
from ..system import entry_names, free_name, name_of
from ..system.dynamics import Dynamics
from .statement import bounds_of, check_leaves, limited, without_end

#: An end beyond a limit by less than this share of it is at the limit.
_ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class Conditions:
    """Constraints on a node: inequalities (<= 0) first, then equalities."""

    names: tuple[str, ...]  # one for every entry
    residuals: tuple[Expr, ...]  # canonical
    equality: Array  # which entries are equalities

    def values(self, t: jax.Array, x: Any, params: Any) -> jax.Array:
        inputs = Inputs(t, x, {}, params, t.dtype)
        values = evaluate_all(self.residuals, lambda leaf: leaf.read(inputs))
        return jnp.concatenate([value.reshape(-1) for value in values]) if values else jnp.zeros(0, t.dtype)

    def decided(self, fixed: Mapping[str, Array], free: Iterable[str], at_known_time: bool) -> Array:
        """(entries,) those that nothing can change where these entries of the states are fixed."""
        whole, loose = {name for name, mask in fixed.items() if mask.all()}, set(free)
        found: list[bool] = []
        for residual in self.residuals:
            leaves = list(leaves_of(residual))
            moves = any(
                (isinstance(leaf, State) and leaf.name not in whole)
                or (isinstance(leaf, Parameter) and leaf.name in loose)
                or (isinstance(leaf, Time) and not at_known_time)
                for leaf in leaves
            )
            found += [not moves] * prod(residual.shape)
        return np.array(found, bool)


def conditions(dynamics: Dynamics, place: str, constraints: Mapping[str, Constraint]) -> Conditions:
    """The residuals of constraints on a node, with the place in their names."""
    names: list[str] = []
    residuals: list[Expr] = []
    equality: list[bool] = []
    for own, constraint in sorted(constraints.items(), key=lambda item: isinstance(item[1], Equality)):
        name = f"{place}: {own}"
        check_leaves(dynamics, name, constraint, controls=False)
        residual = residual_of(constraint)
        shape, is_equality = residual.check_shape(), isinstance(constraint, Equality)
        row = residual.canonicalize()
        asked = limited(name, row, is_equality)
        names += itertools.compress(entry_names(name, shape), asked.ravel())
        if asked.any():
            row = row if asked.all() else row[np.nonzero(asked)]
            residuals.append(row if is_equality else without_end(row))
        equality += [is_equality] * int(asked.sum())
    return Conditions(tuple(names), tuple(residuals), np.array(equality, bool))


def residual_of(constraint: Constraint) -> Expr:
    """lhs - rhs; Log(rhs^-1 lhs) where both are rotations or poses, whose entries depend on each other."""
    left, right = constraint.lhs, constraint.rhs
    if isinstance(constraint, Equality) and left.is_group_element and right.is_group_element:
        log = SO3Log if left.shape == (3, 3) else SE3Log
        return log(Compose(Inverse(right), left))
    return constraint.residual()


def split(what: str, given: Any) -> tuple[dict[Any, Any], dict[str, Asked]]:
    """Values and named constraints from what an end may be: a mapping, a constraint, or a list of both."""
    values: dict[Any, Any] = {}
    constraints: dict[str, Asked] = {}
    items: Sequence[Any] = list(given) if isinstance(given, (list, tuple)) else [] if given is None else [given]
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
    """The constraints on inner nodes by name, from `at={node: constraint or a list of them}`."""
    if at is not None and not isinstance(at, Mapping):
        raise ModelError(
            f"at must be a dict from numbers of nodes to constraints, got {short(at)}; e.g. at={{5: p >= 1}}"
        )
    found = {}
    for node, given in (at or {}).items():
        if isinstance(node, bool) or not isinstance(node, (int, np.integer)) or not 0 < node < nodes - 1:
            raise TrajectoryError(
                f"at names the node {short(node)}; inner nodes have the numbers 1 to {nodes - 2}.\n"
                "  fix: conditions on the first and the last node belong to initial= and final="
            )
        values, constraints = split(f"at[{node}]", given)
        if values:
            raise ModelError(
                f"at[{node}] expects constraints, got values of {listed(map(name_of, values))}; e.g. p == 1.0"
            )
        found[int(node)] = constraints
    return found


def end_values(states: Sequence[State], what: str, given: Mapping[Any, Any] | None) -> dict[str, Array | None]:
    """The initial or final value of every state, NaN where an entry is free, None where all are."""
    leaves = {state.name: state for state in states}
    values: dict[str, Array | None] = {name: getattr(state, what) for name, state in leaves.items()}
    if given is not None and not isinstance(given, Mapping):
        raise ModelError(f"{what} must be a mapping from state names to values, got {type(given).__name__}")
    for key, value in (given or {}).items():
        name = name_of(key)
        if name not in leaves:
            raise ModelError(f"{what} names {name!r}; the states are: {listed(leaves, name)}")
        values[name] = leaves[name].boundary(what, value)
    for bound in bounds_of(states):
        array = values[bound.leaf]
        found = np.nan if array is None else array.ravel()[bound.entry]
        excess = bound.sign * (found - bound.limit)
        if array is not None and 0.0 < excess <= _ROUNDING * abs(bound.limit):
            array = values[bound.leaf] = np.array(array)
            array.reshape(-1)[bound.entry] = bound.limit
        elif excess > 0.0:
            symbol = ">" if bound.sign > 0.0 else "<"
            raise TrajectoryError(
                f"the {what} value of {bound.place} must keep its bound, but is {found:.12g}: "
                f"{found:.12g} {symbol} {bound.limit:.12g}.\n"
                "  fix: clip a measured state with np.clip, or state the limit in constraints={...}: then this case "
                "alone is INFEASIBLE"
            )
    return values


@dataclasses.dataclass(frozen=True)
class Ends:
    """Values of the states at both ends, NaN where an entry is free, None where all are."""

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


def ends_of(states: Sequence[State], initial: Any, final: Any) -> Ends:
    """Both ends, checked."""
    first, last = end_values(states, "initial", initial), end_values(states, "final", final)
    fixed = [{s.name: fixed_entries(s, own[s.name]) for s in states} for own in (first, last)]
    return Ends(first, last, *fixed)


def fixed_entries(state: State, value: Array | None) -> Array:
    """(dimension,) which entries of a state's tangent are fixed by an end value.

    A part of an element may be free, for what moves another part leaves it as it is: a turn x Exp([0; w]) keeps the
    position of a pose and a shift x Exp([v; 0]) its attitude.
    """
    if value is None:
        return np.zeros(state.group.dimension, bool)
    if state.group.flat:
        return ~np.isnan(value.ravel())
    fixed = np.ones(state.group.dimension, bool)
    for part in state.group.parts:
        fixed[list(part.entries)] = not np.isnan(value[part.place]).any()
    return fixed
