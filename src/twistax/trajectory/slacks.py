"""Soft constraints as hard ones with slacks, which the objective pays for.

Along the path the slack of a constraint is a held control: over an interval it is the largest violation there. At a
node it is a free parameter. An inequality r <= 0 becomes r <= s, an equality -s <= r <= s, with s >= 0 where `l1` makes
a kink at zero; with `l2` alone the price is smooth without that limit, and an equality along the path has its price
without a slack.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..expr import Constraint, Control, Equality, Expr, Inequality, Parameter, Soft
from ..expr.operations.soft import Asked
from ..system import entry_names, free_name
from .conditions import Conditions, residual_of
from .cones import NormControls
from .restated import Restated
from .statement import Objective, check_leaves

#: A slack starts above the violation of the guess by this share of what the residual is along it.
_ABOVE = 0.1


@dataclasses.dataclass(frozen=True)
class NodeSlack:
    """The slack of a soft constraint at a node.

    Attributes:
        soft: the constraint.
        rows: names of the entries of its residual less the slack, among those of the node.
        parameter: the slack.
    """

    soft: Soft
    rows: tuple[str, ...]
    parameter: Parameter


class NodeSlacks:
    """Conditions at nodes without soft ones.

    Args:
        objective: as stated.
        asked: place -> constraints by name.
        front: what names of slacks begin with.

    Attributes:
        objective: with the prices.
        plain: place -> hard constraints by name.
        slacks: by name.
    """

    def __init__(self, objective: Objective, asked: Mapping[str, Mapping[str, Asked]], front: str) -> None:
        self.slacks: dict[str, NodeSlack] = {}
        self.plain: dict[str, dict[str, Constraint]] = {place: {} for place in asked}
        price = objective.final
        for place, constraints in asked.items():
            for name, own in constraints.items():
                if isinstance(own, Soft):
                    added = self._soften(place, name, own, front)
                    price = added * objective.sign if price is None else price + objective.sign * added
                else:
                    self.plain[place][name] = own
        self.objective = type(objective)(price, running=objective.running) if self.slacks else objective

    def _soften(self, place: str, name: str, own: Soft, front: str) -> Expr:
        """Make it hard; its price."""
        residual = residual_of(own.constraint)
        slack = Parameter(free_name(f"{front}slack of {place}: {name}", self.slacks), residual.check_shape())
        rows = self.plain[place]
        if is_free(own) and isinstance(own.constraint, Equality):
            rows[name] = Equality(residual, slack)
        else:
            rows[name] = Inequality(residual, slack)
            if isinstance(own.constraint, Equality):
                rows[f"{name}, from below"] = Inequality(-residual, slack)
        self.slacks[slack.name] = NodeSlack(own, tuple(entry_names(f"{place}: {name}", slack.shape)), slack)
        return own.price(slack)

    @property
    def free(self) -> dict[str, tuple[float | None, None]]:
        """Limits of the slacks, as those of free parameters."""
        return {name: (None if is_free(own.soft) else 0.0, None) for name, own in self.slacks.items()}

    @property
    def without(self) -> dict[str, Array]:
        """Slacks with which residuals are those of the soft constraints."""
        return {name: np.zeros(own.parameter.shape) for name, own in self.slacks.items()}

    @property
    def rows(self) -> set[str]:
        """Names of the entries of soft constraints."""
        return {row for own in self.slacks.values() for row in own.rows}

    def values(
        self, conditions: Mapping[int, Conditions], xs: Mapping[str, Array], ts: Array, params: Mapping[str, Array]
    ) -> dict[str, float]:
        """The residuals of soft constraints by the names of their entries, at nodes along a trajectory."""
        found, wanted = dict[str, float](), self.rows
        known = {name: jnp.asarray(value) for name, value in {**params, **self.without}.items()}
        for k, own in conditions.items():
            if wanted & set(own.names):
                here = {name: jnp.asarray(values[k]) for name, values in xs.items()}
                values = np.asarray(own.values(jnp.asarray(ts[k]), here, known))
                found |= {name: float(value) for name, value in zip(own.names, values) if name in wanted}
        return found

    def violations(
        self, conditions: Mapping[int, Conditions], xs: Mapping[str, Array], ts: Array, params: Mapping[str, Array]
    ) -> dict[str, float]:
        """How far soft constraints are from holding, by the names of their entries."""
        values = self.values(conditions, xs, ts, params) if self.slacks else {}
        equal = {row: isinstance(own.soft.constraint, Equality) for own in self.slacks.values() for row in own.rows}
        return {name: abs(value) if equal[name] else max(value, 0.0) for name, value in values.items()}

    def start(self, residuals: Mapping[str, float]) -> dict[str, Array]:
        """Where slacks start, by name, given residuals at a guess by the names of entries."""
        found = {}
        for name, own in self.slacks.items():
            values = np.array([residuals.get(row, 0.0) for row in own.rows])
            is_equality = isinstance(own.soft.constraint, Equality)
            slack = values if is_equality and is_free(own.soft) else _start(values, is_equality)
            found[name] = slack.reshape(own.parameter.shape)
        return found


def is_free(own: Soft) -> bool:
    """Whether its slack needs no limit."""
    return own.l1 is None


@dataclasses.dataclass(frozen=True)
class SlackControls(NormControls):
    """Bounds on norms, and slacks of soft constraints along the path.

    Attributes:
        soft: the constraints by name.
        slacks: their slacks by name.
    """

    soft: Mapping[str, Soft] = dataclasses.field(default_factory=dict)
    slacks: Mapping[str, Control] = dataclasses.field(default_factory=dict)

    def asked(self, name: str, residual: Expr, is_equality: bool) -> list[tuple[Expr, bool]]:
        """The residuals that stand for that of a constraint along the path, and which are equalities."""
        if name not in self.soft:
            return [(residual, is_equality)]
        if name not in self.slacks:
            return []
        slack, sides = self.slacks[name], (1.0, -1.0) if is_equality else (1.0,)
        return [((side * residual - slack).canonicalize(), False) for side in sides]

    def start(self, shown: Array, names: list[str], intervals: int) -> list[Array]:
        """Values of the slacks over intervals, given residuals (points, rows) at a guess and the rows' names.

        One is the same all along, for the guess is none of the violations of an optimum.
        """
        found = []
        for name, slack in self.slacks.items():
            places = [names.index(row) for row in entry_names(name, slack.shape)]
            values = shown[:, places]
            most = values[np.argmax(_size(values, self._is_equality(name)), axis=0), np.arange(len(places))]
            found.append(np.tile(_start(most, self._is_equality(name)), (intervals, 1)))
        return found

    def _is_equality(self, name: str) -> bool:
        return isinstance(self.soft[name].constraint, Equality)


def slack_controls(norms: NormControls, restated: Restated, soft: Mapping[str, Soft]) -> SlackControls:
    """Bounds on norms, and slacks of soft constraints, with the running cost that pays for them."""
    running, slacks = norms.running, dict[str, Control]()
    dynamics, sign = restated.dynamics, restated.objective.sign
    for name, own in soft.items():
        is_equality = isinstance(own.constraint, Equality)
        residual = dynamics._functions.constraints["equality" if is_equality else "inequality"][name]
        if is_equality and is_free(own):
            size = residual
        else:
            size = slacks[name] = Control(
                f"slack of {name}", residual.check_shape(), min=None if is_free(own) else np.zeros(residual.shape)
            )
        for weight in (own.l1, own.l2):
            if weight is not None:
                check_leaves(dynamics, f"the weight of {name}", restated.put(weight), controls=True)
        price = sign * restated.put(own.price(size))
        running = price if running is None else running + price
    running = running if running is None else running.canonicalize()
    return SlackControls(running, (*norms.controls, *slacks.values()), norms.sizes, dict(soft), slacks)


def _size(values: Array, is_equality: bool) -> Array:
    return np.abs(values) if is_equality else values


def _start(values: Array, is_equality: bool) -> Array:
    """A little above the violations that residuals are."""
    values = np.where(np.isfinite(values), values, 0.0)
    most = np.abs(values).max(initial=0.0) or 1.0
    return np.maximum(_size(values, is_equality), 0.0) + _ABOVE * most
