"""The bridge for functionals of the whole path: integrals, extremes and initial values.

An integral becomes a state whose rate is the integrand (Bolza form becomes Mayer form). If the problem minimises the
integral, each norm of controls in the integrand is replaced by a bound, an additional control, so that the integrand is
smooth. The largest value of an expression becomes a free parameter s with expression <= s along the path. An initial
value becomes a constant state that equals the initial state at the first node. Names that users defined are kept.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ....errors import ModelError
from ....expr import (
    Constant,
    Constraint,
    Control,
    Equality,
    Expr,
    Leaf,
    Parameter,
    State,
    leaves_of,
)
from ....expr.graph import substitute
from ....system import free_name
from ....system.dynamics import Dynamics
from ..controls import Linear, Spline, is_rate
from ..functionals import Extreme, Functional, Initial, Integral
from ..statement import Objective, check_leaves
from ..terms import Term, bound_row, bounds_along, is_mixed, is_size, linear_terms, sum_of
from .bridge import Bridge, Path, Statement, extended


@dataclasses.dataclass(frozen=True)
class InPhase:
    """The properties of the whole problem that the reformulation of a phase depends on.

    Attributes:
        name: prefix of the names of the parameters for extremes.
        carried: names of initial states of the first phase that this phase or a later one reads.
        first, last: whether the path starts or ends in this phase.
    """

    name: str = ""
    carried: tuple[Initial, ...] = ()
    first: bool = True
    last: bool = True


class LiftedFunctionals(Bridge):
    """A problem whose functionals are replaced by states and parameters.

    Args:
        statement: the problem with functionals.
        within: the properties of the whole problem.

    Attributes:
        states: the states of the original system.
        integrals, starts: additional states by name, and the integral or the initial value that each represents.
        extremes: name of the path constraint -> the extreme, and the name of its parameter.
        bounds: name of an additional control -> the norm of controls that it bounds.
        loose: names of the integrals with such bounds; the state may exceed the integral that it represents.

    Raises:
        ModelError: a functional where it is not defined, or one that would be unbounded.
    """

    def __init__(self, statement: Statement, within: InPhase = InPhase()) -> None:
        dynamics = statement.dynamics
        self.states = dynamics.states
        self._within, self._smooth = within, frozenset(statement.controls)
        self._taken = {leaf.name for leaf in (*dynamics.states, *dynamics.controls, *dynamics.system.parameters)}
        self._exchange: dict[str, Expr] = {}
        self._rates: dict[State, Expr] = {}
        self.integrals: dict[str, Integral] = {}
        self.starts: dict[str, State] = {}
        self.extremes: dict[str, tuple[Extreme, str]] = {}
        self.bounds: dict[str, Expr] = {}
        self.loose: set[str] = set()
        self._rows: dict[str, Constraint] = {}
        _check_places(statement)
        statement = dataclasses.replace(statement, objective=_with_running(statement.objective))
        later = [c for k, rows in statement.rows.items() if k for c in rows.values()]
        self._low = _pushed_down(statement.objective, later)
        costs = (*within.carried, statement.objective.final, statement.objective.running)
        for leaf in _functionals([*(e for e in costs if e is not None), *later]):
            self._add(dynamics, leaf)
        if self._exchange:
            statement = statement.substituted(lambda e, _: self._put(e))
            statement = dataclasses.replace(statement, dynamics=extended(dynamics, self._rates, self._rows))
        if within.first and self.starts:
            known = {s.name: s for s in self._rates}
            begin = {f"{s.name} == {name}": s == known[name] for name, s in self.starts.items()}
            statement = dataclasses.replace(statement, rows={**statement.rows, 0: {**statement.rows[0], **begin}})
        controls = {**statement.controls, **self._smooth_bounds(statement.controls)}
        self.statement = dataclasses.replace(statement, controls=controls)
        self.free = {name: (None, None) for _, name in self.extremes.values()}

    def _smooth_bounds(self, controls: Mapping[str, Spline]) -> dict[str, Spline]:
        """The continuous controls that bound norms of continuous controls, with the same interpolation."""
        splines = dict[str, Spline]()
        for name, part in self.bounds.items():
            degrees = [
                controls[e.name].degree for e in leaves_of(part) if isinstance(e, Control) and e.name in controls
            ]
            if degrees:
                splines[name] = Spline(max(degrees)) if max(degrees) > 1 else Linear()
        return splines

    def complete(self, guess: Path) -> None:
        known = {name: guess.xs[s.name] for name, s in self.starts.items() if self._within.first}
        guess.xs |= {name: np.array(np.broadcast_to(a[0], a.shape)) for name, a in known.items()}
        guess.add_bounds(self.bounds)

    def parameters(self, guess: Path, phase: Any) -> dict[str, Array]:
        if not self.extremes:
            return {}
        # Rows may have any sign, so controls close to zero are tried with both signs.
        rows = [phase.shown_along(path) for path in (guess, guess.sized(), guess.sized(-1.0))]
        return self.extremes_of(np.concatenate(rows), phase.path.shown, guess.params)

    def forward(self, path: Path) -> None:
        path.us |= bounds_along(self.bounds, path.us, path.params)

    def back(self, xs: dict[str, Any], us: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        return {s.name: xs[s.name] for s in self.states}, {n: a for n, a in us.items() if n not in self.bounds}

    def extremes_of(self, rows: Array, names: Sequence[str], params: Mapping[str, Array]) -> dict[str, Array]:
        """Name of the parameter of an extreme -> the value of the extreme, from path rows (points, rows) with these
        names.
        """
        extremes = {}
        for row, (leaf, name) in self.extremes.items():
            entries = [k for k, shown in enumerate(names) if shown == row or shown.startswith(f"{row}[")]
            extremes[name] = np.asarray(params[name] + leaf.sign * rows[:, entries].max())
        return extremes

    # ---- what becomes of a functional ---------------------------------------------------------------------------

    def _add(self, dynamics: Dynamics, leaf: Functional) -> None:
        """Replace a functional by a state or a parameter, unless that is done already."""
        if leaf.key() in self._exchange:
            return
        for part in _functionals([leaf.operand]):
            if isinstance(part, Extreme):
                raise ModelError(f"{leaf!r} reads {part!r}, which no constraint or objective bounds")
            self._add(dynamics, part)
        before = len(self.bounds)
        operand = self._put(self._bounded(leaf) if leaf.key() in self._low else leaf.operand)
        for read in leaves_of(leaf.operand):
            known = isinstance(read, Functional) or is_rate(read, dynamics.controls)
            if not known and (self._within.first or not isinstance(leaf, Initial)):
                check_leaves(dynamics, repr(leaf), read, controls=True)
        front = f"{self._within.name}: " if self._within.name and isinstance(leaf, Extreme) else ""
        name = free_name(front + leaf.name, self._taken)
        self._taken.add(name)
        if isinstance(leaf, Extreme):
            bound = Parameter(name)
            limit = operand <= bound if leaf.sign > 0.0 else operand >= bound
            shown = leaf.operand <= leaf if leaf.sign > 0.0 else leaf.operand >= leaf
            row = free_name(repr(shown), self._rows.keys() | dynamics.system.constraints.keys())
            self._rows[row], self.extremes[row] = limit, (leaf, name)
            self._exchange[leaf.key()] = bound
        elif isinstance(leaf, Integral):
            state = State(name, leaf.shape, initial=np.zeros(leaf.shape))
            self._rates[state], self.integrals[name], self._exchange[leaf.key()] = operand, leaf, state
            self.loose |= {name} if len(self.bounds) > before else set()
        elif isinstance(leaf, Initial):
            group, flat = leaf.operand.group, leaf.operand.group.flat
            state = State(name, leaf.shape, group=None if flat else group, scale=leaf.operand.scale)
            self._rates[state] = Constant(np.zeros(group.tangent_shape))
            self.starts[name], self._exchange[leaf.key()] = leaf.operand, state

    def _bounded(self, leaf: Functional) -> Expr:
        """The integrand with a bound in place of each norm whose controls are all piecewise constant, or all
        continuous.
        """
        terms: list[Term] = []
        for factor, part in linear_terms(leaf.operand.canonicalize()):
            if is_size(part) and factor > 0.0 and not is_mixed(part, self._smooth):
                bound = Control(free_name(f"bound on {part!r} in {leaf!r}", self._taken), min=0.0)
                self._taken.add(bound.name)
                self.bounds[bound.name], self._rows[bound.name] = part, bound_row(part, bound) <= 0.0
                terms.append((factor, bound))
            else:
                terms.append((factor, part))
        return sum_of(terms).canonicalize()

    def _put(self, expr: Expr) -> Expr:
        return substitute(expr, self._exchange)


def _check_places(statement: Statement) -> None:
    """Raise ModelError for a functional where it is not defined, or whose bound would be unbounded."""
    objective = statement.objective
    for node, rows in statement.rows.items():
        for name, constraint in rows.items():
            for leaf in _functionals([constraint]):
                if node == 0:
                    raise ModelError(
                        f"initial reads {leaf!r}, which is not defined at the start of a path.\n  fix: use it in final="
                    )
                if node < statement.last and isinstance(leaf, Extreme):
                    raise ModelError(
                        f"{name} is a condition at a node, but {leaf!r} is a functional of the whole path.\n"
                        "  fix: use it in final="
                    )
    for leaf in _functionals([] if objective.running is None else [objective.running]):
        if not isinstance(leaf, Initial):
            raise ModelError(
                f"the running cost reads {leaf!r}, which is a functional of the whole path.\n"
                "  fix: add it to the objective at the end"
            )
    if objective.final is not None:
        _check_pushed("the objective", objective.final.canonicalize(), objective.sign)
    for name, constraint in statement.rows[statement.last].items():
        if any(isinstance(leaf, Extreme) for leaf in _functionals([constraint])):
            sign = 0.0 if isinstance(constraint, Equality) else 1.0
            _check_pushed(f"final: {name}", constraint.residual().canonicalize(), sign)


def functionals_of(*exprs: Expr) -> list[Functional]:
    """All functionals in expressions without repetition, nested ones included."""
    functionals: dict[str, Functional] = {}
    for leaf in _functionals(exprs):
        functionals.setdefault(leaf.key(), leaf)
        functionals |= {inner.key(): inner for inner in functionals_of(leaf.operand)}
    return list(functionals.values())


def _functionals(exprs: Iterable[Expr]) -> list[Functional]:
    leaves: list[Leaf] = [leaf for expr in exprs for leaf in leaves_of(expr)]
    return [leaf for leaf in leaves if isinstance(leaf, Functional)]


def _check_pushed(place: str, expr: Expr, sign: float) -> None:
    """Raise ModelError unless decreasing sign * expr decreases every maximum in it and increases every minimum.

    Otherwise the variable that bounds the extreme would be unbounded.
    """
    for factor, part in linear_terms(expr):
        for leaf in _functionals([part]):
            pushed_by = sign * factor if part.key() == leaf.key() else 0.0
            if isinstance(leaf, Extreme) and not pushed_by * leaf.sign > 0.0:
                down = leaf.sign > 0.0
                pushed = ("small", "<=", "down") if down else ("large", ">=", "up")
                raise ModelError(
                    f"{place} must push {leaf!r} {pushed[2]}, as a term with a constant coefficient, got {expr!r}.\n"
                    f"  fix: make it as {pushed[0]} as possible, or bound it by a constraint {leaf!r} "
                    f"{pushed[1]} a limit"
                )


def _pushed_down(objective: Objective, constraints: Iterable[Constraint]) -> set[str]:
    """The keys of the integrals that only inequalities limit from above."""
    seen = {leaf.key() for leaf in _functionals(e for e in (objective.final, objective.running) if e is not None)}
    low, other = set[str](), seen
    for constraint in constraints:
        for factor, part in linear_terms(constraint.residual().canonicalize()):
            pushed = isinstance(part, Integral) and factor > 0.0 and not isinstance(constraint, Equality)
            (low if pushed else other).update(leaf.key() for leaf in functionals_of(part))
    return low - other


def _with_running(objective: Objective) -> Objective:
    """The objective with the integrals among its terms as running cost, for which no states are needed."""
    if objective.final is None or not any(isinstance(leaf, Integral) for leaf in _functionals([objective.final])):
        return objective
    terms = linear_terms(objective.final.canonicalize())
    integrals = [(factor, part.operand) for factor, part in terms if isinstance(part, Integral)]
    rest = [(factor, part) for factor, part in terms if not isinstance(part, Integral)]
    if not integrals:
        return objective
    running = sum_of(integrals) if objective.running is None else objective.running + sum_of(integrals)
    return type(objective)(sum_of(rest).canonicalize() if rest else None, running=running.canonicalize())
