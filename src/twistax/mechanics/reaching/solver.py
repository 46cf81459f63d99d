"""Damped least squares within joint limits, from successive seeds until one reaches the target.

A step minimises $|e - J d|^2 + mu |d|^2$ over the degrees of freedom that are not blocked by a limit,

    d = D J^T (J D J^T + mu 1)^-1 e,

where D is a diagonal matrix of zeros and ones, and is clipped to the limits. It is accepted if |e| decreases; otherwise
mu is increased. The search from a seed ends at a minimum, where the part of J^T e that limits do not block vanishes.

This step neglects the second derivatives of e. Where the target is out of reach, e stays large and so do they, and the
steps converge slowly. After some steps from a seed, the step is therefore that of a quasi-Newton method,

    d = (J^T J + S + mu 1)^-1 J^T e,

with an approximation S of the sum of e_i times the second derivatives of e_i, from the changes of J by the secant
formula of Dennis, Gay and Welsch. It converges superlinearly.

If limits block a degree of freedom at the first minimum, it moves to the middle of its range, and the search goes on
from there: of 10,000 poses within the limits of a Panda, 8 seeds then miss 8 in place of 36.

Sources: K. Levenberg, Quarterly of Applied Mathematics 2 (1944); T. Sugihara, IEEE Transactions on Robotics 27 (2011),
for damping proportional to |e|^2; C. Kanzow and others, J. of Computational and Applied Mathematics 172 (2004), for
projected steps; J. Dennis, D. Gay, R. Welsch, An adaptive nonlinear least-squares algorithm, ACM Transactions on
Mathematical Software 7 (1981), for S; B. Siciliano, J.-J. Slotine, A general framework for managing multiple tasks in
highly redundant robotic systems, ICAR (1991), for secondary tasks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...expr import Solve, State
from ...system.lower import lower
from ..tasks.configuration_space import Arrays
from ..tasks.rows import dtype_of
from .errors import ReachErrors


@dataclasses.dataclass(frozen=True)
class SearchOptions:
    """Numeric options of the search.

    Attributes:
        iterations: the largest number from one seed, and for the secondary tasks.
        flat: the fraction of |J|_F |e| below which the gradient of |e| counts as zero: the search is at a minimum.
        neglecting: the number of first steps from a seed that neglect second derivatives.
        damping: damping of the first step, as a fraction of |e|^2.
        grow, shrink: factors of the damping after a rejected and after an accepted step.
        least, most: bounds of the damping as a fraction of |e|^2; above the upper one the search from a seed ends.
    """

    iterations: int
    flat: float = 1e-4
    neglecting: int = 15
    damping: float = 1e-1
    grow: float = 5.0
    shrink: float = 0.2
    least: float = 1e-6
    most: float = 1e6

    def flat_in(self, dtype: Any) -> float:
        """`flat`, or in low precision the slope at which a step changes |e|^2 by less than its rounding."""
        return max(self.flat, 2.0 * float(np.finfo(dtype).eps) ** 0.5)


class SearchEnd(NamedTuple):
    """The best positions of all seeds for one target, with the residuals r and J there."""

    x: Arrays
    r: jax.Array
    J: jax.Array
    minima: jax.Array  # () number of seeds that led to a minimum
    seeds: jax.Array  # () number of seeds that were tried


class ReachState(NamedTuple):
    """The search for one target, between two steps. If it is over, x are the best positions."""

    x: Arrays
    r: jax.Array  # the residuals of `ReachErrors` at x
    J: jax.Array
    curvature: jax.Array | None  # (n, n) S; None: it is neglected
    reached: jax.Array
    damping: jax.Array
    step: jax.Array  # from this seed; the start is step 0
    seed: jax.Array
    turned: jax.Array  # whether degrees of freedom at their limits were moved to the middle, for this seed
    minima: jax.Array
    best: Arrays
    least: jax.Array


def _count(seeds: Arrays) -> int:
    count: int = next(iter(seeds.values())).shape[0]
    return count


class SeededSearch:
    """The search for one target, by the errors of its frames.

    It consists of two loops, because the members of a batch take the steps of a loop together: those that need second
    derivatives go on in the second one. Both evaluate the errors at one place, at most once in an iteration: they are
    most of the code of their kernels.
    """

    def __init__(self, errors: ReachErrors, options: SearchOptions) -> None:
        self._errors, self._options = errors, options
        self._solves: dict[int, Any] = {}

    def first_steps(self, targets: Arrays, seeds: Arrays, numbers: Arrays) -> ReachState:
        """The search for a target from seeds (count, ...), until it is over or needs second derivatives.

        Args:
            numbers: those of `ReachErrors`, and the tolerances.
        """
        start = {name: value[0] for name, value in seeds.items()}
        dtype, m, n = dtype_of(start), self._errors.size, self._errors.space.mechanism.dofs
        # As after the last step from a seed before the first one: the first iteration starts from the first seed.
        s = ReachState(
            x=start,
            r=jnp.ones(m, dtype),
            J=jnp.zeros((m, n), dtype),
            curvature=None,
            reached=jnp.asarray(False),
            damping=jnp.asarray(self._options.damping, dtype),
            step=jnp.int32(self._options.iterations),
            seed=jnp.int32(-1),
            turned=jnp.asarray(True),
            minima=jnp.int32(0),
            best=start,
            least=jnp.asarray(np.inf, dtype),
        )
        more = lambda s: (s.seed < 0) | (s.step < self._options.neglecting)  # noqa: E731
        return self._searched(s, targets, seeds, numbers, more)

    def remaining_steps(self, s: ReachState, targets: Arrays, seeds: Arrays, numbers: Arrays) -> SearchEnd:
        """The best positions for a target, by the rest of a search."""
        n = self._errors.space.mechanism.dofs
        s = s._replace(curvature=jnp.zeros((n, n), s.least.dtype))
        s = self._searched(s, targets, seeds, numbers, lambda s: s.seed < _count(seeds))
        best = self._improved(s, targets, numbers) if self._errors.has_secondary else (s.x, s.r, s.J)
        return SearchEnd(*best, s.minima, jnp.minimum(s.seed + 1, _count(seeds)))

    def needs_more(self, s: ReachState, seeds: Arrays) -> jax.Array:
        """Whether a search is not over after its first steps."""
        return ~s.reached & (s.seed < _count(seeds))

    def _searched(
        self,
        s: ReachState,
        targets: Arrays,
        seeds: Arrays,
        numbers: Arrays,
        more: Callable[[ReachState], jax.Array],
    ) -> ReachState:
        state: ReachState = jax.lax.while_loop(
            lambda s: self.needs_more(s, seeds) & more(s), lambda s: self._next(s, targets, seeds, numbers), s
        )
        return state

    def least_squares(self, J: jax.Array, e: jax.Array, mu: Any) -> jax.Array:
        """The minimum of $|e - J d|^2 + mu |d|^2$, by the smaller of two equivalent linear systems."""
        rows, n = J.shape
        if rows <= n:
            return J.T @ self._solve(J @ J.T + mu * np.eye(rows, dtype=e.dtype), e)
        return self._solve(J.T @ J + mu * np.eye(n, dtype=e.dtype), J.T @ e)

    def reached(self, e: jax.Array, numbers: Arrays) -> jax.Array:
        """Whether every position, every rotation, every task and every constraint is within its tolerance."""
        turn = numbers["angle_tolerance"] * numbers["length"]
        within = [
            jnp.sum(e[block] ** 2) <= (turn if is_turn else numbers["position_tolerance"]) ** 2
            for block, is_turn in zip(self._errors.blocks, self._errors.turns, strict=True)
        ]
        return jnp.all(jnp.stack(within))

    def _solve(self, G: jax.Array, e: jax.Array) -> jax.Array:
        size = len(e)
        if size not in self._solves:
            self._solves[size] = lower(Solve(State("G", (size, size)), State("e", (size,))))
        solution: jax.Array = self._solves[size](0.0, {"G": G, "e": e})
        return solution

    def _next(self, s: ReachState, targets: Arrays, seeds: Arrays, numbers: Arrays) -> ReachState:
        """One step, the start from the next seed, or the return to the best positions after the last one."""
        options, count = self._options, _count(seeds)
        e, J = self._errors.active(s.r, s.J)
        free, share = self.steepness(s.x, e, J)
        minimum = share <= options.flat_in(share.dtype)
        over = minimum | (s.damping > options.most)
        turns = over & ~s.turned & ~jnp.all(free) & (s.step < options.iterations)
        ended = ~turns & (over | (s.step >= options.iterations))
        restarted = turns | ended
        seed = s.seed + ended.astype(jnp.int32)
        d = jnp.where(turns, self._errors.space.to_middle(s.x, ~free), self._step(s, e, J, free))
        stepped = self._errors.space.moved(s.x, d)
        fresh = {name: value[jnp.minimum(seed, count - 1)] for name, value in seeds.items()}
        fresh = {name: jnp.where(seed < count, value, s.best[name]) for name, value in fresh.items()}
        trial = {name: jnp.where(ended, fresh[name], value) for name, value in stepped.items()}
        residuals, slopes = self._errors(trial, targets, numbers)
        new_e, new_J = self._errors.active(residuals, slopes)
        before, after = jnp.sum(e * e), jnp.sum(new_e * new_e)
        kept = restarted | (after < before)
        reached = kept & self.reached(new_e, numbers)
        damping = jnp.where(kept, jnp.maximum(s.damping * options.shrink, options.least), s.damping * options.grow)
        better = (after < s.least) | reached
        S = s.curvature
        if S is not None:
            S = jax.lax.cond(
                kept & ~restarted & (s.step >= options.neglecting),
                lambda S: self._curvature(S, s.x, d, (e, J), (new_e, new_J)),
                lambda S: jnp.where(restarted, jnp.zeros_like(S), S),
                S,
            )
        return ReachState(
            x={name: jnp.where(kept, value, s.x[name]) for name, value in trial.items()},
            r=jnp.where(kept, residuals, s.r),
            J=jnp.where(kept, slopes, s.J),
            curvature=S,
            reached=reached,
            damping=jnp.where(restarted, options.damping, damping).astype(e.dtype),
            step=jnp.where(ended, 0, s.step + 1),
            seed=seed,
            turned=~ended & (s.turned | turns),
            minima=s.minima + (minimum & restarted & ~s.turned).astype(jnp.int32),
            best={name: jnp.where(better, value, s.best[name]) for name, value in trial.items()},
            least=jnp.where(better, after, s.least),
        )

    def _step(self, s: ReachState, e: jax.Array, J: jax.Array, free: jax.Array) -> jax.Array:
        mu = s.damping * jnp.sum(e * e) + np.finfo(e.dtype).eps * jnp.sum(J * J)
        first = lambda: self.least_squares(jnp.where(free[None], J, 0.0), e, mu)  # noqa: E731
        if s.curvature is None:
            return first()
        H = J.T @ J + s.curvature + mu * np.eye(len(free), dtype=e.dtype)
        later = lambda: self._newton_step(s.x, H, J.T @ e, free)  # noqa: E731
        return jax.lax.cond(s.step >= self._options.neglecting, later, first)

    def _newton_step(self, x: Arrays, H: jax.Array, slope: jax.Array, free: jax.Array) -> jax.Array:
        """The step with second derivatives. Degrees of freedom that would leave their limits end at them, and the step
        of the others is computed again.
        """
        unit = np.eye(len(free), dtype=slope.dtype)
        above, below = self._errors.space.margins(x, slope.dtype)

        def solved(free: jax.Array, fixed: jax.Array) -> jax.Array:
            open_H = jnp.where(free[:, None] & free[None], H, unit)
            return jnp.where(free, self._solve(open_H, jnp.where(free, slope - H @ fixed, 0.0)), fixed)

        d = solved(free, jnp.zeros_like(slope))
        outside = (d < -above) | (d > below)
        end = jnp.where(outside, jnp.clip(d, -above, below), 0.0)
        return jax.lax.cond(jnp.any(outside), lambda: solved(free & ~outside, end), lambda: d)

    def _curvature(
        self, S: jax.Array, x: Arrays, d: jax.Array, start: tuple[jax.Array, ...], end: tuple[jax.Array, ...]
    ) -> jax.Array:
        """The approximation S after an accepted step d between points with e and J. It agrees with their change along
        the step: $S d = (J_0 - J)^T e$.
        """
        (e0, J0), (e, J) = start, end
        above, below = self._errors.space.margins(x, e.dtype)
        d = jnp.clip(d, -above, below)
        change, second = J0.T @ e0 - J.T @ e, (J0 - J).T @ e
        before = S @ d
        size = jnp.abs(d @ second) / jnp.maximum(jnp.abs(d @ before), np.finfo(e.dtype).tiny)
        size = jnp.minimum(size, 1.0)
        convex = d @ change > np.finfo(e.dtype).eps * jnp.sum(d * d)
        y = jnp.where(convex, change / jnp.where(convex, d @ change, 1.0), 0.0)
        missing = second - size * before
        update = missing[:, None] * y[None] + y[:, None] * missing[None] - (missing @ d) * (y[:, None] * y[None])
        return size * S + update

    def steepness(self, x: Arrays, e: jax.Array, J: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The degrees of freedom that may follow the gradient of |e|^2, and the gradient's length as a fraction of |J|
        |e|.
        """
        slope = J.T @ e
        free = self._errors.space.free(x, slope)
        size = jnp.maximum(jnp.sum(J * J) * jnp.sum(e * e), np.finfo(e.dtype).tiny)
        return free, jnp.sqrt(jnp.sum(jnp.where(free, slope, 0.0) ** 2) / size)

    # ---- secondary tasks ---------------------------------------------------------------------------------------------

    def _improved(self, s: ReachState, targets: Arrays, numbers: Arrays) -> tuple[Arrays, jax.Array, jax.Array]:
        """Positions at which secondary tasks have a smaller error, with r and J there, starting from the end of a
        search; the end if the target is not reached.

        A step minimises $|e_2 - J_2 d|^2 + mu |d|^2$ with $J d = 0$; the shortest step to e = 0 follows. Both are
        accepted if |e_2| decreases and the target is reached.
        """
        options, space, dtype = self._options, self._errors.space, s.least.dtype
        active, eps, unit = self._errors.active, np.finfo(dtype).eps, np.eye(space.mechanism.dofs, dtype=dtype)

        def step(carry: Any) -> Any:
            k, x, damping, r, J, e2, J2 = carry
            _, J = active(r, J)
            free = space.free(x, self._along(J, J2.T @ e2))
            J, J2 = (jnp.where(free[None], rows, 0.0) for rows in (J, J2))
            slope, before, size = J2.T @ e2, jnp.sum(e2 * e2), jnp.sum(J2 * J2)
            mu = damping * before + eps * jnp.where(size > 0.0, size, 1.0)
            # The large weight of J d leaves the directions with J d = 0, up to a part that is then removed.
            weight = (size + mu) / (np.sqrt(eps) * jnp.maximum(jnp.sum(J * J), np.finfo(dtype).tiny))
            d = self._along(J, self._solve(J2.T @ J2 + weight * (J.T @ J) + mu * unit, slope))
            trial = space.moved(x, d)
            off, J_off = active(*self._errors(trial, targets, numbers))
            trial = space.moved(trial, self._shortest(jnp.where(free[None], J_off, 0.0), off))
            now, after = self._errors(trial, targets, numbers), self._errors.secondary(trial, numbers)
            predicted, decrease = 2.0 * slope @ d - jnp.sum((J2 @ d) ** 2), before - jnp.sum(after[0] ** 2)
            kept = self.reached(active(*now)[0], numbers) & (decrease > 0.0)
            # Of a large error the second derivatives count: the decrease shows them.
            shorter, longer = ~kept | (decrease < 0.25 * predicted), decrease > 0.75 * predicted
            damping = damping * jnp.where(shorter, options.grow, jnp.where(longer, options.shrink, 1.0))
            over = (predicted <= eps ** (2.0 / 3.0) * before) | (damping > options.most)
            damping = jnp.maximum(damping, options.least)
            x = {name: jnp.where(kept, trial[name], value) for name, value in x.items()}
            rest = (jnp.where(kept, *pair) for pair in zip((*now, *after), carry[3:], strict=True))
            return jnp.where(over, options.iterations, k + 1), x, damping.astype(dtype), *rest

        begin, damping = jnp.where(s.reached, 0, options.iterations), jnp.asarray(options.damping, dtype)
        start = (begin, s.x, damping, s.r, s.J, *self._errors.secondary(s.x, numbers))
        _, x, _, r, J, *_ = jax.lax.while_loop(lambda carry: carry[0] < options.iterations, step, start)
        return x, r, J

    def _shortest(self, J: jax.Array, e: jax.Array) -> jax.Array:
        """The shortest step d with J d = e, in the sense of least squares."""
        size = jnp.sum(J * J)
        return self.least_squares(J, e, jnp.where(size > 0.0, np.finfo(e.dtype).eps * size, 1.0))

    def _along(self, J: jax.Array, d: jax.Array) -> jax.Array:
        """The part of a step along which e does not change."""
        return d - self._shortest(J, J @ d)
