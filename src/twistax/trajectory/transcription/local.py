"""A system in exponential coordinates about a node, x = base Exp(eta): the functions that a transcription
differentiates.

The functions are written to be compiled in scalar form, so that first and second derivatives are small programs.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ...expr import Constant, Expr, Inputs, evaluate_all
from ...linear.discretize import Controls
from ...system.dynamics import Arrays, Dynamics
from ..problem.bridges.path_bounds import PathBounds
from ..problem.conditions import Conditions
from ..problem.statement import Objective, PathRows
from .point_values import PointValues


class Expressions(NamedTuple):
    """The canonical expressions of a system, its constraints and its objective."""

    rates: tuple[Expr, ...]  # one for each state, in order
    rows: tuple[Expr, ...]  # the path constraints without limits of leaves
    limits: tuple[Expr, ...]  # the limits of all leaves as one vector, or none
    running: tuple[Expr, ...]  # one expression or none
    conditions: tuple[Expr, ...]  # the conditions at the last node
    final: tuple[Expr, ...]  # one expression or none
    shown: tuple[Expr, ...]  # the path constraints as users wrote them


class Local:
    """Rates, constraints and costs of a system at points (t, x, u, params) with x = base Exp(eta); u is flat.

    Attributes:
        group, controls: the group of the states, and the controls.
        expressions: the expressions to evaluate.
        sign: 1 to minimise, -1 to maximise.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        path: PathRows,
        objective: Objective,
        norms: PathBounds,
        final: Conditions,
    ) -> None:
        self._dynamics, self._path, self._final = dynamics, path, final
        one = lambda expr: () if expr is None else (expr,)  # noqa: E731
        families = dynamics.functions.families
        self.expressions = Expressions(
            tuple(families["rates"][state.name][0] for state in dynamics.states),
            path.residuals,
            (Constant([bound.limit for bound in path.bounds]),) if path.bounds else (),
            one(norms.running),
            final.residuals,
            one(objective.final),
            (*families["constraints"]["inequality"], *families["constraints"]["equality"]),
        )
        self.sign = objective.sign
        self.group, self.controls = dynamics.group, Controls((*dynamics.controls, *norms.controls))

    def made_of(self, **expressions: tuple[Expr, ...]) -> Local:
        """A copy with other expressions of the same shapes, by their names in `Expressions`."""
        other = copy.copy(self)
        other.expressions = self.expressions._replace(**expressions)
        return other

    def inputs(self, t: jax.Array, eta: jax.Array, u: jax.Array, base: Arrays, params: Arrays) -> Inputs:
        """A point."""
        return Inputs(t, self.group.retract(base, eta), self.controls.split(u), params, t.dtype)

    def rate(self, at: Inputs, eta: jax.Array) -> jax.Array:
        """eta' = J_r(eta)^-1 f, with f the body velocities of all states and J_r the right Jacobian.

        It is the RKMK equation in canonical coordinates of the first kind.
        Source: Iserles, Munthe-Kaas, Norsett, Zanna, Lie-group methods (2000), equation (2.46), there for
        right-trivialised equations.
        """
        exprs = {s.name: [e] for s, e in zip(self._dynamics.states, self.expressions.rates, strict=True)}
        rates = self._dynamics.functions.values(exprs, False, at.t, dict(at.x), dict(at.u), dict(at.params))
        parts = []
        for name, factor in self.group.factors.items():
            rate = rates[name].reshape(-1)
            if not factor.flat:
                rate = factor.right_jacobian_inv(eta[self.group.slices[name]]) @ rate
            parts.append(rate)
        return jnp.concatenate(parts)

    def rows(self, at: Inputs) -> jax.Array:
        """The path rows in the solver's form."""
        count = len(self.expressions.rows)
        values = _values([*self.expressions.rows, *self.expressions.limits], at)
        flat = {name: value.reshape(-1) for name, value in (*at.x.items(), *at.u.items())}
        places = enumerate(self._path.bounds)
        boxes = [bound.sign * (flat[bound.leaf][bound.entry] - values[-1][k]) for k, bound in places]
        every = [*values[:count], *boxes]
        return jnp.concatenate([jnp.zeros(0, at.dtype), *(a.reshape(-1).astype(at.dtype) for a in every)])

    def cost(self, exprs: Sequence[Expr], at: Inputs) -> jax.Array:
        """A contribution to the objective, with the sign for minimisation; zero if there is none."""
        values = _values(exprs, at)
        return self.sign * values[0].astype(at.dtype) if values else jnp.zeros((), at.dtype)

    def conditions(self, at: Inputs) -> jax.Array:
        """The conditions at the last node."""
        conditions = dataclasses.replace(self._final, residuals=self.expressions.conditions)
        return conditions.values(at.t, at.x, at.params)

    def gap(self, eta: jax.Array, base: Arrays, target: Arrays) -> jax.Array:
        """Log(target^-1 base Exp(eta))."""
        return self.group.difference(target, self.group.retract(base, eta))

    def along(
        self, rows: Sequence[Expr], ts: Array, x: Mapping[str, Any], u: Mapping[str, Any], params: Mapping[str, Any]
    ) -> Array:
        """(points, entries) the path rows and the rows of leaf limits at many points, as NumPy arrays."""
        flat = {name: np.reshape(values, (len(ts), -1)) for name, values in (*x.items(), *u.items())}
        boxes = [b.sign * (flat[b.leaf][:, b.entry] - b.limit) for b in self._path.bounds]
        return np.concatenate([PointValues.of(rows)(ts, x, u, params), *(box[:, None] for box in boxes)], axis=1)


def _values(exprs: Sequence[Expr], at: Inputs) -> list[Any]:
    return list(evaluate_all(exprs, lambda leaf: leaf.read(at)))
