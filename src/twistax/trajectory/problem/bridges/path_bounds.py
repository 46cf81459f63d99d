"""The bridge for soft constraints and for norms in the running cost: slacks and bounds as additional variables.

Along the path, the slack of a constraint is a piecewise constant control: the largest violation in an interval. At a
node, it is a free parameter. An inequality r <= 0 becomes r <= s, an equality becomes -s <= r <= s. With an `l1`
weight, s >= 0. With an `l2` weight alone the penalty is smooth without that limit, and an equality along the path is
penalised without a slack.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ....checks import listed
from ....errors import InputError
from ....expr import Constant, Constraint, Control, Equality, Expr, Inequality, Parameter, Soft, leaves_of
from ....system import entry_names, free_name
from ...transcription.point_values import PointValues
from ..conditions import Conditions, residual_of
from ..statement import check_leaves
from ..terms import above, bound_rows, sizes_in, values_of
from .bridge import Bridge, Path, Statement, place_of

#: The initial slack exceeds the violation of the guess by this fraction of the residual along the guess.
_ABOVE = 0.1


@dataclasses.dataclass(frozen=True)
class NodeSlack:
    """The slack of a soft constraint at a node.

    Attributes:
        soft: the constraint.
        rows: names of the entries of its residual minus the slack, among the rows of the node.
        parameter: the free parameter that represents the slack.
    """

    soft: Soft
    rows: tuple[str, ...]
    parameter: Parameter


class NodeSlacks(Bridge):
    """A problem whose soft conditions at nodes have become hard conditions with penalised slacks.

    Args:
        statement: the problem with soft conditions.
        front: the prefix of the names of slacks.

    Attributes:
        slacks: by name.
    """

    def __init__(self, statement: Statement, front: str) -> None:
        self.slacks: dict[str, NodeSlack] = {}
        rows: dict[int, dict[str, Constraint]] = {node: {} for node in statement.rows}
        objective = statement.objective
        price = objective.final
        for node, constraints in statement.rows.items():
            place = place_of(node, statement.last)
            for name, constraint in constraints.items():
                if isinstance(constraint, Soft):
                    added = objective.sign * self._soften(place, name, constraint, front, rows[node])
                    price = added if price is None else price + added
                else:
                    rows[node][name] = constraint
        if self.slacks:
            objective = type(objective)(price, running=objective.running)
        self.statement = dataclasses.replace(statement, objective=objective, rows=rows)
        self.free = {name: (None if is_free(slack.soft) else 0.0, None) for name, slack in self.slacks.items()}

    def _soften(self, place: str, name: str, soft: Soft, front: str, rows: dict[str, Constraint]) -> Expr:
        """Add the hard constraint with a slack to the rows, and return the penalty on the slack."""
        residual = residual_of(soft.constraint)
        slack = Parameter(free_name(f"{front}slack of {place}: {name}", self.slacks), residual.check_shape())
        if is_free(soft) and isinstance(soft.constraint, Equality):
            rows[name] = Equality(residual, slack)
        else:
            rows[name] = Inequality(residual, slack)
            if isinstance(soft.constraint, Equality):
                rows[f"{name}, from below"] = Inequality(-residual, slack)
        self.slacks[slack.name] = NodeSlack(soft, tuple(entry_names(f"{place}: {name}", slack.shape)), slack)
        return soft.price(slack)

    @property
    def without(self) -> dict[str, Array]:
        """Zero for every slack, with which residuals are those of the soft constraints."""
        return {name: np.zeros(slack.parameter.shape) for name, slack in self.slacks.items()}

    @property
    def rows(self) -> set[str]:
        """Names of the entries of the soft conditions."""
        return {row for slack in self.slacks.values() for row in slack.rows}

    def values(
        self, conditions: Mapping[int, Conditions], xs: Mapping[str, Array], ts: Array, params: Mapping[str, Array]
    ) -> dict[str, float]:
        """The residuals of soft conditions along a trajectory, by the names of their entries."""
        residuals, wanted = dict[str, float](), self.rows
        if not wanted:
            return residuals
        known = {name: jnp.asarray(value) for name, value in {**params, **self.without}.items()}
        for k, rows in conditions.items():
            if wanted & set(rows.names):
                here = {name: jnp.asarray(values[k]) for name, values in xs.items()}
                values = np.asarray(rows.values(jnp.asarray(ts[k]), here, known))
                residuals |= {name: float(value) for name, value in zip(rows.names, values) if name in wanted}
        return residuals

    def violations(
        self, conditions: Mapping[int, Conditions], xs: Mapping[str, Array], ts: Array, params: Mapping[str, Array]
    ) -> dict[str, float]:
        """The violations of soft conditions along a trajectory, by the names of their entries."""
        values = self.values(conditions, xs, ts, params)
        equal = {row: isinstance(s.soft.constraint, Equality) for s in self.slacks.values() for row in s.rows}
        return {name: abs(value) if equal[name] else max(value, 0.0) for name, value in values.items()}

    def parameters(self, guess: Path, phase: Any) -> dict[str, Array]:
        residuals, starts = self.values(phase.conditions, guess.xs, guess.ts, guess.params), {}
        for name, slack in self.slacks.items():
            values = np.array([residuals.get(row, 0.0) for row in slack.rows])
            is_equality = isinstance(slack.soft.constraint, Equality)
            start = values if is_equality and is_free(slack.soft) else _start(values, is_equality)
            starts[name] = start.reshape(slack.parameter.shape)
        return starts


def is_free(soft: Soft) -> bool:
    """Whether a slack of the constraint may be negative, which holds without an `l1` weight: the penalty is then
    smooth.
    """
    return soft.l1 is None


class PathBounds(Bridge):
    """Additional controls: bounds of norms in the running cost, and slacks of soft constraints along the path.

    Args:
        statement: the problem after all other bridges.
        soft: the soft constraints along the path, by name.
        put: returns the expression that replaces an expression of these constraints, as all other bridges do.

    Attributes:
        running: the running cost with bounds in place of norms and with penalties on slacks.
        controls: the additional controls; the first ones bound `sizes`.
        rows: for each additional row its name and its residual, <= 0.
        slacks: name of a soft constraint -> its slack.
    """

    def __init__(self, statement: Statement, soft: Mapping[str, Soft], put: Callable[[Expr], Expr]) -> None:
        self.statement, self.soft = statement, soft
        dynamics, sign = statement.dynamics, statement.objective.sign
        running, bounds, self._sizes = sizes_in(statement.objective.running, sign)
        self.rows = [(s.name, row) for s, size in zip(bounds, self._sizes) for row in bound_rows(s, size)]
        self.slacks: dict[str, Control] = {}
        for name, constraint in soft.items():
            is_equality = isinstance(constraint.constraint, Equality)
            residual = dynamics.functions.constraints["equality" if is_equality else "inequality"][name]
            size = residual
            if not (is_equality and is_free(constraint)):
                least = None if is_free(constraint) else np.zeros(residual.shape)
                size = self.slacks[name] = Control(f"slack of {name}", residual.check_shape(), min=least)
            for weight in (constraint.l1, constraint.l2):
                if weight is not None:
                    check_leaves(dynamics, f"the weight of {name}", put(weight), controls=True)
            price = sign * put(constraint.price(size))
            running = price if running is None else running + price
        self.running = running.canonicalize() if soft and running is not None else running
        self.controls = (*bounds, *self.slacks.values())

    def asked(self, name: str, residual: Expr, is_equality: bool) -> list[tuple[Expr, bool]]:
        """The residuals that replace the residual of a path constraint, and whether each is an equality."""
        if name not in self.soft:
            return [(residual, is_equality)]
        if name not in self.slacks:
            return []
        slack, sides = self.slacks[name], (1.0, -1.0) if is_equality else (1.0,)
        return [((side * residual - slack).canonicalize(), False) for side in sides]

    def columns(self, guess: Path, phase: Any) -> list[Array]:
        """Values of the additional controls, (intervals, entries) each.

        Bounds are slightly above the values that they bound. A slack has one value along the whole path, because
        violations of the guess say nothing about violations at the optimum.
        """
        intervals, columns = len(guess.ts) - 1, []
        if self._sizes:
            columns = [above(values)[:, None] for values in values_of(self._sizes, guess.sized().us, guess.params)]
        shown = phase.shown_along(guess) if self.slacks else np.zeros((0, 0))
        for name, slack in self.slacks.items():
            places = [phase.path.shown.index(row) for row in entry_names(name, slack.shape)]
            values, is_equality = shown[:, places], isinstance(self.soft[name].constraint, Equality)
            most = values[np.argmax(_size(values, is_equality), axis=0), np.arange(len(places))]
            columns.append(np.tile(_start(most, is_equality), (intervals, 1)))
        return columns

    def forward(self, path: Path) -> None:
        path.us |= {c.name: np.zeros((len(path.ts) - 1, *c.shape)) for c in self.controls}

    def back(self, xs: dict[str, Any], us: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        added = {c.name for c in self.controls}
        return xs, {name: values for name, values in us.items() if name not in added}


def check_weights(soft: Mapping[str, Soft], params: Mapping[str, Array]) -> None:
    """Raise InputError if parameter values make a weight negative: a larger violation would then cost less.

    Args:
        soft: constraints by name.
        params: parameter values; a parameter with a value for each node has a leading axis of nodes.
    """
    for name, constraint in soft.items():
        weights = {"l1": constraint.l1, "l2": constraint.l2}
        for kind, weight in ((kind, weight) for kind, weight in weights.items() if weight is not None):
            leaves = [leaf for leaf in leaves_of(weight) if not isinstance(leaf, Constant)]
            if not leaves or not all(isinstance(leaf, Parameter) and leaf.name in params for leaf in leaves):
                continue
            by_node = {e.name for e in leaves if np.ndim(params[e.name]) > len(e.shape)}
            values = PointValues.of([weight.canonicalize()])
            for k in range(len(params[min(by_node)]) if by_node else 1):
                here = {e.name: params[e.name][k] if e.name in by_node else params[e.name] for e in leaves}
                least = values(np.zeros(1), {}, {}, here).min()
                if not least >= 0.0:
                    raise InputError(
                        f"params: the weight {kind} of the soft constraint {name!r} must be 0 or more, "
                        f"got {least:g} by {listed(sorted(here))}"
                    )


def _size(values: Array, is_equality: bool) -> Array:
    return np.abs(values) if is_equality else values


def _start(values: Array, is_equality: bool) -> Array:
    """Initial slacks, slightly above the violations of these residuals."""
    values = np.where(np.isfinite(values), values, 0.0)
    most = np.abs(values).max(initial=0.0) or 1.0
    return np.maximum(_size(values, is_equality), 0.0) + _ABOVE * most
