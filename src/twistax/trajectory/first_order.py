"""The first-order conditions of a phase as functions that JAX differentiates, in scales.

With multipliers y of the dynamics and w of the rows, and slacks s of the inequalities,

    grad L = 0,   F_k - d_(k+1) = 0,   c = 0,   g + s = 0,   s w = mu,

L is the Lagrangian. Newton's method eliminates s; the multiplier of an inequality then grows by w / s times its row.
Source: Wachter and Biegler, On the implementation of an interior-point filter line-search algorithm for large-scale
nonlinear programming, Mathematical Programming 106 (2006), equations (4) and (13).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .iterate import Scales
from .riccati import Rows, of_stages, to_step
from .shooting import Shooting
from .transcribed import Derivatives, Given, Point, Step, Values

#: Rows hold to this times the change of their multipliers at least, in the factors: refinement takes it out.
_SOFTEST = 1e-8
#: The least multiplier of an inequality.
_LEAST = 1e-30


class FirstOrder:
    """The conditions of a problem.

    Attributes:
        exists, inequality: (rows,) which rows are asked at all, and as inequalities.
        free_start: (n + g,) which entries of [d_0, b] may move.
    """

    def __init__(self, shooting: Shooting) -> None:
        self._shooting = shooting
        self.exists = shooting.exists
        self.inequality = shooting.exists & ~shooting.equality
        self.free_start = np.concatenate([shooting.free.d[0], shooting.free.border])

    def values(self, point: Point, given: Given, scales: Scales) -> Values:
        """The scaled values at a point."""
        raw = self._shooting.values(point, given)
        rows = jnp.where(self.exists, raw.rows / scales.rows, 0.0)
        return Values(raw.cost / scales.cost, raw.defects / scales.d[1:], rows)

    def derivatives(
        self, point: Point, dynamics: jax.Array, rows: jax.Array, given: Given, scales: Scales
    ) -> Derivatives:
        """The scaled derivatives at a point, second ones with scaled multipliers."""
        s = scales
        y, w = dynamics * s.cost / s.d[1:], rows * s.cost / s.rows
        raw = self._shooting.derivatives(point, y, jnp.where(self.exists, w, 0.0), given)
        z, end = of_stages(Step(s.d, s.u, s.border))
        sizes, exists = self.split(s.rows), self.split(jnp.asarray(self.exists))
        return Derivatives(
            raw.defects * z[:, None] / s.d[1:, :, None],
            _kept(exists.inner[..., None], raw.rows * z[:, None] / sizes.inner[..., None]),
            _kept(exists.end[:, None], raw.end_rows * end[None] / sizes.end[:, None]),
            raw.gradient * z / s.cost,
            raw.end_gradient * end / s.cost,
            raw.hessian * (z[:, :, None] * z[:, None]) / s.cost,
            raw.end_hessian * (end[:, None] * end[None]) / s.cost,
        )

    def multipliers(self, dynamics: jax.Array, rows: jax.Array, scales: Scales) -> tuple[jax.Array, jax.Array]:
        """Scaled multipliers of the dynamics and of the rows, of those in the problem's units."""
        scaled = jnp.where(self.exists, rows * scales.rows / scales.cost, 0.0)
        return dynamics * scales.d[1:] / scales.cost, scaled

    def lagrangian(self, slopes: Derivatives, y: jax.Array, w: jax.Array) -> Step:
        """The gradient of the Lagrangian by all unknowns that are free."""
        rows = self.split(w)
        inner = slopes.gradient + jnp.einsum("kn,kna->ka", y, slopes.defects)
        inner = inner + jnp.einsum("kr,kra->ka", rows.inner, slopes.rows)
        end = slopes.end_gradient + rows.end @ slopes.end_rows
        whole = to_step(inner, end, self._shooting.n)
        whole = whole._replace(d=whole.d - jnp.concatenate([jnp.zeros_like(y[:1]), y]))
        return jax.tree.map(lambda a, free: jnp.where(free, a, 0.0), whole, self._shooting.free)

    def softness(self, slack: jax.Array, rows: jax.Array) -> jax.Array:
        """By how much a row gives way to its multiplier, s / w, all scaled; an equality does not."""
        return jnp.where(self.inequality, slack / jnp.maximum(rows, _LEAST), 0.0)

    def weights(self, softness: jax.Array) -> Rows:
        """By how much the multiplier of a row grows with it, for factors that rounding leaves something of."""
        return self.split(jnp.where(self.exists, 1.0 / jnp.maximum(softness, _SOFTEST), 0.0))

    def split(self, rows: Any) -> Rows:
        """Numbers of all rows as those of the intervals and of the end."""
        count = self._shooting.intervals * self._shooting.rows_per_interval
        return Rows(rows[:count].reshape(self._shooting.intervals, -1), rows[count:])

    @staticmethod
    def join(rows: Rows) -> jax.Array:
        """The inverse of `split`."""
        return jnp.concatenate([rows.inner.reshape(-1), rows.end])


def in_units(step: Step, scales: Scales) -> Step:
    """A scaled step in the problem's units."""
    return Step(step.d * scales.d, step.u * scales.u, step.border * scales.border)


def _kept(exists: jax.Array, slopes: jax.Array) -> jax.Array:
    """Slopes, zero where rows that are only checked have none."""
    return jnp.where(exists | jnp.isfinite(slopes), slopes, 0.0)
