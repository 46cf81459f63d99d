"""A primal-dual interior point with a filter line search, on the tangent space of a transcribed problem.

Inequalities g <= 0 get slacks, g + s = 0, s > 0. For a barrier parameter mu that falls to zero Newton's method solves

    grad L = 0,   F_k - d_(k+1) = 0,   c = 0,   g + s = 0,   s w = mu,

with the exact second derivative of the Lagrangian L. The equations are factored stage by stage; where they do not have
the inertia of a minimum, the diagonal is raised until they do. A step is accepted if it reduces the violation or the
barrier function enough and if the filter does not know better, with second-order corrections; where no step is, the
violation alone is reduced.
Source: Wachter and Biegler, On the implementation of an interior-point filter line-search algorithm for large-scale
nonlinear programming, Mathematical Programming 106 (2006); numbers in brackets are its equations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .iterate import FILTER, Errors, Scales, State
from .riccati import Rows, Stages, along_rows, factorize, of_stages, refined, to_step
from .transcribed import Derivatives, Given, Point, Step, Transcribed, Values

#: The first barrier parameter, and how it falls (7).
_FIRST_BARRIER, _BARRIER_SHARE, _BARRIER_POWER, _BARRIER_ERROR = 0.1, 0.2, 1.5, 10.0
#: How near to the boundary a step may come (8), and how far a multiplier may leave its central value (16).
_BOUNDARY, _CENTRAL = 0.99, 1e10
#: Of the line search: (18), (19), (20), and the smallest step (23).
_THETA_GAIN, _PHI_GAIN, _THETA_POWER, _PHI_POWER, _ARMIJO = 1e-5, 1e-8, 1.1, 2.3, 1e-8
_LEAST_SHARE, _CORRECTIONS, _CORRECTION_SHARE = 0.05, 4, 0.99
#: What is added to the diagonal where the inertia is wrong (algorithm IC).
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-20, 1e40
_FASTER, _FAST, _SLOW = 100.0, 8.0, 1.0 / 3.0
#: Equations other than the dynamics hold to this times the change of their multipliers.
_EQUALITY = 1e-8
#: The largest turn of a step, rad, and its largest change of a duration, relative. A duration that falls faster has
#: come to its limit before states and controls have followed it.
_LARGEST_TURN, _LARGEST_CHANGE = 1.5, 0.3
#: How much a parameter may shrink, relative, and grow, and a control, relative or in its scale: beyond them nothing is
#: linear.
_LARGEST_FALL, _LARGEST_GROWTH, _FARTHEST = 0.5, 2.0, 30.0
#: The least first slack.
_FIRST_SLACK = 1e-2


class _Trial(NamedTuple):
    point: Point
    values: Values
    slack: Any
    theta: Any
    phi: Any


class _Direction(NamedTuple):
    """A Newton step of unknowns, slacks and multipliers; its largest shares; the slope of the barrier function."""

    step: Step
    slack: Any
    dynamics: Any
    rows: Any
    primal: Any
    dual: Any
    tilt: Any


class _Search(NamedTuple):
    """Where a line search stands."""

    share: Any  # of the step to try next
    way: _Direction
    first: _Direction  # the one without corrections
    defects: Any  # what a direction is to remove
    rows: Any
    pending: Any  # whether a direction is to be computed
    corrections: Any  # how many there were
    theta: Any  # violation of the last trial
    found: _Trial
    done: Any
    by_phi: Any
    entry: Any  # of the filter


class InteriorPoint:
    """Newton steps for a transcribed problem; pure functions of a State, to be jitted and batched."""

    def __init__(self, shooting: Transcribed, tolerance: float) -> None:
        self._shooting = shooting
        self.exists, self.move, self.values = shooting.exists, shooting.move, shooting.values
        self.free, self.size = shooting.free, (shooting.n, shooting.m)
        self.free_start = np.concatenate([shooting.free.d[0], shooting.free.border])
        self.inequality = shooting.exists & ~shooting.equality
        self.equality = shooting.exists & shooting.equality
        self._least_barrier = 0.1 * tolerance / max(1, int(self.inequality.sum()))
        #: Inequalities are relaxed by so much, so that there is room between those that pin a point.
        inner = shooting.intervals * shooting.rows_per_interval
        at_end = np.arange(len(shooting.exists)) >= inner
        self._room = np.where(self.inequality & at_end, 1e-2 * tolerance, 0.0)

    # ---- scaled values ------------------------------------------------------------------------------------------

    def scaled(self, values: Values, scales: Scales) -> Values:
        rows = jnp.where(self._shooting.exists, values.rows / scales.rows, 0.0)
        rows = rows - self._room
        return Values(values.cost / scales.cost, values.defects / scales.d[1:], rows)

    def derivatives(self, state: State, given: Given) -> Derivatives:
        """The scaled derivatives, second ones with the multipliers of the state."""
        return self.derivatives_at(state.point, state.dynamics, state.rows, state.scales, given)

    def derivatives_at(
        self, point: Point, dynamics: jax.Array, rows: jax.Array, scales: Scales, given: Given, d: Any = None
    ) -> Derivatives:
        """The scaled derivatives at a point, second ones with scaled multipliers; d as `Shooting.values` has it."""
        s = scales
        y, w = dynamics * s.cost / s.d[1:], rows * s.cost / s.rows
        raw = self._shooting.derivatives(point, y, jnp.where(self._shooting.exists, w, 0.0), given, d)
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

    def split(self, rows: jax.Array) -> Rows:
        count = self._shooting.intervals * self._shooting.rows_per_interval
        return Rows(rows[:count].reshape(self._shooting.intervals, -1), rows[count:])

    @staticmethod
    def join(rows: Rows) -> jax.Array:
        return jnp.concatenate([rows.inner.reshape(-1), rows.end])

    # ---- measures -----------------------------------------------------------------------------------------------

    def lagrangian(self, slopes: Derivatives, y: jax.Array, w: jax.Array) -> Step:
        """The gradient of the Lagrangian by all unknowns that are free."""
        rows = self.split(w)
        inner = slopes.gradient + jnp.einsum("kn,kna->ka", y, slopes.defects)
        inner = inner + jnp.einsum("kr,kra->ka", rows.inner, slopes.rows)
        end = slopes.end_gradient + rows.end @ slopes.end_rows
        whole = to_step(inner, end, self._shooting.n)
        whole = whole._replace(d=whole.d - jnp.concatenate([jnp.zeros_like(y[:1]), y]))
        return jax.tree.map(lambda a, free: jnp.where(free, a, 0.0), whole, self._shooting.free)

    def violation(self, values: Values, slack: jax.Array) -> jax.Array:
        """Residuals of all rows; values are scaled."""
        return jnp.where(self.inequality, values.rows + slack, jnp.where(self.equality, values.rows, 0.0))

    def errors(self, values: Values, slopes: Derivatives, state: State) -> Errors:
        pull = self.lagrangian(slopes, state.dynamics, state.rows)
        rows = self.violation(values, state.slack)
        products = jnp.where(self.inequality, state.slack * state.rows, 0.0)
        lost = jnp.abs(state.rows * rows).sum() + jnp.abs(state.dynamics * values.defects).sum()
        return Errors(largest(pull), largest((values.defects, rows)), products.max(initial=0.0), products.sum() + lost)

    def theta(self, values: Values, slack: jax.Array) -> jax.Array:
        return jnp.abs(values.defects).sum() + jnp.abs(self.violation(values, slack)).sum()

    def phi(self, values: Values, slack: jax.Array, barrier: jax.Array) -> jax.Array:
        return values.cost - barrier * jnp.where(self.inequality, jnp.log(slack), 0.0).sum()

    # ---- a start ------------------------------------------------------------------------------------------------

    def start(self, point: Point, given: Given, scales: Scales, barrier: Any = _FIRST_BARRIER) -> State:
        """The state at a point: slacks from its rows, multipliers of the dynamics zero."""
        raw = self._shooting.values(point, given)
        values = self.scaled(raw, scales)
        slack = jnp.where(self.inequality, jnp.maximum(-values.rows, _FIRST_SLACK), 1.0)
        barrier = jnp.asarray(barrier, slack.dtype)
        zero = jnp.zeros((), slack.dtype)
        theta = self.theta(values, slack)
        return State(
            point,
            raw,
            slack,
            jnp.zeros_like(values.defects),
            jnp.where(self.inequality, barrier / slack, 0.0),
            barrier,
            zero,
            zero,
            jnp.full((2, FILTER), jnp.inf, slack.dtype),
            jnp.zeros((), int),
            theta,
            scales,
            Errors(*[zero + jnp.inf] * 4),
            zero + 1.0,
            jnp.zeros((), bool),
        )

    def rescaled(self, state: State, scales: Scales) -> State:
        """The same state in other scales, its filter forgotten. The scaled barrier parameter does not fall."""
        old = state.scales
        cost, ratio = old.cost / scales.cost, old.rows / scales.rows
        slack = jnp.where(self.inequality, state.slack * ratio, 1.0)
        values = self.scaled(state.values, scales)
        slack = jnp.where(self.inequality, jnp.maximum(slack, -values.rows), 1.0)
        return state._replace(
            slack=slack,
            dynamics=state.dynamics * cost * scales.d[1:] / old.d[1:],
            rows=state.rows * cost / ratio,
            barrier=state.barrier * jnp.maximum(cost, 1.0),
            scales=scales,
            filter=jnp.full_like(state.filter, jnp.inf),
            filtered=jnp.zeros_like(state.filtered),
            first=self.theta(values, slack),
        )

    # ---- a step -------------------------------------------------------------------------------------------------

    def looked_at(self, state: State, given: Given) -> tuple[Derivatives, State]:
        """The derivatives at a state, and the state measured."""
        slopes = self.derivatives(state, given)
        return slopes, self.measured(state, slopes)

    def measured(self, state: State, slopes: Derivatives) -> State:
        """The state with its errors and the barrier parameter that they allow."""
        values = self.scaled(state.values, state.scales)
        errors = self.errors(values, slopes, state)
        count = max(1, int(self.inequality.sum()))
        dual = jnp.maximum(
            1.0,
            (jnp.abs(state.rows).sum() + jnp.abs(state.dynamics).sum())
            / (100.0 * (state.rows.size + state.dynamics.size)),
        )
        bound = jnp.maximum(1.0, jnp.where(self.inequality, jnp.abs(state.rows), 0.0).sum() / (100.0 * count))
        products = state.slack * state.rows

        def error(barrier: jax.Array) -> jax.Array:
            central = jnp.where(self.inequality, jnp.abs(products - barrier), 0.0).max(initial=0.0)
            return jnp.maximum(jnp.maximum(errors.stationarity / dual, errors.feasibility), central / bound)

        def lower(barrier: jax.Array) -> jax.Array:
            return jnp.maximum(self._least_barrier, jnp.minimum(_BARRIER_SHARE * barrier, barrier**_BARRIER_POWER))

        low = lambda b: (error(b) <= _BARRIER_ERROR * b) & (b > self._least_barrier)  # noqa: E731
        barrier = jax.lax.while_loop(low, lower, state.barrier)
        fell = barrier < state.barrier
        return state._replace(
            errors=errors,
            barrier=barrier,
            filter=jnp.where(fell, jnp.inf, state.filter),
            filtered=jnp.where(fell, 0, state.filtered),
        )

    def step(self, state: State, slopes: Derivatives, given: Given) -> State:
        """One iteration from a state that was measured, with its derivatives."""
        values = self.scaled(state.values, state.scales)
        state = state._replace(rows=jnp.where(self.exists, state.rows, 1.0))
        slack, w, barrier = state.slack, state.rows, state.barrier
        inequality, equality = self.inequality, self.equality
        weights = self.weights(slack, w)
        stages, factors = self._inertia(slopes, weights, state)
        shift = jnp.where(inequality, slack + barrier / w, jnp.where(equality, _EQUALITY * w, 0.0))

        def computed(defects: jax.Array, rows: jax.Array) -> _Direction:
            found = refined(stages, factors, defects, self.split(rows + shift))
            moved = self.join(along_rows(slopes, found.step))
            d_slack = jnp.where(inequality, -(rows + slack) - moved, 0.0)
            d_rows = self.join(found.rows) - w
            near = jnp.maximum(_BOUNDARY, 1.0 - barrier)
            inner, end = of_stages(found.step)
            tilt = (slopes.gradient * inner).sum() + (slopes.end_gradient * end).sum()
            return _Direction(
                found.step,
                d_slack,
                found.dynamics - state.dynamics,
                d_rows,
                jnp.minimum(_to_boundary(slack, d_slack, inequality, near), self.in_chart(found.step, state)),
                _to_boundary(w, d_rows, inequality, near),
                tilt - barrier * jnp.where(inequality, d_slack / slack, 0.0).sum(),
            )

        direction = jax.jit(computed)  # traced once

        search = self._search(state, given, values, direction)
        found, done, first = search.found, search.done, search.first
        share = jnp.where(search.corrections > 0, first.primal, search.share)
        rows = jnp.where(inequality, w + first.dual * first.rows, w + share * first.rows)
        central = barrier / found.slack
        rows = jnp.where(inequality, jnp.clip(rows, central / _CENTRAL, central * _CENTRAL), rows)
        remember = done & ~search.by_phi
        here = remember & (np.arange(FILTER) == (state.filtered & (FILTER - 1)))
        kept = jnp.where(here, search.entry[:, None], state.filter)
        return state._replace(
            point=found.point,
            values=found.values,
            slack=found.slack,
            dynamics=jnp.where(done, state.dynamics + share * first.dynamics, state.dynamics),
            rows=jnp.where(done & self.exists, rows, jnp.where(self.exists, w, 0.0)),
            damping=jnp.where(stages.damping > 0.0, stages.damping, state.damping),
            raised=stages.damping,
            filter=kept,
            filtered=jnp.where(remember, state.filtered + 1, state.filtered),
            share=jnp.where(done, search.share, 0.0),
            stuck=~done,
        )

    # ---- the line search ----------------------------------------------------------------------------------------

    def _search(
        self, state: State, given: Given, values: Values, direction: Callable[[jax.Array, jax.Array], _Direction]
    ) -> _Search:
        """Shorten the step, or correct it to second order, until the filter takes it."""
        slack, barrier, scales, inequality = state.slack, state.barrier, state.scales, self.inequality
        theta, phi = self.theta(values, slack), self.phi(values, slack, barrier)
        least, most = 1e-4 * jnp.maximum(1.0, state.first), 1e4 * jnp.maximum(1.0, state.first)
        noise = 10.0 * jnp.finfo(phi.dtype).eps * jnp.abs(phi)
        own_slack = jnp.where(inequality, slack, 0.0)

        def trial(share: jax.Array, way: _Direction) -> _Trial:
            point = self.move(state.point, in_units(way.step, scales, share))
            raw = self.values(point, given)
            found = self.scaled(raw, scales)
            # A slack that is smaller than its row allows costs barrier and gains nothing.
            moved = jnp.where(inequality, jnp.maximum(slack + share * way.slack, -found.rows), 1.0)
            return _Trial(point, raw, moved, self.theta(found, moved), self.phi(found, moved, barrier))

        def accepted(own: _Trial, share: jax.Array, tilt: jax.Array) -> tuple[jax.Array, jax.Array]:
            """Whether the trial is accepted, and whether it is for the fall of the barrier function: (18) to (20)."""
            known = ((own.theta >= state.filter[0]) & (own.phi >= state.filter[1])).any() | (own.theta > most)
            fall = jnp.maximum(-tilt, 0.0)
            by_phi = (fall > 0.0) & (share * fall**_PHI_POWER > theta**_THETA_POWER) & (theta <= least)
            armijo = own.phi <= phi + _ARMIJO * share * tilt + noise
            either = (own.theta <= (1.0 - _THETA_GAIN) * theta) | (own.phi <= phi - _PHI_GAIN * theta)
            finite = jnp.isfinite(own.theta + own.phi)
            return finite & ~known & jnp.where(by_phi, armijo, either), by_phi & armijo

        def shortest(tilt: jax.Array) -> jax.Array:
            """The share below which no step is tried (23)."""
            fall = jnp.maximum(-tilt, 1e-300)
            small = jnp.minimum(_THETA_GAIN, _PHI_GAIN * theta / fall)
            small = jnp.where(theta <= least, jnp.minimum(small, theta**_THETA_POWER / fall**_PHI_POWER), small)
            return jnp.maximum(_LEAST_SHARE * jnp.where(tilt < 0.0, small, _THETA_GAIN), 1e-14)

        def advance(search: _Search) -> _Search:
            way = jax.lax.cond(search.pending, lambda: direction(search.defects, search.rows), lambda: search.way)
            begins = search.pending & (search.corrections == 0)
            first = jax.tree.map(lambda a, b: jnp.where(begins, a, b), way, search.first)
            share = jnp.where(search.pending, way.primal, search.share)
            own = trial(share, way)
            good, by_phi = accepted(own, share, first.tilt)
            # A correction solves the same equations for what the trial leaves.
            gains = jnp.where(search.corrections > 0, own.theta <= _CORRECTION_SHARE * search.theta, own.theta >= theta)
            again = ~good & search.pending & gains & (search.corrections < _CORRECTIONS) & jnp.isfinite(own.theta)
            left = self.scaled(own.values, scales)
            residual = share * (search.rows + own_slack) + self.violation(left, own.slack)
            back = search.pending & (search.corrections > 0)
            way = jax.tree.map(lambda a, b: jnp.where(back & ~good & ~again, a, b), first, way)
            shorter = 0.5 * jnp.where(back, first.primal, share)
            return _Search(
                share=jnp.where(good, share, shorter),
                way=way,
                first=first,
                defects=jnp.where(again, share * search.defects + left.defects, search.defects),
                rows=jnp.where(again, residual - own_slack, search.rows),
                pending=again,
                corrections=jnp.where(again, search.corrections + 1, jnp.where(good, search.corrections, 0)),
                theta=own.theta,
                found=jax.tree.map(lambda a, b: jnp.where(good, a, b), own, search.found),
                done=good,
                by_phi=by_phi,
                entry=search.entry,
            )

        zero, no = jnp.zeros_like(theta), jnp.zeros((), bool)
        none = jax.tree.map(jnp.zeros_like, jax.eval_shape(direction, values.defects, values.rows))
        begin = _Search(
            share=zero + 1.0,
            way=none,
            first=none,
            defects=values.defects,
            rows=values.rows,
            pending=~no,
            corrections=jnp.zeros((), int),
            theta=theta,
            found=_Trial(state.point, state.values, slack, theta, phi),
            done=no,
            by_phi=no,
            entry=jnp.stack([(1.0 - _THETA_GAIN) * theta, phi - _PHI_GAIN * theta]),
        )
        going = lambda s: ~s.done & (s.pending | (s.share >= shortest(s.first.tilt)))  # noqa: E731
        return jax.lax.while_loop(going, advance, begin)

    # ---- the equations ------------------------------------------------------------------------------------------

    def weights(self, slack: jax.Array, rows: jax.Array) -> Rows:
        """By how much the multiplier of a row grows with it, all scaled."""
        grown = jnp.where(self.inequality, rows / slack, 0.0)
        return self.split(jnp.where(self.equality, 1.0 / _EQUALITY, grown))

    def _inertia(self, slopes: Derivatives, weights: Rows, state: State) -> tuple[Stages, Any]:
        """Factors of the equations with as little added to the diagonal as gives them the inertia of a minimum."""
        last = state.damping

        def stages(damping: jax.Array) -> Stages:
            return Stages(slopes, weights, damping, None, self.free_start)

        def more(carry: tuple[jax.Array, Any, Any]) -> tuple[jax.Array, Any, Any]:
            damping, _, tries = carry
            start = jnp.where(last > 0.0, jnp.maximum(_LEAST_DAMPING, _SLOW * last), _FIRST_DAMPING)
            grow = jnp.where(last > 0.0, _FAST, _FASTER)
            damping = jnp.where(tries == 0, 0.0, jnp.where(tries == 1, start, grow * damping))
            return damping, factors(damping), tries + 1

        factors = jax.jit(lambda damping: factorize(stages(damping)))  # traced once
        zero = jnp.zeros_like(last)
        none = jax.tree.map(jnp.zeros_like, jax.eval_shape(factors, zero))
        wrong = lambda c: ~c[1].exist & (c[0] < _MOST_DAMPING)  # noqa: E731
        damping, found, _ = jax.lax.while_loop(wrong, more, (zero, none, jnp.zeros((), int)))
        return stages(damping), found

    def in_chart(self, step: Step, state: Any, change: float = _LARGEST_CHANGE) -> jax.Array:
        """The largest share of a step that keeps turns, changes of controls, durations and parameters small enough.

        Args:
            change: the largest of a duration, relative.
        """
        scales = state.scales
        turn = jnp.where(self._shooting.turns, jnp.abs(step.d * scales.d), 0.0).max(initial=0.0) / _LARGEST_TURN
        border, move = state.point.border, step.border * scales.border
        size = jnp.abs(border)
        is_time = jnp.arange(len(size)) < self._shooting.border.phases
        # What is large in its scale keeps its sign.
        shrinks = (border * move < 0.0) & (size > scales.border)
        most = jnp.where(shrinks, _LARGEST_FALL * size, _LARGEST_GROWTH * jnp.maximum(size, scales.border))
        most = jnp.where(is_time, change * size, most)
        us = _FARTHEST * self._shooting.along(jnp.maximum(jnp.abs(state.point.us), scales.u))
        far = (jnp.abs(step.u * scales.u) / us).max(initial=0.0)
        return 1.0 / jnp.stack([jnp.ones_like(turn), turn, far, (jnp.abs(move) / most).max()]).max()


def in_units(step: Step, scales: Scales, share: jax.Array) -> Step:
    """A share of a step in the problem's units."""
    return Step(share * step.d * scales.d, share * step.u * scales.u, share * step.border * scales.border)


def largest(parts: Any) -> jax.Array:
    return jnp.stack([jnp.abs(a).max(initial=0.0) for a in jax.tree.leaves(parts)]).max()


def _kept(exists: jax.Array, slopes: jax.Array) -> jax.Array:
    """Slopes, zero where rows that are only checked have none."""
    return jnp.where(exists | jnp.isfinite(slopes), slopes, 0.0)


def _to_boundary(values: jax.Array, moves: jax.Array, which: Any, near: jax.Array) -> jax.Array:
    """The largest share of moves, 1 at most, that leaves positive values positive."""
    falls = which & (moves < 0.0)
    return jnp.minimum(1.0, jnp.where(falls, -near * values / jnp.where(falls, moves, -1.0), 1.0).min(initial=1.0))
