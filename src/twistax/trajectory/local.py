"""A system in exponential coordinates about a node, x = base Exp(eta): all that a transcription differentiates.

Written to be compiled as scalars, so that derivatives, of second order too, are small programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from ..expr import Expr, Inputs, evaluate_all
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .conditions import Conditions
from .cones import NormControls
from .discretize import Controls
from .statement import Objective, PathRows


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
        norms: NormControls,
        final: Conditions,
    ) -> None:
        self._dynamics, self._path, self._objective, self._final = dynamics, path, objective, final
        self._running = norms.running
        self.group, self.controls = dynamics.group, Controls((*dynamics.controls, *norms.controls))

    def rate(self, t: jax.Array, eta: jax.Array, u: jax.Array, base: Arrays, params: Arrays) -> jax.Array:
        x = self.group.retract(base, eta)
        rates = self._dynamics._functions.as_written("rates", t, x, self.controls.split(u), params)
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
        x, held = self.group.retract(base, eta), self.controls.split(u)
        return self.rows(t, x, held, params), self._value(self._running, t, x, held, params)

    def rows(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """The path rows at a point, as the solver sees them."""
        inputs = Inputs(t, x, u, params, t.dtype)
        return self._with_boxes(evaluate_all(self._path.residuals, lambda leaf: leaf.read(inputs)), x, u)

    def shown_rows(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """The path rows at a point as the user wrote them."""
        family = self._dynamics._functions.as_written("constraints", t, x, u, params)
        return self._with_boxes([family["inequality"], family["equality"]], x, u)

    def _with_boxes(self, rows: Sequence[jax.Array], x: Arrays, u: Arrays) -> jax.Array:
        flat = {name: values.reshape(-1) for name, values in (*x.items(), *u.items())}
        boxes = [bound.sign * (flat[bound.leaf][bound.entry] - bound.limit) for bound in self._path.bounds]
        dtype = next(iter(flat.values())).dtype
        return jnp.concatenate([jnp.zeros(0, dtype), *(jnp.reshape(a, -1).astype(dtype) for a in (*rows, *boxes))])

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
            self._final.values(t, x, params),
            self.group.difference(target, x),
            self.rows(t, x, none, params),
            self._value(self._objective.final, t, x, {}, params),
        )

    def _value(self, expr: Expr | None, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        """The value of a part of the objective, signed so that less is better."""
        inputs = Inputs(t, x, u, params, t.dtype)
        found: Sequence[Any] = evaluate_all([] if expr is None else [expr], lambda leaf: leaf.read(inputs))
        return self._objective.sign * found[0].astype(t.dtype) if found else jnp.zeros((), t.dtype)
