"""What a user says about the ends of a trajectory, checked and taken apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..errors import ModelError, TrajectoryError
from ..expr import Constraint, Control, Equality, Expr, Leaf, Parameter, State, leaves_of
from ..groups import Euclidean
from ..lowering import Dynamics
from ..system import free_name, name_of
from .rows import names_of

__all__ = ["FinalRows", "check_leaves", "end_values", "final_rows", "split_final"]


@dataclasses.dataclass(frozen=True)
class FinalRows:
    """Conditions on the final node: inequalities (<= 0) first, then equalities.

    Attributes:
        names: one for every entry.
        residuals: canonical expressions.
        equalities: how many entries, from the end, are equalities.
    """

    names: list[str]
    residuals: list[Expr]
    equalities: int


def split_final(final: Any) -> tuple[dict[Any, Any], dict[str, Constraint]]:
    """Values and named constraints from what `final=` may be: a mapping, a constraint, or a list of both.

    Raises:
        ModelError: something else.
    """
    values: dict[Any, Any] = {}
    constraints: dict[str, Constraint] = {}
    items: Sequence[Any] = list(final) if isinstance(final, (list, tuple)) else [] if final is None else [final]
    for item in items:
        if isinstance(item, Mapping):
            values |= item
        elif isinstance(item, Constraint):
            constraints[free_name(repr(item), constraints)] = item
        else:
            raise ModelError(
                f"final holds a {type(item).__name__}; it may hold values by name and constraints, "
                "e.g. final=[{'V': 0.0}, g[2, 3] == 0]"
            )
    return values, constraints


def end_values(states: Sequence[State], what: str, given: Mapping[Any, Any] | None) -> dict[str, Array | None]:
    """The initial or final value of every state, NaN where an entry is free, None where all are.

    Raises:
        ModelError: an unknown name, or a value that is not in the group.
        ShapeError: a wrong shape.
        TrajectoryError: a value outside the box of its state.
    """
    leaves = {state.name: state for state in states}
    values: dict[str, Array | None] = {name: getattr(state, what) for name, state in leaves.items()}
    if given is not None and not isinstance(given, Mapping):
        raise ModelError(f"{what} must be a mapping from state names to values, got {type(given).__name__}")
    for key, value in (given or {}).items():
        name = name_of(key)
        if name not in leaves:
            raise ModelError(f"{what} names {name!r}; the states are: {', '.join(leaves)}")
        values[name] = getattr(leaves[name].replace(**{what: value}), what)
    for name, array in values.items():
        if array is not None:
            _check_box(leaves[name], what, array)
    return values


def _check_box(leaf: State, what: str, value: Array) -> None:
    for limit, symbol, beyond in ((leaf.max, ">", np.greater), (leaf.min, "<", np.less)):
        if limit is not None and beyond(value, limit).any():
            entry = int(np.flatnonzero(beyond(value, limit))[0])
            place = f"{leaf.name}[{entry}]" if leaf.shape else leaf.name
            raise TrajectoryError(
                f"the {what} value of {place} is {value.ravel()[entry]:g}, which violates its bound: "
                f"{value.ravel()[entry]:g} {symbol} {limit.ravel()[entry]:g}"
            )


def fixed_entries(state: State, value: Array | None) -> Array:
    """(dimension,) which entries of a state's tangent are fixed by an end value."""
    if value is None:
        return np.zeros(state.group.dimension, bool)
    if not isinstance(state.group, Euclidean):
        return np.ones(state.group.dimension, bool)
    return ~np.isnan(value.ravel())


def final_rows(dynamics: Dynamics, constraints: Mapping[str, Constraint]) -> FinalRows:
    """The residuals of the constraints on the final node.

    Raises:
        ModelError: a leaf the system does not have, or a control (it has no value at the final node).
        ShapeError: sides that do not fit.
    """
    ordered = {n: c for n, c in constraints.items() if not isinstance(c, Equality)}
    equalities = {n: c for n, c in constraints.items() if isinstance(c, Equality)}
    for name, constraint in constraints.items():
        check_leaves(dynamics, f"final: {name}", constraint, controls=False)
        constraint.check_shape()
    residuals = [c.residual().canonicalize() for c in (*ordered.values(), *equalities.values())]
    names = names_of(ordered | equalities)
    return FinalRows(names, residuals, len(names_of(equalities)))


def check_leaves(dynamics: Dynamics, place: str, expr: Expr, *, controls: bool) -> None:
    """Raise ModelError if an expression reads something the compiled system cannot give it."""
    known: dict[str, Leaf] = {leaf.name: leaf for leaf in (*dynamics.states, *dynamics.controls, *dynamics.parameters)}
    baked = {leaf.name for leaf in dynamics.system.parameters} - set(known)
    for leaf in leaves_of(expr):
        if isinstance(leaf, Control) and not controls:
            raise ModelError(
                f"{place} reads the control {leaf.name!r}, which has no value at the final node.\n"
                "  fix: make it a constraint of the system, or a running cost"
            )
        if isinstance(leaf, (State, Control)) and (leaf.name not in known or known[leaf.name].key() != leaf.key()):
            raise ModelError(f"{place} reads {leaf.name!r}, which the system does not have")
        if isinstance(leaf, Parameter) and leaf.name in baked:
            raise ModelError(
                f"{place} reads the parameter {leaf.name!r}, which was baked into the dynamics.\n"
                "  fix: use its value, or do not bake it"
            )
        if isinstance(leaf, Parameter) and leaf.name not in known and leaf.value is None:
            raise ModelError(f"{place} reads the parameter {leaf.name!r}, which has no value")
