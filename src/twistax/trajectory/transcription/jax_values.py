"""Cost, defects and constraint rows of a phase as JAX functions, for derivatives of `solution` of any order.

The solver's core has the same functions in C, `integrate.c`. An interval is integrated in exponential coordinates eta
about its first node, x = base Exp(eta), as a function of the fraction of the phase's duration.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...scalar.backends import XLA, chosen
from ...scalar.fast import part_of_package
from ...scalar.targets.llvm.backend import Auto, Native, installed
from ...solver.transcription import Scheme
from ...system.dynamics import Arrays
from .iterate import Instance, Iterate, Values
from .shooting import Shooting

#: The largest number of Newton steps of collocation, and the relative step size after which one more step is the last.
_NEWTON_STEPS, _NEWTON_CLOSE = 20, 1e-9


class _Fixed(NamedTuple):
    """The quantities that are constant along an interval."""

    start: Any  # a fraction of the duration of the phase, like the width
    width: Any
    base: Any
    u: Any
    border: Any
    params: Any


class JaxValues:
    """Values of a phase at a point, and at a step from it."""

    def __init__(self, shooting: Shooting) -> None:
        self._shooting = shooting
        backend = chosen(
            "auto" if isinstance(shooting.dynamics.backend, Auto) else shooting.dynamics.backend,
            Native() if installed() else XLA(),
        )
        compiled = functools.partial(part_of_package, backend=backend)
        self._rate, self._point = compiled(shooting.rate_at), compiled(shooting.point_at)
        self._gap, self._end = compiled(shooting.local.gap), compiled(shooting.end_at)
        self._nodes = {k: compiled(functools.partial(shooting.node_at, k)) for k in shooting.conditions}

    def __call__(self, point: Iterate, instance: Instance, d: jax.Array | None = None) -> Values:
        """Cost, defects and rows at a point, or after a step d (nodes, n) of its nodes in their charts."""
        phase, params = self._shooting, instance.params
        d = jnp.zeros((phase.nodes, phase.n), point.us.dtype) if d is None else d
        left, right = ({name: a[part] for name, a in point.xs.items()} for part in (slice(-1), slice(1, None)))
        shares, widths = (jnp.asarray(a, d.dtype) for a in (phase.mesh.shares[:-1], phase.mesh.widths))
        fixed = _Fixed(shares, widths, left, point.us, point.border, params)
        axes = _Fixed(0, 0, 0, 0, None, None)
        ends, rows, costs = jax.vmap(self._interval, in_axes=(axes, 0))(fixed, d[:-1])
        defects = jax.vmap(self._gap)(ends, left, right) - d[1:]

        def at(node: int) -> tuple[jax.Array, tuple[Arrays, jax.Array]]:
            step = jnp.concatenate([d[node], jnp.zeros(phase.border.size, d.dtype)])
            return step, ({name: a[node] for name, a in point.xs.items()}, point.border)

        of_nodes = jnp.zeros((phase.intervals, phase.layout.at_nodes), d.dtype)
        for k, conditions in self._nodes.items():
            values = conditions(*at(k), params)
            of_nodes = of_nodes.at[k, : len(values)].set(values)
        end = self._end(*at(-1), instance)
        rows = jnp.concatenate([jnp.concatenate([rows, of_nodes], axis=1).reshape(-1), end[:-1]])
        return Values(jnp.sum(costs) + end[-1], defects, rows + instance.margins)

    def _interval(self, fixed: _Fixed, eta: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The end of an interval that starts at eta, its path rows, and its contribution to the running cost."""
        method, layout = self._shooting.transcription.scheme, self._shooting.layout
        as_array = functools.partial(jnp.asarray, dtype=eta.dtype)
        length, c = fixed.width / method.substeps, as_array(method.c)
        firsts = fixed.start + length * as_array(np.arange(method.substeps))

        def substep(eta: jax.Array, first: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
            slope = functools.partial(self._slope, fixed, first + length * c)
            points, slopes = (_implicit if method.implicit else _explicit)(method, length, eta, slope)
            after = eta + length * (as_array(method.b) @ slopes)
            return after, (after, points)

        last, (ends, stages) = jax.lax.scan(substep, eta, firsts)
        etas = jnp.concatenate([eta[None], ends, stages.reshape(-1, len(eta))])
        ends_at = fixed.start + fixed.width * as_array(np.linspace(0.0, 1.0, method.substeps + 1))
        shares = jnp.concatenate([ends_at, (firsts[:, None] + length * c[None, :]).reshape(-1)])
        q = jax.vmap(lambda eta: jnp.concatenate([eta, fixed.u, fixed.border]))(etas)
        values = jax.vmap(self._point, in_axes=(0, 0, None, None))(q, shares, fixed.base, fixed.params)
        rows = values[: method.substeps + 1, :-1].reshape(-1)[layout.path_indices.astype(np.int32)]
        cost = fixed.width * (as_array(method.weights) @ values[:, -1])
        return last, rows, cost

    def _slope(self, fixed: _Fixed, shares: jax.Array, k: int, eta: jax.Array) -> jax.Array:
        """The derivative of eta with respect to the fraction of the duration, at stage k."""
        q = jnp.concatenate([eta, fixed.u, fixed.border])
        slope: jax.Array = self._rate(q, shares[k], fixed.base, fixed.params)
        return slope


_Slope = Callable[[int, jax.Array], jax.Array]


def _explicit(method: Scheme, length: Any, eta: jax.Array, slope: _Slope) -> tuple[jax.Array, jax.Array]:
    """The stages of an explicit substep, computed successively, and their derivatives."""
    points, slopes = list[jax.Array](), list[jax.Array]()
    for k, weights in enumerate(method.a):
        points.append(eta + length * sum(float(w) * s for w, s in zip(weights, slopes) if w))
        slopes.append(slope(k, points[-1]))
    return jnp.stack(points), jnp.stack(slopes)


def _implicit(method: Scheme, length: Any, eta: jax.Array, slope: _Slope) -> tuple[jax.Array, jax.Array]:
    """The stages of an implicit substep, solved together by Newton's method."""
    a, (count, n) = length * jnp.asarray(method.a, eta.dtype), (len(method.b), len(eta))

    def residual(slopes: jax.Array) -> jax.Array:
        points = eta[None] + a @ slopes
        return slopes - jnp.stack([slope(k, points[k]) for k in range(count)])

    def improved(slopes: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The stages after one Newton step, and the relative size of that step."""
        matrix = jax.jacfwd(residual)(slopes).reshape(count * n, count * n)
        step = jnp.linalg.solve(matrix, residual(slopes).reshape(-1)).reshape(count, n)
        return slopes - step, jnp.abs(length * step).max() / (1.0 + jnp.abs(length * slopes).max())

    def unfinished(carry: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return (carry[1] > _NEWTON_CLOSE) & (carry[2] < _NEWTON_STEPS)

    def step(carry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        return *improved(carry[0]), carry[2] + 1

    first = jnp.broadcast_to(slope(0, eta), (count, n))
    slopes, _, steps = jax.lax.while_loop(
        unfinished, step, (first, jnp.asarray(jnp.inf, eta.dtype), jnp.zeros((), int))
    )
    # For first derivatives of the solution one Newton step suffices; two steps also give third derivatives.
    slopes = jax.lax.stop_gradient(slopes)
    for _ in range(2):
        slopes, _ = improved(slopes)
    slopes = jnp.where(steps < _NEWTON_STEPS, slopes, jnp.nan)
    return eta[None] + a @ slopes, slopes
