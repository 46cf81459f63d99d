"""A system in exponential coordinates about a node, x = base Exp(eta): all that a transcription differentiates.

Written to be compiled as scalars, so that derivatives, of second order too, are small programs.
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
    """What a system and what is asked of it are made of: canonical expressions."""

    rates: tuple[Expr, ...]  # of the states in their order
    rows: tuple[Expr, ...]  # of the path, without boxes
    limits: tuple[Expr, ...]  # of all boxes as one vector, or none
    running: tuple[Expr, ...]  # one, or none
    conditions: tuple[Expr, ...]  # of the last node
    final: tuple[Expr, ...]  # one, or none
    shown: tuple[Expr, ...]  # rows of the path as they were written


class Local:
    """Rates, constraints and costs of a system as functions of (t, eta, u, base, params); u is flat.

    `rate` obeys eta' = J_r(eta)^-1 f, with f the body velocities of all states and J_r the right Jacobian. It is the
    RKMK equation in canonical coordinates of the first kind.
    Source: Iserles, Munthe-Kaas, Norsett, Zanna, Lie-group methods (2000), equation (2.46), for the other side.
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
        rates = dynamics._functions.families["rates"]
        self.expressions = Expressions(
            tuple(rates[state.name][0] for state in dynamics.states),
            path.residuals,
            (Constant([bound.limit for bound in path.bounds]),) if path.bounds else (),
            one(norms.running),
            final.residuals,
            one(objective.final),
            tuple(dynamics._functions.families["constraints"]["inequality"])
            + tuple(dynamics._functions.families["constraints"]["equality"]),
        )
        #: 1 where less is better, -1 where more is.
        self.sign = objective.sign
        self.group, self.controls = dynamics.group, Controls((*dynamics.controls, *norms.controls))

    def made_of(self, expressions: Expressions) -> Local:
        """The same of other expressions, of the same shapes."""
        other = copy.copy(self)
        other.expressions = expressions
        return other

    def rate(self, t: jax.Array, eta: jax.Array, u: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        x = self.group.retract(base, eta)
        exprs = {s.name: [e] for s, e in zip(self._dynamics.states, self.expressions.rates, strict=True)}
        rates = self._dynamics._functions.values(exprs, False, t, x, self.controls.split(u), params)
        parts = []
        for name, factor in self.group.factors.items():
            rate = rates[name].reshape(-1)
            if not factor.flat:
                rate = factor.right_jacobian_inv(eta[self.group.slices[name]]) @ rate
            parts.append(rate)
        return jnp.concatenate(parts)

    def point(
        self, t: jax.Array, eta: jax.Array, u: jax.Array, base: Arrays, params: Arrays
    ) -> tuple[jax.Array, jax.Array]:
        """The path rows at a point, and the running cost."""
        x, controls = self.group.retract(base, eta), self.controls.split(u)
        return self.rows(t, x, controls, params), self._value(self.expressions.running, t, x, controls, params)

    def values(
        self, exprs: Sequence[Expr], t: jax.Array, eta: jax.Array, u: jax.Array, base: Arrays, params: Arrays
    ) -> list[Any]:
        """Expressions at a point."""
        inputs = Inputs(t, self.group.retract(base, eta), self.controls.split(u), params, t.dtype)
        return list(evaluate_all(exprs, lambda leaf: leaf.read(inputs)))

    def rows(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """The path rows at a point, as the solver sees them."""
        inputs, count = Inputs(t, x, u, params, t.dtype), len(self.expressions.rows)
        values = evaluate_all([*self.expressions.rows, *self.expressions.limits], lambda leaf: leaf.read(inputs))
        flat = {name: value.reshape(-1) for name, value in (*x.items(), *u.items())}
        places = enumerate(self._path.bounds)
        boxes = [bound.sign * (flat[bound.leaf][bound.entry] - values[-1][k]) for k, bound in places]
        every = [*values[:count], *boxes]
        return jnp.concatenate([jnp.zeros(0, t.dtype), *(a.reshape(-1).astype(t.dtype) for a in every)])

    def along(
        self, rows: Sequence[Expr], ts: Array, x: Mapping[str, Any], u: Mapping[str, Any], params: Mapping[str, Any]
    ) -> Array:
        """(points, entries) rows of the path and those of its boxes at many points, as arrays of NumPy."""
        flat = {name: np.reshape(values, (len(ts), -1)) for name, values in (*x.items(), *u.items())}
        boxes = [b.sign * (flat[b.leaf][:, b.entry] - b.limit) for b in self._path.bounds]
        return np.concatenate([PointValues.of(rows)(ts, x, u, params), *(box[:, None] for box in boxes)], axis=1)

    def gap(self, eta: jax.Array, base: Arrays, target: Arrays) -> jax.Array:
        """Log(target^-1 base Exp(eta))."""
        return self.group.difference(target, self.group.retract(base, eta))

    def end(
        self, t: jax.Array, eta: jax.Array, base: Arrays, target: Arrays, params: Arrays
    ) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Of a final node: conditions, the difference from target, path rows (with zero controls), final cost."""
        x = self.group.retract(base, eta)
        none = self.controls.split(jnp.zeros(self.controls.dimension, eta.dtype))
        return (
            dataclasses.replace(self._final, residuals=self.expressions.conditions).values(t, x, params),
            self.group.difference(target, x),
            self.rows(t, x, none, params),
            self._value(self.expressions.final, t, x, {}, params),
        )

    def _value(self, exprs: Sequence[Expr], t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """The value of a part of the objective, signed so that less is better; zero where there is none."""
        inputs = Inputs(t, x, u, params, t.dtype)
        values: Sequence[Any] = evaluate_all(exprs, lambda leaf: leaf.read(inputs))
        return self.sign * values[0].astype(t.dtype) if values else jnp.zeros((), t.dtype)
