"""One interval of a transcription: its end, rows, cost and their derivatives, by a Runge-Kutta method.

An interval is integrated in exponential coordinates eta about its first node, x = base Exp(eta), over shares of the
duration of the phase. What is unknown is z = [d, u, b]: the start eta = d, the controls, the border. Second derivatives
of y.F + w.rows + cost follow from the adjoints of the stages: every stage adds G' M G, with M the second derivative of
the rates weighted by its adjoint and G its sensitivity to z.

The slopes k_i = f(eta + h sum_j a_ij k_j) of an explicit method follow one from the other. Those of collocation are
solved for by Newton's method inside of the interval, and are no unknowns of the problem: its stages stay as small as
those of an explicit method, and there is nothing for a line search to weigh against anything else.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from ..integrators.tableaus import ButcherTableau, CollocationTableau
from ..system.dynamics import Arrays
from .smooth import Smooth

#: Newton steps of collocation at most, and the size of a step, relative, after which one more is the last.
_NEWTON, _CLOSE = 20, 1e-9


class Slot(NamedTuple):
    """Where an interval lies, in shares of the duration of its phase."""

    start: Any
    width: Any


class Rolled(NamedTuple):
    """An integrated interval."""

    ends: Any  # (S + 1, n) eta at the ends of the S substeps, the start first
    stages: Any  # (S, s, n) at all stages


class Interval:
    """The maths of an interval, by an explicit method.

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
        tableau: ButcherTableau | CollocationTableau,
        substeps: int,
        *,
        n: int,
        size: int,
        asked: Array,
        rows: int,
    ) -> None:
        self._rate, self._point, self._gap = rate, point, gap
        self.substeps, self._n, self._size, self._asked, self._rows = substeps, n, size, asked.astype(np.int32), rows
        self._a, self._b, self._c = self._coefficients(tableau)

    def _coefficients(self, tableau: Any) -> tuple[Array, Array, Array]:
        """a, b and c of the stages that count."""
        a, c = tableau.counted
        return a, tableau.b[: len(c)], c

    # ---- values ---------------------------------------------------------------------------------------------------

    def roll(self, slot: Slot, base: Arrays, eta: jax.Array, u: jax.Array, border: jax.Array, params: Arrays) -> Rolled:
        """Integrate."""
        length = slot.width / self.substeps

        def ahead(eta: jax.Array, shares: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
            points, slopes = self._stages(shares, length, base, eta, u, border, params)
            after = eta + length * (jnp.asarray(self._b, u.dtype) @ slopes)
            return after, (after, points)

        _, (ends, stages) = jax.lax.scan(ahead, eta, self._stage_shares(slot))
        return Rolled(jnp.concatenate([eta[None], ends]), stages)

    def _stages(
        self,
        shares: jax.Array,
        length: jax.Array,
        base: Arrays,
        eta: jax.Array,
        u: jax.Array,
        border: jax.Array,
        params: Arrays,
    ) -> tuple[jax.Array, jax.Array]:
        """The stages (s, n) of a substep and their slopes (s, n)."""

        points, slopes = list[jax.Array](), list[jax.Array]()
        for i, weights in enumerate(self._a):
            points.append(eta + length * _weighted(weights, slopes))
            slopes.append(self._rate(_joined(points[-1], u, border), shares[i], base, params))
        return jnp.stack(points), jnp.stack(slopes)

    def at_points(
        self, slot: Slot, base: Arrays, rolled: Rolled, u: jax.Array, border: jax.Array, params: Arrays
    ) -> tuple[jax.Array, jax.Array]:
        """The rows that are asked, and the share of the running cost."""

        def one(share: jax.Array, eta: jax.Array) -> jax.Array:
            return self._point(_joined(eta, u, border), share, base, params)

        shares, etas, weights = self._looked_at(slot, rolled)
        found = jax.vmap(one)(shares, etas)
        rows = found[: self.substeps + 1, :-1].reshape(-1)[self._asked]
        return rows, slot.width * (jnp.asarray(weights, u.dtype) @ found[:, -1])

    def _looked_at(self, slot: Slot, rolled: Rolled) -> tuple[jax.Array, jax.Array, Array]:
        """Shares and eta of points, the ends of substeps first, and weights of the cost there, of a unit interval."""
        return self.ends(slot), rolled.ends, simpson(self.substeps)

    def ends(self, slot: Slot) -> jax.Array:
        """Where the substeps end, the start first."""
        return slot.start + slot.width * jnp.linspace(0.0, 1.0, self.substeps + 1, dtype=slot.width.dtype)

    def _stage_shares(self, slot: Slot) -> jax.Array:
        """(S, s) where the stages are."""
        return slot.start + slot.width / self.substeps * (np.arange(self.substeps)[:, None] + self._c[None, :])

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
        length = slot.width / substeps
        rolled = self.roll(slot, base, start, u, border, params)
        join = lambda e: _joined(e, u, border)  # noqa: E731

        # Sensitivities of the stages and of the ends of the substeps to z.
        shares = self._stage_shares(slot)
        qs = jax.vmap(jax.vmap(join))(rolled.stages)
        every = lambda f: jax.vmap(f, in_axes=(0, 0, None, None))  # noqa: E731
        slopes = every(every(self._rate.slopes))(qs, shares, base, params)  # (S, s, n, size)
        sensitivity = jnp.eye(n, size, dtype=u.dtype)

        def ahead(sensitivity: jax.Array, own: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
            at, moved = self._sensitivities(own, sensitivity, length)
            after = sensitivity + length * _weighted(self._b, moved)
            return after, (after, at)

        last, (ends, inner) = jax.lax.scan(ahead, sensitivity, slopes)
        maps, end_maps = inner.reshape(-1, n, size), jnp.concatenate([sensitivity[None], ends])

        def bent(bends: jax.Array, maps: jax.Array) -> jax.Array:
            """The sum of second derivatives (k, n + m + g, n + m + g) by q along sensitivities (k, n, n + m + g)."""
            moved = _along(bends, maps)
            found = maps.reshape(-1, size).T @ moved[:, :n].reshape(-1, size)
            rest = moved[:, n:].sum(axis=0)
            return found + jnp.concatenate([jnp.zeros((n, size), rest.dtype), rest])

        # Rows, cost and the gap.
        times, etas, quadrature = self._looked_at(slot, rolled)
        weights = slot.width * jnp.asarray(quadrature, u.dtype)
        point_qs = jax.vmap(join)(etas)
        point_maps = end_maps if len(etas) == len(end_maps) else jnp.concatenate([end_maps, maps])
        asked = jnp.zeros((substeps + 1) * self._rows, u.dtype).at[self._asked].set(w).reshape(substeps + 1, -1)
        asked = jnp.concatenate([asked, jnp.zeros((len(etas) - substeps - 1, self._rows), u.dtype)])
        pushes = jnp.concatenate([asked, weights[:, None]], axis=1)
        point_slopes = every(self._point.slopes)(point_qs, times, base, params)
        point_bends = jax.vmap(self._point.bends, in_axes=(0, 0, 0, None, None))(pushes, point_qs, times, base, params)
        gap_slope = self._gap.slopes(rolled.ends[-1], base, target)
        gap_bend = self._gap.bends(y, rolled.ends[-1], base, target)
        moved_points = _along(point_slopes, point_maps)
        rows = moved_points[: substeps + 1, :-1].reshape(-1, size)[self._asked]
        gradient = weights @ moved_points[:, -1]

        # Adjoints, last substep first.
        pulls = jnp.einsum("pr,pri->pi", pushes, point_slopes)[:, :n]
        of_stages = None if len(etas) == len(end_maps) else pulls[substeps + 1 :].reshape(substeps, -1, n)

        def back(adjoint: jax.Array, own: Any) -> tuple[jax.Array, jax.Array]:
            slopes, pull, of_stages = own
            adjoints, through = self._adjoints(slopes[..., :n], adjoint, of_stages, length)
            return adjoint + through + pull, adjoints

        begin = y @ gap_slope + pulls[substeps]
        _, adjoints = jax.lax.scan(back, begin, (slopes, pulls[:substeps], of_stages), reverse=True)
        bends = jax.vmap(self._rate.bends, in_axes=(0, 0, 0, None, None))(
            adjoints.reshape(-1, n), qs.reshape(-1, size), shares.reshape(-1), base, params
        )
        hessian = bent(bends, maps) + bent(point_bends, point_maps) + last.T @ gap_bend @ last
        return gap_slope @ last, rows, gradient, 0.5 * (hessian + hessian.T)

    def _sensitivities(self, slopes: jax.Array, start: jax.Array, length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Of the stages of a substep and of their slopes, (s, n, size) both, from that of its start."""

        points, moved = [], list[jax.Array]()
        for weights, slope in zip(self._a, slopes):
            points.append(start + length * _weighted(weights, moved))
            moved.append(_along(slope, points[-1]))
        return jnp.stack(points), jnp.stack(moved)

    def _adjoints(
        self, slopes: jax.Array, adjoint: jax.Array, pulls: jax.Array | None, length: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Adjoints of the slopes of a substep (s, n), and what its start gets through them.

        Args:
            slopes: (s, n, n) of the stages.
            adjoint: of the end of the substep.
            pulls: (s, n) what pulls at the stages themselves, or None.
        """

        found, through = list[jax.Array](), list[jax.Array]()  # the last stage first
        for i in reversed(range(len(self._b))):
            later = self._a[:i:-1, i]
            found.append(length * (self._b[i] * adjoint + _weighted(later, through)))
            through.append(found[-1] @ slopes[i])
        return jnp.stack(found[::-1]), jnp.stack(through).sum(axis=0)


class Collocated(Interval):
    """The maths of an interval, by collocation. The running cost is integrated by the weights of the method."""

    def _coefficients(self, tableau: Any) -> tuple[Array, Array, Array]:
        return tableau.a, tableau.b, tableau.c

    def _stages(
        self,
        shares: jax.Array,
        length: jax.Array,
        base: Arrays,
        eta: jax.Array,
        u: jax.Array,
        border: jax.Array,
        params: Arrays,
    ) -> tuple[jax.Array, jax.Array]:
        a = length * jnp.asarray(self._a, u.dtype)

        def improved(slopes: jax.Array) -> tuple[jax.Array, jax.Array]:
            """After a step of Newton's method, and its relative size."""
            qs = jax.vmap(lambda e: _joined(e, u, border))(eta[None] + a @ slopes)
            over = lambda f: jax.vmap(f, in_axes=(0, 0, None, None))  # noqa: E731
            residual = slopes - over(self._rate)(qs, shares, base, params)
            by_eta = over(self._rate.slopes)(qs, shares, base, params)[..., : self._n]
            step = _solved(_system(by_eta, a), residual)
            size = jnp.abs(length * step).max() / (1.0 + jnp.abs(length * slopes).max())
            return slopes - step, size

        def going(carry: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
            return (carry[1] > _CLOSE) & (carry[2] < _NEWTON)

        def again(carry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
            return *improved(carry[0]), carry[2] + 1

        first = self._rate(_joined(eta, u, border), shares[0], base, params)
        begin = (jnp.broadcast_to(first, (len(self._b), self._n)), jnp.asarray(jnp.inf, u.dtype), jnp.zeros((), int))
        slopes, _, count = jax.lax.while_loop(going, again, begin)
        # The last one is outside of the loop: derivatives of all that went before are forgotten by it.
        slopes, _ = improved(slopes)
        slopes = jnp.where(count < _NEWTON, slopes, jnp.nan)
        return eta[None] + a @ slopes, slopes

    def _looked_at(self, slot: Slot, rolled: Rolled) -> tuple[jax.Array, jax.Array, Array]:
        shares = jnp.concatenate([self.ends(slot), self._stage_shares(slot).reshape(-1)])
        etas = jnp.concatenate([rolled.ends, rolled.stages.reshape(-1, self._n)])
        weights = np.concatenate([np.zeros(self.substeps + 1), np.tile(self._b / self.substeps, self.substeps)])
        return shares, etas, weights

    def _sensitivities(self, slopes: jax.Array, start: jax.Array, length: jax.Array) -> tuple[jax.Array, jax.Array]:
        a = length * jnp.asarray(self._a, slopes.dtype)
        of_start = _along(slopes, jnp.broadcast_to(start, slopes.shape))
        moved = _solved(_system(slopes[..., : self._n], a), of_start)
        return start[None] + jnp.einsum("ij,jkl->ikl", a, moved), moved

    def _adjoints(
        self, slopes: jax.Array, adjoint: jax.Array, pulls: jax.Array | None, length: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        a, b = length * jnp.asarray(self._a, slopes.dtype), length * jnp.asarray(self._b, slopes.dtype)
        own = jnp.zeros_like(slopes[..., 0]) if pulls is None else pulls
        found = _solved(_system(slopes, a).T, b[:, None] * adjoint[None] + a.T @ own)
        return found, (jnp.einsum("in,ink->ik", found, slopes) + own).sum(axis=0)


def _system(slopes: jax.Array, a: jax.Array) -> jax.Array:
    """The matrix of k_i - J_i sum_j a_ij k_j, (s n, s n), of slopes J (s, n, n)."""
    s, n, _ = slopes.shape
    coupled = a[:, None, :, None] * slopes[:, :, None, :]
    return jnp.eye(s * n, dtype=slopes.dtype) - coupled.reshape(s * n, s * n)


def _solved(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """The solution for right sides (s, n, ...)."""
    return jnp.linalg.solve(matrix, right.reshape(len(matrix), -1)).reshape(right.shape)


def _along(rows: jax.Array, maps: jax.Array) -> jax.Array:
    """Slopes (..., n + m + g) by q along the sensitivities of eta; the rest of q are unknowns themselves."""
    n = maps.shape[-2]
    return rows[..., :n] @ maps + jnp.concatenate([jnp.zeros_like(rows[..., :n]), rows[..., n:]], axis=-1)


def _weighted(weights: Array, terms: Any) -> Any:
    """The sum of the terms that count."""
    return sum(float(w) * term for w, term in zip(weights, terms) if w)


def _joined(eta: jax.Array, u: jax.Array, border: jax.Array) -> jax.Array:
    return jnp.concatenate([eta, u, border])


def simpson(substeps: int) -> Array:
    """Weights of the points of a unit interval: Simpson's rule, the trapezoid rule where substeps are odd."""
    weights = np.ones(substeps + 1)
    if substeps % 2:
        weights[1:-1] = 2.0
    else:
        weights[1:-1:2] = 4.0
        weights[2:-1:2] = 2.0
    return weights / weights.sum()
