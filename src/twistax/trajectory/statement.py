"""What a problem asks for: its objective, the rows of its residuals along the path, and its two ends."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Collection, Mapping, Sequence
from math import prod
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..checks import listed
from ..errors import ModelError, ShapeError, TrajectoryError
from ..expr import (
    Constraint,
    Control,
    Equality,
    Expr,
    Inputs,
    Leaf,
    Parameter,
    State,
    Time,
    evaluate_all,
    leaves_of,
    to_expr,
)
from ..groups import Euclidean
from ..lowering import Dynamics
from ..system import free_name, name_of
from .cones import NormControls, without_norms


@dataclasses.dataclass(frozen=True, eq=False)
class Objective:
    """J = phi(T, x(T)) + integral of l(t, x, u) dt, to be minimised or maximised.

    Args:
        final: phi, a scalar expression of states, parameters and `tx.Time()` (which is the final time there).
        running: l, a scalar expression of states, controls, parameters and time.

    Raises:
        ModelError: neither final nor running.
        ShapeError: an expression that is not a scalar.
    """

    final: Expr | None
    running: Expr | None

    #: +1 to minimise, -1 to maximise.
    sign: ClassVar[float] = 1.0

    def __init__(self, final: Any = None, *, running: Any = None) -> None:
        kind = type(self).__name__
        if final is None and running is None:
            raise ModelError(f"{kind} needs an expression of the final state, or running=..., or both")
        for name, value in (("final", final), ("running", running)):
            try:
                expr = None if value is None else to_expr(value)
            except ModelError as error:
                raise ModelError(f"{kind} expects an expression: {error}") from None
            if expr is not None and expr.boolean:
                raise ModelError(f"{kind} expects a number to optimise, got the condition {expr!r}")
            if expr is not None and expr.shape != ():
                raise ShapeError(
                    f"{kind} expects a scalar {name} expression, got shape {expr.shape}",
                    at=repr(expr),
                    hint="index it, or take tx.linalg.Sum or tx.linalg.Norm of it",
                )
            object.__setattr__(self, name, expr)


class Minimize(Objective):
    """Minimise phi(T, x(T)) + integral of l(t, x, u) dt. See `Objective` for the arguments."""


class Maximize(Objective):
    """Maximise phi(T, x(T)) + integral of l(t, x, u) dt. See `Objective` for the arguments."""

    sign = -1.0


# ---- the path ----------------------------------------------------------------------------------------------------


class Reads(enum.Enum):
    """What a constraint depends on, and so at which points of an interval with held controls it has to be asked."""

    NOTHING = "parameters alone: once, at the end"
    CONTROL = "controls alone: once an interval"
    STATE = "states and time: at every point, shared ends once"
    BOTH = "states and controls: at every point, shared ends from both sides"


@dataclasses.dataclass(frozen=True)
class Bound:
    """One finite side of a leaf's box: sign * (value[entry] - limit) <= 0."""

    leaf: str
    entry: int
    sign: float
    limit: float
    place: str
    reads: Reads

    @property
    def name(self) -> str:
        return f"{self.place} {'<=' if self.sign > 0.0 else '>='} {self.limit:g}"


@dataclasses.dataclass(frozen=True)
class PathRows:
    """The rows along the path: the system's constraints without norms that have no slope, then the leaves' boxes."""

    residuals: tuple[Expr, ...]  # <= 0 or = 0
    names: tuple[str, ...]  # of every row; of a constraint that became two rows, twice
    equality: Array  # which rows are equalities
    reads: tuple[Reads, ...]  # of every row
    states: tuple[frozenset[str], ...]  # that every row reads
    timed: Array  # which rows read the time
    free: Array  # which rows read a free parameter
    bounds: tuple[Bound, ...]  # the boxes
    shown: tuple[str, ...]  # the rows as users wrote them: inequalities, equalities, boxes
    shown_equality: Array

    def asked(self, intervals: int, substeps: int) -> Array:
        """Where rows are asked: bool (intervals, substeps + 1, rows). States at a node belong to what follows it."""
        mask = np.ones((intervals, substeps + 1, len(self.names)), bool)
        mask[:, :, [reads is Reads.NOTHING for reads in self.reads]] = False
        mask[:, 1:, [reads is Reads.CONTROL for reads in self.reads]] = False
        mask[:, -1, [reads is Reads.STATE for reads in self.reads]] = False
        return mask

    def decided(self, fixed: Mapping[str, Array], at_known_time: bool) -> Array:
        """(rows,) those that nothing can change at an end where these entries of the states are fixed."""
        whole = {name for name, mask in fixed.items() if mask.all()}
        alone = (Reads.STATE, Reads.NOTHING)
        rows = [reads in alone and states <= whole for reads, states in zip(self.reads, self.states)]
        boxes = [b.reads is Reads.STATE and bool(fixed[b.leaf][b.entry]) for b in self.bounds]
        return np.array([*rows[: len(rows) - len(boxes)], *boxes], bool) & (at_known_time | ~self.timed) & ~self.free


def describe_path(dynamics: Dynamics, norms: NormControls, free: Collection[str]) -> PathRows:
    """The rows of a compiled system, of bounds on norms, and the leaves' boxes; and which read free parameters."""
    functions = dynamics._functions
    residuals: list[Expr] = []
    names: list[str] = []
    equality: list[bool] = []
    reads: list[Reads] = []
    states: list[frozenset[str]] = []
    timed: list[bool] = []
    loose: list[bool] = []
    for kind, own in functions.constraints.items():
        for name, residual in own.items():
            for row in [residual] if kind == "equality" else without_norms(residual):
                entries, leaves = prod(row.shape), list(leaves_of(row))
                residuals.append(row)
                names += [f"{name}[{i}]" for i in range(entries)] if row.shape else [name]
                equality += [kind == "equality"] * entries
                reads += [_reads(leaves)] * entries
                states += [frozenset(leaf.name for leaf in leaves if isinstance(leaf, State))] * entries
                timed += [any(isinstance(leaf, Time) for leaf in leaves)] * entries
                loose += [any(isinstance(leaf, Parameter) and leaf.name in free for leaf in leaves)] * entries
    for name, row in norms.rows:
        residuals.append(row)
        names.append(name)
        equality.append(False)
        reads.append(Reads.CONTROL)
        states.append(frozenset())
        timed.append(False)
        loose.append(any(isinstance(leaf, Parameter) and leaf.name in free for leaf in leaves_of(row)))
    bounds = tuple(bounds_of((*dynamics.states, *dynamics.controls)))
    boxes, named = [b.name for b in bounds], functions.constraint_names
    shown = [np.repeat([False, True], [len(named["inequality"]), len(named["equality"])]), np.zeros(len(boxes), bool)]
    return PathRows(
        residuals=tuple(residuals),
        names=(*names, *boxes),
        equality=np.array([*equality, *[False] * len(boxes)], bool),
        reads=(*reads, *(b.reads for b in bounds)),
        states=(*states, *(frozenset([b.leaf]) for b in bounds)),
        timed=np.array([*timed, *[False] * len(boxes)], bool),
        free=np.array([*loose, *[False] * len(boxes)], bool),
        bounds=bounds,
        shown=(*named["inequality"], *named["equality"], *boxes),
        shown_equality=np.concatenate(shown),
    )


def _reads(leaves: Sequence[Leaf]) -> Reads:
    kinds = [type(leaf) for leaf in leaves]
    if Control not in kinds:
        return Reads.STATE if State in kinds or Time in kinds else Reads.NOTHING
    return Reads.BOTH if State in kinds or Time in kinds else Reads.CONTROL


def bounds_of(leaves: Sequence[State | Control]) -> list[Bound]:
    """Every finite side of the leaves' boxes."""
    found = []
    for leaf in leaves:
        reads = Reads.CONTROL if isinstance(leaf, Control) else Reads.STATE
        for sign, limits in ((1.0, leaf.max), (-1.0, leaf.min)):
            for entry, limit in enumerate([] if limits is None else limits.ravel()):
                if np.isfinite(limit):
                    place = f"{leaf.name}[{entry}]" if leaf.shape else leaf.name
                    found.append(Bound(leaf.name, entry, sign, float(limit), place, reads))
    return found


def violations(rows: Array, equality: Array) -> Array:
    """How far rows are from holding, zero where they do."""
    return np.where(equality, np.abs(rows), np.maximum(rows, 0.0))


def largest_by_name(names: Sequence[str], sizes: Array) -> dict[str, float]:
    """The largest size of each name; names may repeat."""
    found: dict[str, float] = {}
    for name, size in zip(names, sizes):
        found[name] = max(found.get(name, 0.0), float(size))
    return found


# ---- the ends ----------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class FinalRows:
    """Conditions on the final node: inequalities (<= 0) first, then equalities."""

    names: list[str]  # one for every entry
    residuals: list[Expr]  # canonical
    equality: Array  # which entries are equalities

    def values(self, t: jax.Array, x: Any, params: Any) -> jax.Array:
        inputs = Inputs(t, x, {}, params, t.dtype)
        values = evaluate_all(self.residuals, lambda leaf: leaf.read(inputs))
        return jnp.concatenate([value.reshape(-1) for value in values]) if values else jnp.zeros(0, t.dtype)


def split_final(final: Any) -> tuple[dict[Any, Any], dict[str, Constraint]]:
    """Values and named constraints from what `final=` may be: a mapping, a constraint, or a list of both."""
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
                f"final expects values by name and constraints, got a {type(item).__name__}; "
                "e.g. final=[{'V': 0.0}, g[2, 3] == 0]"
            )
    return values, constraints


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
        values[name] = getattr(leaves[name].replace(**{what: value}), what)
    for bound in bounds_of(states):
        array = values[bound.leaf]
        found = np.nan if array is None else array.ravel()[bound.entry]
        if bound.sign * (found - bound.limit) > 0.0:
            symbol = ">" if bound.sign > 0.0 else "<"
            raise TrajectoryError(
                f"the {what} value of {bound.place} must keep its bound, but is {found:g}: "
                f"{found:g} {symbol} {bound.limit:g}"
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
    """(dimension,) which entries of a state's tangent are fixed by an end value."""
    if value is None:
        return np.zeros(state.group.dimension, bool)
    if not isinstance(state.group, Euclidean):
        return np.ones(state.group.dimension, bool)
    return ~np.isnan(value.ravel())


def final_rows(dynamics: Dynamics, constraints: Mapping[str, Constraint]) -> FinalRows:
    """The residuals of the constraints on the final node."""
    names: list[str] = []
    residuals: list[Expr] = []
    equality: list[bool] = []
    for name, constraint in sorted(constraints.items(), key=lambda item: isinstance(item[1], Equality)):
        check_leaves(dynamics, f"final: {name}", constraint, controls=False)
        shape = constraint.check_shape()
        names += [f"{name}[{i}]" for i in range(prod(shape))] if shape else [name]
        residuals.append(constraint.residual().canonicalize())
        equality += [isinstance(constraint, Equality)] * prod(shape)
    return FinalRows(names, residuals, np.array(equality, bool))


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
