"""Gauss-Newton steps of multiple shooting: initial states of segments are eliminated, and bounds are satisfied."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ...groups import Product
from ...scalar.kernel_function import KernelFunction
from ...system.dynamics import Arrays
from .experiment import SegmentedData, StartEstimate
from .segments import Likelihood, LinearizedSegment, Segments, gap_and_slopes

#: Eigenvalues of a scaled matrix below it count as zero, in units of the round-off: the step keeps such combinations.
_SINGULAR = 1e4


class Prior(NamedTuple):
    """Prior knowledge of the parameters: expected values (p,), information matrix (p, p), and limits (2, p)."""

    mean: jax.Array
    information: jax.Array
    limits: jax.Array


class SegmentUnknowns(NamedTuple):
    """The unknowns: initial states of segments (experiments, segments, *shape), parameters (p,), and weights of
    gaps.
    """

    starts: Arrays
    theta: jax.Array
    weights: jax.Array

    def started(self, starts: Arrays) -> SegmentUnknowns:
        """The same with other starts."""
        return self._replace(starts=starts)


class Condensed(NamedTuple):
    """The linearised problem in z = [initial states of experiments (r n); theta (p)], with gaps eliminated.

    Attributes:
        cost, likelihood: the results of `ShootingSteps.cost`.
        gradient, information: derivatives of the cost including priors.
        of_data: the information without that of priors of parameters.
        tangents: (experiments, segments, n, n + p + 1), the initial states of segments $T [d_0; theta; 1]$.
        gaps: the gaps between segments and their derivatives.
    """

    cost: jax.Array
    likelihood: Likelihood
    gradient: jax.Array
    information: jax.Array
    of_data: jax.Array
    tangents: jax.Array
    gaps: tuple[jax.Array, jax.Array, jax.Array]


class ShootingSteps:
    """The steps for records in segments.

    The cost is the negative log posterior density, with the constraint that the end of each segment is the start of the
    next one. A step solves the problem with linearised residuals and gaps, with Fisher's information matrix as Hessian;
    the initial states of later segments are eliminated by forward substitution. It is accepted if the sum of cost and
    weighted absolute gaps decreases.

    Source: Bock, Randwertproblemmethoden zur Parameteridentifizierung (1987); Albersmeyer, Diehl, The lifted Newton
    method and its application in optimization, SIAM J. Optim. 20 (2010); bounds as in Bertsekas, Projected Newton
    methods for optimization problems with simple constraints, SIAM J. Control Optim. 20 (1982).
    """

    def __init__(self, segments: Segments) -> None:
        self.segments, self.group = segments, segments.model.group
        backend = segments.model.dynamics.backend
        self._gap = KernelFunction(functools.partial(gap_and_slopes, self.group), backend)
        self._start_residual = KernelFunction(functools.partial(_start_residual, self.group), backend)
        self._retracted = KernelFunction[Arrays](self.group.retract, backend)
        self._difference = KernelFunction[jax.Array](self.group.difference, backend)

    def linearized(self, unknowns: SegmentUnknowns, data: SegmentedData) -> LinearizedSegment:
        """All segments linearised about their initial states and the parameters, (experiments, segments, ...)."""

        def one(x: Arrays, rows: Any, P0: jax.Array) -> LinearizedSegment:
            return self.segments.linearized(x, unknowns.theta, rows, data.params, P0)

        of_experiment = jax.vmap(one, (0, 0, None))
        return jax.vmap(of_experiment)(unknowns.starts, data.rows, data.starts.P0)

    def cost(
        self, unknowns: SegmentUnknowns, segments: LinearizedSegment, data: SegmentedData, prior: Prior
    ) -> jax.Array:
        """The negative log posterior density, and the weighted gaps."""

        def one(starts: Arrays, segments: LinearizedSegment, start: StartEstimate) -> Any:
            gap = jax.vmap(lambda end, following: self._difference(following, end))
            _, e = self._start_residual(start.x, _first(starts))
            return gap(segments.end, _following(starts, segments.end)), 0.5 * e @ start.information @ e

        gaps, of_start = jax.vmap(one)(unknowns.starts, segments, data.starts)
        total = jnp.sum(segments.likelihood.cost) + jnp.sum(of_start) + _of_prior(prior, unknowns.theta)
        return total + jnp.sum(unknowns.weights * jnp.abs(gaps))

    # ---- a step ------------------------------------------------------------------------------------------------------

    def condensed(
        self,
        unknowns: SegmentUnknowns,
        segments: LinearizedSegment,
        data: SegmentedData,
        prior: Prior,
        closed: Any = 1.0,
    ) -> Condensed:
        """The linearised problem about the unknowns, in which a fraction of all gaps is closed."""
        n, p, theta = self.group.dimension, unknowns.theta.size, unknowns.theta
        count = len(data.starts.unknown)

        def one(starts: Arrays, segments: LinearizedSegment, start: StartEstimate) -> Any:
            following = _following(starts, segments.end)
            gaps = jax.vmap(self._gap)(segments.end, following)
            g, N, tangents = _eliminated(segments, (gaps[0] * closed, *gaps[1:]))
            slope, e = self._start_residual(start.x, _first(starts))
            g = g.at[:n].add(slope.T @ start.information @ e)
            of_start = 0.5 * e @ start.information @ e, slope.T @ start.information @ slope
            return g, N, of_start, tangents, gaps

        g, N, (costs, of_start), tangents, gaps = jax.vmap(one)(unknowns.starts, segments, data.starts)
        size = count * n + p
        gradient, information = jnp.zeros(size, theta.dtype), jnp.zeros((size, size), theta.dtype)
        last = jnp.arange(count * n, size)
        for r in range(count):
            places = jnp.concatenate([jnp.arange(r * n, (r + 1) * n), last])
            gradient = gradient.at[places].add(g[r])
            information = information.at[places[:, None], places].add(N[r])
            information = information.at[places[:n, None], places[:n]].add(of_start[r])
        of_data = information
        gradient = gradient.at[last].add(prior.information @ (theta - prior.mean))
        information = information.at[last[:, None], last].add(prior.information)
        likelihood = jax.tree.map(jnp.sum, segments.likelihood)
        cost = likelihood.cost + jnp.sum(costs) + _of_prior(prior, theta)
        return Condensed(cost, likelihood, gradient, information, of_data, tangents, gaps)

    def free(self, problem: Condensed, unknowns: SegmentUnknowns, data: SegmentedData, prior: Prior) -> jax.Array:
        """The entries of z that may change: not known ones, nor parameters at a bound that the gradient points
        beyond.
        """
        slope = problem.gradient[-unknowns.theta.size :]
        low, high = prior.limits
        blocked = ((unknowns.theta <= low) & (slope > 0.0)) | ((unknowns.theta >= high) & (slope < 0.0))
        return jnp.concatenate([data.starts.unknown.reshape(-1), ~blocked])

    def step(
        self,
        unknowns: SegmentUnknowns,
        segments: LinearizedSegment,
        damping: jax.Array,
        data: SegmentedData,
        prior: Prior,
    ) -> tuple[SegmentUnknowns, jax.Array, jax.Array]:
        """A step, its size, the change of all residuals in standard deviations, and the cost before it."""
        n, p = self.group.dimension, unknowns.theta.size
        # A damped step is short in all that it does.
        problem = self.condensed(unknowns, segments, data, prior, 1.0 / (1.0 + damping))
        z = -solved(problem, self.free(problem, unknowns, data, prior), damping)
        theta = jnp.clip(unknowns.theta + z[-p:], *prior.limits)
        change = theta - unknowns.theta
        first = z[:-p].reshape(-1, n)
        ones = jnp.ones((len(first), 1), theta.dtype)
        change_of_all = jnp.concatenate([first, jnp.broadcast_to(change, (len(first), p)), ones], axis=1)
        d = jnp.einsum("rjnz,rz->rjn", problem.tangents, change_of_all)
        starts = jax.vmap(jax.vmap(self._retracted))(unknowns.starts, d)
        both = jnp.concatenate([d, jnp.broadcast_to(change, (*d.shape[:2], p))], axis=2)
        size = jnp.sqrt(jnp.einsum("rjp,rjpq,rjq->", both, segments.information, both))
        multipliers = jnp.abs(jax.vmap(_multipliers)(segments, problem.gaps, both))
        # They follow the multipliers down too: the first ones, of wrong parameters, would keep steps short for good.
        weights = 1.1 * jnp.maximum(multipliers, 0.5 * (unknowns.weights + multipliers))
        before = problem.cost + jnp.sum(weights * jnp.abs(problem.gaps[0]))
        return SegmentUnknowns(starts, theta, weights), size, before

    def start_step(self, x: Arrays, segment: LinearizedSegment, damping: jax.Array) -> tuple[Arrays, jax.Array]:
        """A step of the initial state of one segment, fitted to its measurements alone with constant parameters, and
        its size.
        """
        n = self.group.dimension
        N, g = segment.information[:n, :n], segment.gradient[:n]
        d = -damped_solve(N, g, jnp.ones(n, bool), damping)
        return self._retracted(x, d), jnp.sqrt(d @ N @ d)


def solved(problem: Condensed, free: jax.Array, damping: jax.Array) -> jax.Array:
    """The solution $(N + damping diag N)^+ g$ for the free entries."""
    return damped_solve(problem.information, problem.gradient, free, damping)


def damped_solve(N: jax.Array, g: jax.Array, free: jax.Array, damping: jax.Array) -> jax.Array:
    """The solution $(N + damping diag N)^+ g$ with entries scaled to a unit diagonal; zero for entries that are not
    free.
    """
    values, vectors, scale = scaled_eigenvalues(N, free)
    small = values <= _SINGULAR * float(jnp.finfo(N.dtype).eps)
    inverse = jnp.where(small, 0.0, 1.0 / jnp.where(small, 1.0, values + damping))
    return scale * (vectors @ (inverse * (vectors.T @ (scale * jnp.where(free, g, 0.0)))))


def scaled_eigenvalues(N: jax.Array, free: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Eigenvalues and eigenvectors of $D N D$, which has a unit diagonal, and D, (n,): zero for entries that are not
    free.
    """
    size = jnp.sqrt(jnp.where(free, jnp.diag(N), 0.0))
    scale = jnp.where(size > 0.0, 1.0 / jnp.where(size > 0.0, size, 1.0), 0.0)
    matrix = N * scale[:, None] * scale[None, :]
    values, vectors = jnp.linalg.eigh(jnp.where(jnp.isfinite(matrix), matrix, 0.0))
    return jnp.where(jnp.isfinite(matrix).all(), values, jnp.nan), vectors, scale


def _of_prior(prior: Prior, theta: jax.Array) -> jax.Array:
    e = theta - prior.mean
    return 0.5 * e @ prior.information @ e


def _first(starts: Arrays) -> Arrays:
    return {name: x[0] for name, x in starts.items()}


def _following(starts: Arrays, ends: Arrays) -> Arrays:
    """The start after each segment; after the last one its end, without a gap."""
    return {name: jnp.concatenate([x[1:], ends[name][-1:]]) for name, x in starts.items()}


def _start_residual(group: Product, start: Arrays, x: Arrays) -> tuple[jax.Array, jax.Array]:
    """The derivative (n, n) by x of the difference (n,) of a first state from its estimate, and the difference."""
    e = group.difference(start, x)
    return group.right_jacobian_inv(e), e


def _eliminated(segments: LinearizedSegment, gaps: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The gradient and information of an experiment in [d_0; theta], and the starts of its segments in them."""
    n, q = segments.slope.shape[1:]
    zero = jnp.zeros((), segments.slope.dtype)
    parameters = jnp.eye(q, q + 1, dtype=zero.dtype)[n:]

    def advance(carry: Any, row: Any) -> tuple[Any, jax.Array]:
        T, g, N = carry
        segment, (gap, by_start, by_end) = row
        z = jnp.concatenate([T, parameters])
        linear, constant = z[:, :-1], z[:, -1]
        g = g + linear.T @ (segment.gradient + segment.information @ constant)
        N = N + linear.T @ segment.information @ linear
        end = by_end @ (segment.slope @ z)
        return (-jnp.linalg.solve(by_start, end.at[:, -1].add(gap)), g, N), T

    start = jnp.eye(n, q + 1, dtype=zero.dtype), jnp.zeros(q, zero.dtype), jnp.zeros((q, q), zero.dtype)
    (_, g, N), tangents = jax.lax.scan(advance, start, (segments, gaps))
    return g, N, tangents


def _multipliers(segments: LinearizedSegment, gaps: Any, steps: jax.Array) -> jax.Array:
    """The multipliers of the gaps (segments, n) after the steps (segments, q), backward; that of the last is zero."""
    n = segments.slope.shape[1]

    def back(after: jax.Array, row: Any) -> tuple[jax.Array, jax.Array]:
        segment, (_, by_start, by_end), move = row
        multiplier = -jnp.linalg.solve(by_start.T, after)
        slope = segment.gradient + segment.information @ move
        return slope[:n] + segment.slope[:, :n].T @ by_end.T @ multiplier, multiplier

    nothing = jnp.zeros(n, steps.dtype)
    return jax.lax.scan(back, nothing, (segments, gaps, steps), reverse=True)[1]
