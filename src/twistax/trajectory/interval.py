"""One interval of a transcription: its end, rows, cost and their derivatives, by an explicit Runge-Kutta method.

An interval is integrated in exponential coordinates eta about its first node, x = base Exp(eta), over shares of the
duration of the phase. What is unknown is z = [d, u, b]: the start eta = d, the controls, the border. Second derivatives
of y.F + w.rows + cost follow from the adjoints of the stages: every stage adds G' M G, with M the second derivative of
the rates weighted by its adjoint and G its sensitivity to z.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..integrators import RKMK
from ..lowering.dynamics import Arrays
from .smooth import Smooth


class Slot(NamedTuple):
    """Where an interval lies, in shares of the duration of its phase."""

    start: Any
    width: Any


class Interval:
    """The maths of an interval.

    Args:
        rate: d eta / d share, of (q, share, base, params), q = [eta, u, b].
        point: path rows and the density of the cost, of the same.
        gap: Log(target^-1 base Exp(eta)), of (eta, base, target).
        n, size: how many eta and z have.
        asked: the rows that are asked, of those at all ends of substeps one after the other.
        rows: path rows at a point.
    """

    def __init__(
        self,
        rate: Smooth,
        point: Smooth,
        gap: Smooth,
        method: RKMK,
        substeps: int,
        *,
        n: int,
        size: int,
        asked: Array,
        rows: int,
    ) -> None:
        self._rate, self._point, self._gap = rate, point, gap
        self.substeps, self._n, self._size, self._asked, self._rows = substeps, n, size, asked, rows
        self._a, self._c = method.tableau.counted
        self._b = method.tableau.b[: len(self._c)]
        self._weights = _weights(substeps)

    # ---- values ---------------------------------------------------------------------------------------------------

    def roll(
        self, slot: Slot, base: Arrays, eta: jax.Array, u: jax.Array, border: jax.Array, params: Arrays
    ) -> tuple[jax.Array, jax.Array]:
        """eta at the ends of the substeps (S + 1, n), and of all stages (S, s, n)."""
        length = slot.width / self.substeps
        ends, stages = [eta], []
        for s in range(self.substeps):
            slopes: list[jax.Array] = []
            own = []
            for i in range(len(self._b)):
                at = eta + sum(length * self._a[i, j] * slopes[j] for j in range(i) if self._a[i, j])
                own.append(at)
                share = slot.start + (s + self._c[i]) * length
                slopes.append(self._rate(_joined(at, u, border), jnp.asarray(share), base, params))
            eta = eta + length * (jnp.asarray(self._b, u.dtype) @ jnp.stack(slopes))
            ends.append(eta)
            stages.append(jnp.stack(own))
        return jnp.stack(ends), jnp.stack(stages)

    def at_points(
        self, slot: Slot, base: Arrays, etas: jax.Array, u: jax.Array, border: jax.Array, params: Arrays
    ) -> tuple[jax.Array, jax.Array]:
        """The rows that are asked, and the share of the running cost."""

        def one(share: jax.Array, eta: jax.Array) -> jax.Array:
            return self._point(_joined(eta, u, border), share, base, params)

        found = jax.vmap(one)(self._ends(slot), etas)
        cost = slot.width * (jnp.asarray(self._weights, u.dtype) @ found[:, -1])
        return found[:, :-1].reshape(-1)[self._asked], cost

    def _ends(self, slot: Slot) -> jax.Array:
        """Where the substeps end, the start first."""
        return slot.start + slot.width * jnp.linspace(0.0, 1.0, self.substeps + 1, dtype=slot.width.dtype)

    # ---- derivatives ----------------------------------------------------------------------------------------------

    def derivatives(
        self,
        slot: Slot,
        base: Arrays,
        start: jax.Array,
        u: jax.Array,
        target: Arrays,
        y: jax.Array,
        w: jax.Array,
        border: jax.Array,
        params: Arrays,
    ) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Derivatives of F and of the rows, gradient of the cost, second derivative of the weighted sum."""
        n, size, substeps = self._n, self._size, self.substeps
        stages, length = len(self._b), slot.width / substeps
        a, b = jnp.asarray(self._a, u.dtype), jnp.asarray(self._b, u.dtype)
        etas, points = self.roll(slot, base, start, u, border, params)
        join = lambda e: _joined(e, u, border)  # noqa: E731

        def along(rows: jax.Array, maps: jax.Array) -> jax.Array:
            """Slopes (..., n + m + g) by q along the sensitivities of eta; the rest of q are unknowns themselves."""
            return rows[..., :n] @ maps + jnp.concatenate([jnp.zeros_like(rows[..., :n]), rows[..., n:]], axis=-1)

        # Sensitivities of the stages and of the ends of the substeps to z.
        shares = slot.start + length * (np.arange(substeps)[:, None] + self._c[None, :])
        qs = jax.vmap(jax.vmap(join))(points)
        every = lambda f: jax.vmap(f, in_axes=(0, 0, None, None))  # noqa: E731
        slopes = every(every(self._rate.slopes))(qs, shares, base, params)  # (S, s, n, size)
        sensitivity = jnp.eye(n, size, dtype=u.dtype)
        ends, inner = [sensitivity], []
        for s in range(substeps):
            moved: list[jax.Array] = []
            for i in range(stages):
                at = sensitivity + sum(
                    (length * a[i, j] * moved[j] for j in range(i) if self._a[i, j]), jnp.zeros_like(sensitivity)
                )
                inner.append(at)
                moved.append(along(slopes[s, i], at))
            sensitivity = sensitivity + length * jnp.einsum("i,ijk->jk", b, jnp.stack(moved))
            ends.append(sensitivity)
        maps, end_maps = jnp.stack(inner), jnp.stack(ends)

        def bent(bends: jax.Array, maps: jax.Array) -> jax.Array:
            """The sum of second derivatives (k, n + m + g, n + m + g) by q along sensitivities (k, n, n + m + g)."""
            moved = along(bends, maps)
            found = maps.reshape(-1, size).T @ moved[:, :n].reshape(-1, size)
            rest = moved[:, n:].sum(axis=0)
            return found + jnp.concatenate([jnp.zeros((n, size), rest.dtype), rest])

        # Rows, cost and the gap.
        times, end_qs = self._ends(slot), jax.vmap(join)(etas)
        weights = slot.width * jnp.asarray(self._weights, u.dtype)
        asked = jnp.zeros((substeps + 1) * self._rows, u.dtype).at[self._asked].set(w).reshape(substeps + 1, -1)
        pushes = jnp.concatenate([asked, weights[:, None]], axis=1)
        point_slopes = every(self._point.slopes)(end_qs, times, base, params)
        point_bends = jax.vmap(self._point.bends, in_axes=(0, 0, 0, None, None))(pushes, end_qs, times, base, params)
        gap_slope = self._gap.slopes(etas[-1], base, target)
        gap_bend = self._gap.bends(y, etas[-1], base, target)
        moved_points = along(point_slopes, end_maps)
        rows = moved_points[:, :-1].reshape(-1, size)[self._asked]
        gradient = weights @ moved_points[:, -1]

        # Adjoints, last substep first.
        pulls = jnp.einsum("pr,pri->pi", pushes, point_slopes)
        adjoint = y @ gap_slope + pulls[-1, :n]
        adjoints: list[Any] = [None] * (substeps * stages)
        for s in reversed(range(substeps)):
            through: list[Any] = [None] * stages
            for i in reversed(range(stages)):
                own = length * b[i] * adjoint
                for j in range(i + 1, stages):
                    if self._a[j, i]:
                        own = own + length * a[j, i] * through[j]
                adjoints[s * stages + i] = own
                through[i] = own @ slopes[s, i, :, :n]
            adjoint = adjoint + sum(through) + pulls[s, :n]
        bends = jax.vmap(self._rate.bends, in_axes=(0, 0, 0, None, None))(
            jnp.stack(adjoints), qs.reshape(-1, size), shares.reshape(-1), base, params
        )
        hessian = bent(bends, maps) + bent(point_bends, end_maps) + ends[-1].T @ gap_bend @ ends[-1]
        return gap_slope @ ends[-1], rows, gradient, 0.5 * (hessian + hessian.T)


def _joined(eta: jax.Array, u: jax.Array, border: jax.Array) -> jax.Array:
    return jnp.concatenate([eta, u, border])


def _weights(substeps: int) -> Array:
    """Weights of the points of a unit interval: Simpson's rule, the trapezoid rule where substeps are odd."""
    weights = np.ones(substeps + 1)
    if substeps % 2:
        weights[1:-1] = 2.0
    else:
        weights[1:-1:2] = 4.0
        weights[2:-1:2] = 2.0
    return weights / weights.sum()
