"""The objective and the path constraints of a problem."""

from __future__ import annotations

import dataclasses
import enum
import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy import ndarray as Array

from ...errors import ModelError, ShapeError
from ...expr import (
    Constant,
    Control,
    Expr,
    Leaf,
    Parameter,
    State,
    Time,
    Where,
    leaves_of,
    to_expr,
)
from ...expr.operations.comparisons import Complementarity
from ...system import entry_names, need_finite
from ...system.dynamics import Dynamics
from .controls import is_rate
from .terms import linear_terms, norm_bound, without_norms


@dataclasses.dataclass(frozen=True, eq=False)
class Objective:
    """$J = phi(T, x(T)) + integral l(t, x, u) dt$, to be minimised or maximised.

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
            raise ModelError(f"{kind} expects an expression of the final state, running=..., or both")
        for name, value in (("final", final), ("running", running)):
            try:
                expr = None if value is None else to_expr(value)
            except ModelError as error:
                raise ModelError(f"{kind} expects an expression: {error}") from None
            if expr is not None and expr.boolean:
                raise ModelError(f"{kind} expects a numerical expression to optimise, got the condition {expr!r}")
            if expr is not None and expr.shape != ():
                raise ShapeError(
                    f"{kind} expects a scalar {name} expression, got shape {expr.shape}",
                    at=repr(expr),
                    hint="index it, or use tx.linalg.Sum or tx.linalg.Norm",
                )
            object.__setattr__(self, name, expr)

    def __repr__(self) -> str:
        parts = [] if self.final is None else [repr(self.final)]
        return f"{type(self).__name__}({', '.join(parts + [f'running={self.running!r}'] * (self.running is not None))})"


class Minimize(Objective):
    """Minimise phi(T, x(T)) + integral of l(t, x, u) dt. See `Objective` for the arguments."""


class Maximize(Objective):
    """Maximise phi(T, x(T)) + integral of l(t, x, u) dt. See `Objective` for the arguments."""

    sign = -1.0


# ---- the path ----------------------------------------------------------------------------------------------------


class Reads(enum.Enum):
    """The kinds of leaves that a constraint reads, which decide at which points of an interval it is imposed."""

    NOTHING = "parameters alone: once, at the end"
    CONTROL = "controls alone: once an interval"
    STATE = "states and time: at every point, shared ends once"
    ENDS = "states that are linear over each interval: at its ends, shared ends once"
    BOTH = "states and controls: at every point, shared ends from both sides"
    STEP = "states at the end of an interval, and the controls along it: there alone"


@dataclasses.dataclass(frozen=True)
class Bound:
    """One finite limit of an entry of a leaf: sign * (value[entry] - limit) <= 0."""

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
    """The path constraints: those of the system, with norms in smooth form, followed by the limits of leaves."""

    residuals: tuple[Expr, ...]  # <= 0 or = 0
    names: tuple[str, ...]  # one entry for each row; a constraint that became two rows has two entries
    cones: frozenset[str]  # names of the rows in which squares replace norms
    norm_bounds: tuple[tuple[str, float] | None, ...]  # for rows |a|^2 / (c s) <= c s: the name of s, and c
    equality: Array  # which rows are equalities
    reads: tuple[Reads, ...]  # one entry for each row
    states: tuple[frozenset[str], ...]  # leaves that every row reads
    timed: Array  # which rows read the time
    free: Array  # which rows read a free parameter
    bounds: tuple[Bound, ...]  # the boxes
    shown: tuple[str, ...]  # the constraints as users wrote them: inequalities, equalities, limits of leaves
    shown_equality: Array

    def asked(self, intervals: int, substeps: int) -> Array:
        """(intervals, substeps + 1, rows) the points at which each row is imposed; states at a node belong to the next
        interval.
        """
        mask = np.ones((intervals, substeps + 1, len(self.names)), bool)
        mask[:, :, [reads is Reads.NOTHING for reads in self.reads]] = False
        mask[:, 1:, [reads is Reads.CONTROL for reads in self.reads]] = False
        mask[:, -1, [reads is Reads.STATE for reads in self.reads]] = False
        mask[:, 1:, [reads is Reads.ENDS for reads in self.reads]] = False
        mask[:, :-1, [reads is Reads.STEP for reads in self.reads]] = False
        return mask

    @property
    def of_steps(self) -> frozenset[str]:
        """Names of the rows that are imposed only at the ends of intervals, together with the
        controls of the interval.
        """
        return frozenset(name for name, reads in zip(self.names, self.reads) if reads is Reads.STEP)

    def at_nodes(self) -> Array:
        """(rows,) the rows that depend only on a node, not on controls."""
        return np.array([reads in (Reads.STATE, Reads.ENDS, Reads.NOTHING) for reads in self.reads], bool)

    def determined(self, fixed: Mapping[str, Array], at_known_time: bool) -> Array:
        """(rows,) the rows that are constant at an end at which these entries of the states are fixed."""
        fixed_states = {name for name, mask in fixed.items() if mask.all()}
        alone = (Reads.STATE, Reads.ENDS, Reads.NOTHING)
        rows = [reads in alone and states <= fixed_states for reads, states in zip(self.reads, self.states)]
        boxes = [b.reads in (Reads.STATE, Reads.ENDS) and bool(fixed[b.leaf][b.entry]) for b in self.bounds]
        return np.array([*rows[: len(rows) - len(boxes)], *boxes], bool) & (at_known_time | ~self.timed) & ~self.free


def describe_path(
    dynamics: Dynamics, norms: Any, free: Collection[str], straight: Collection[str] = (), *, of_steps: bool = False
) -> PathRows:
    """The path constraints of a compiled system and of `PathBounds`, the limits of leaves, and the rows that read free
    parameters.

    Limits of states that are linear over each interval also hold inside it.

    Args:
        of_steps: whether the method evaluates the rates only at the end of an interval. Then all rows that read states
            and controls are imposed there alone.
    """
    functions = dynamics.functions
    residuals: list[Expr] = []
    rows: list[_Row] = []
    norm_bounds: list[tuple[str, float] | None] = []
    cones = {name for name, _ in norms.rows}
    every = [
        (name, *stands_for)
        for kind, constraints in functions.constraints.items()
        for name, residual in constraints.items()
        for stands_for in norms.asked(name, residual, kind == "equality")
    ]
    for name, residual, is_equality in [*every, *((name, row, False) for name, row in norms.rows)]:
        finite = limited(name, residual, is_equality)
        smooth = [residual] if is_equality else without_norms(residual) if finite.any() else []
        if any(row is not residual for row in smooth):
            cones |= set(entry_names(name, residual.shape))
        for row in smooth:
            left = row if finite.all() else row[np.nonzero(finite)]
            residuals.append(left if is_equality else without_end(left))
            entries = itertools.compress(entry_names(name, row.shape), finite.ravel())
            added = [_row(entry, list(leaves_of(row)), is_equality, free) for entry in entries]
            if of_steps or isinstance(dynamics.system.constraints.get(name), Complementarity):
                added = [it._replace(reads=Reads.STEP) if it.reads is Reads.BOTH else it for it in added]
            norm_bounds += [norm_bound(row)] * len(added)
            rows += added
    bounds = tuple(
        dataclasses.replace(b, reads=Reads.ENDS) if b.leaf in straight else b
        for b in bounds_of((*dynamics.states, *dynamics.controls, *norms.controls))
    )
    boxes, named = [b.name for b in bounds], functions.constraint_names
    rows += [_Row(b.name, False, b.reads, frozenset([b.leaf]), False, False) for b in bounds]
    names, equality, reads, states, timed, loose = zip(*rows) if rows else [()] * 6
    shown = [np.repeat([False, True], [len(named["inequality"]), len(named["equality"])]), np.zeros(len(boxes), bool)]
    return PathRows(
        residuals=tuple(residuals),
        names=names,
        cones=frozenset(cones),
        norm_bounds=(*norm_bounds, *[None] * len(bounds)),
        equality=np.array(equality, bool),
        reads=reads,
        states=states,
        timed=np.array(timed, bool),
        free=np.array(loose, bool),
        bounds=bounds,
        shown=(*named["inequality"], *named["equality"], *boxes),
        shown_equality=np.concatenate(shown),
    )


class _Row(NamedTuple):
    """A row along the path; see `PathRows`."""

    name: str
    equality: bool
    reads: Reads
    states: frozenset[str]
    timed: bool
    free: bool


def _row(name: str, leaves: Sequence[Leaf], is_equality: bool, free: Collection[str]) -> _Row:
    states = frozenset(leaf.name for leaf in leaves if isinstance(leaf, State))
    timed = any(isinstance(leaf, Time) for leaf in leaves)
    is_free = any(isinstance(leaf, Parameter) and leaf.name in free for leaf in leaves)
    reads = Reads.STATE if states or timed else Reads.NOTHING
    if any(isinstance(leaf, Control) for leaf in leaves):
        reads = Reads.BOTH if states or timed else Reads.CONTROL
    return _Row(name, is_equality, reads, states, timed, is_free)


def limited(place: str, residual: Expr, is_equality: bool) -> Array:
    """Which entries of a constraint have a finite limit.

    Raises:
        ModelError: the limit cannot be satisfied.
    """
    numbers = [factor * part.value for factor, part in linear_terms(residual) if isinstance(part, Constant)]
    offset = np.broadcast_to(sum(numbers, np.zeros(())), residual.shape)
    if (np.isinf(offset) if is_equality else offset == np.inf).any():
        raise ModelError(f"{place} expects a limit that a value can satisfy, got an infinite one")
    return np.asarray(offset != -np.inf)


def without_end(residual: Expr) -> Expr:
    """The residual of an inequality; -1 if a parameter sets an infinite limit, so that the constraint has no effect."""
    numbers = [leaf.value for leaf in leaves_of(residual) if isinstance(leaf, Constant)]
    if not any(np.isinf(value).any() for value in numbers):
        return residual
    return Where(residual <= -np.finfo(float).max, -1.0, residual)


def bounds_of(leaves: Sequence[State | Control]) -> list[Bound]:
    """All finite limits of leaves."""
    bounds = []
    for leaf in leaves:
        reads = Reads.CONTROL if isinstance(leaf, Control) else Reads.STATE
        for sign, limits in ((1.0, leaf.max), (-1.0, leaf.min)):
            places = enumerate(entry_names(leaf.name, leaf.shape))
            for (entry, place), limit in zip(places, [] if limits is None else limits.ravel()):
                if np.isfinite(limit):
                    bounds.append(Bound(leaf.name, entry, sign, float(limit), place, reads))
    return bounds


def check_limits(states: Iterable[State]) -> None:
    """Raise ModelError for a state with equal limits, which has no interior for a barrier method; controls may have
    equal limits.
    """
    for state in states:
        if state.min is None or state.max is None:
            continue
        for entry, low, high in zip(entry_names(state.name, state.shape), state.min.ravel(), state.max.ravel()):
            if low == high:
                raise ModelError(
                    f"{entry!r} has equal limits: min and max are {low:g}, so it is a constant.\n"
                    "fix: replace it by the number, or impose an equality in constraints= or final="
                )


def violations(rows: Array, equality: Array) -> Array:
    """The violations of rows; zero for satisfied rows."""
    return np.where(equality, np.abs(rows), np.maximum(rows, 0.0))


def largest_by_name(names: Sequence[str], sizes: Array) -> dict[str, float]:
    """The largest size for each name; names may repeat."""
    return Labels(names).largest(sizes)


class Labels:
    """The distinct names of rows in order of appearance, and the index of each row's name."""

    def __init__(self, names: Iterable[str]) -> None:
        numbers: dict[str, int] = {}
        self.of_rows = np.array([numbers.setdefault(str(name), len(numbers)) for name in names], int)
        self.names = list(numbers)

    def largest(self, sizes: Array) -> dict[str, float]:
        """The largest size for each name, at least zero."""
        largest = np.zeros(len(self.names))
        np.fmax.at(largest, self.of_rows, sizes)
        return dict(zip(self.names, largest.tolist()))


def check_leaves(dynamics: Dynamics, place: str, expr: Expr, *, controls: bool) -> None:
    """Raise ModelError if an expression reads something that the compiled system does not have, or is never finite."""
    need_finite(place, expr)
    known: dict[str, Leaf] = {leaf.name: leaf for leaf in (*dynamics.states, *dynamics.controls, *dynamics.parameters)}
    baked = {leaf.name for leaf in dynamics.system.parameters} - set(known)
    for leaf in leaves_of(expr):
        if isinstance(leaf, Control) and not controls:
            raise ModelError(
                f"{place} reads the control {leaf.name!r}, which has no value at a node, not even at the final one.\n"
                "  fix: make it a constraint of the system, or a running cost"
            )
        if is_rate(leaf, dynamics.controls):
            raise ModelError(
                f"{place} reads the {leaf.name}, but the control is piecewise constant (held).\n"
                f"  fix: controls={{{leaf.name!r}: tx.trajectory.Linear()}}"
            )
        if isinstance(leaf, (State, Control)) and (leaf.name not in known or known[leaf.name].key() != leaf.key()):
            raise ModelError(f"{place} reads {leaf.name!r}, which the system does not have")
        if isinstance(leaf, Parameter) and leaf.name in baked:
            raise ModelError(
                f"{place} reads the parameter {leaf.name!r}, which is a constant of the compiled dynamics (bake=).\n"
                "  fix: use its value, or do not bake it"
            )
