"""Damped least squares within limits, from seed to seed until one reaches the target: one loop for one target.

A step minimises $|e - J d|^2 + mu |d|^2$ over the freedoms that no limit stops,

    d = D J^T (J D J^T + mu 1)^-1 e,

D a diagonal of zeros and ones, and is cut at the limits. It is kept if |e| becomes smaller; mu grows where it does not.
A seed ends at a minimum: where the part of J^T e that limits do not stop vanishes.

Source: K. Levenberg, Quarterly of Applied Mathematics 2 (1944); T. Sugihara, IEEE Transactions on Robotics 27 (2011),
for a damping in proportion to |e|^2; C. Kanzow and others, J. of Computational and Applied Mathematics 172 (2004), for
steps that are projected.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...expr import Solve, State
from ...system.lower import lower
from .tasks import Arrays, Tasks


@dataclasses.dataclass(frozen=True)
class SearchOptions:
    """Numbers of the loop.

    Attributes:
        position_tolerance: m; angle_tolerance: rad; of each frame.
        iterations: of one seed, at most.
        flat: the share of |J|_F |e| below which the slope of |e| is zero: the seed is at a minimum.
        damping: of the first step, as a share of |e|^2.
        grow, shrink: factors of the damping after a step that is refused, and one that is kept.
        least, most: bounds of the damping as a share of |e|^2; beyond the upper one the seed is at a minimum.
    """

    position_tolerance: float
    angle_tolerance: float
    iterations: int
    flat: float = 1e-4
    damping: float = 1e-1
    grow: float = 5.0
    shrink: float = 0.2
    least: float = 1e-6
    most: float = 1e6


class SearchEnd(NamedTuple):
    """The best positions of all seeds for one target."""

    x: Arrays
    error: jax.Array  # (m,)
    free: jax.Array  # (n,)
    slope: jax.Array  # () share of |J|_F |e|
    minima: jax.Array  # () seeds that ended at a minimum
    seeds: jax.Array  # () seeds that were tried
    steps: jax.Array  # ()


class SearchState(NamedTuple):
    x: Arrays
    e: jax.Array
    J: jax.Array
    damping: jax.Array
    step: jax.Array
    seed: jax.Array
    steps: jax.Array
    minima: jax.Array
    best: Arrays
    least: jax.Array


class SeededSearch:
    """The search for one target, of the errors of its frames.

    Attributes:
        solve: (G, e) -> G^-1 e.
    """

    def __init__(self, tasks: Tasks, options: SearchOptions) -> None:
        self._tasks, self._options = tasks, options
        rows = len(tasks.ends)
        solved = lower(Solve(State("G", (rows, rows)), State("e", (rows,))))
        self.solve = lambda G, e: solved(0.0, {"G": G, "e": e})

    def one(self, targets: Arrays, seeds: Arrays) -> SearchEnd:
        """The best positions for targets, from seeds (count, ...)."""
        count = next(iter(seeds.values())).shape[0]
        start = {name: value[0] for name, value in seeds.items()}
        e, J = self._tasks.errors(start, targets)
        zero, damping = jnp.zeros((), dtype=jnp.int32), jnp.asarray(self._options.damping, e.dtype)
        last = jax.lax.while_loop(
            lambda s: (s.seed < count) & ~self._reached(s.e),
            lambda s: self._next(s, targets, seeds, count),
            SearchState(start, e, J, damping, zero, zero, zero, zero, start, jnp.sum(e * e)),
        )
        e, J = self._tasks.errors(last.best, targets)
        free, share = self._steepness(last.best, e, J)
        return SearchEnd(last.best, e, free, share, last.minima, jnp.minimum(last.seed + 1, count), last.steps)

    def _next(self, s: SearchState, targets: Arrays, seeds: Arrays, count: int) -> SearchState:
        """One step, or the next seed."""
        options = self._options
        free, share = self._steepness(s.x, s.e, s.J)
        minimum = (share <= options.flat) | (s.damping > options.most)
        ended = minimum | (s.step >= options.iterations)
        seed = s.seed + ended.astype(jnp.int32)
        fresh = {name: value[jnp.minimum(seed, count - 1)] for name, value in seeds.items()}
        trial = {name: jnp.where(ended, fresh[name], value) for name, value in self._stepped(s, free).items()}
        e, J = self._tasks.errors(trial, targets)
        before, after = jnp.sum(s.e * s.e), jnp.sum(e * e)
        kept = ended | (after < before)
        damping = jnp.where(kept, jnp.maximum(s.damping * options.shrink, options.least), s.damping * options.grow)
        better = after < s.least
        return SearchState(
            x={name: jnp.where(kept, value, s.x[name]) for name, value in trial.items()},
            e=jnp.where(kept, e, s.e),
            J=jnp.where(kept, J, s.J),
            damping=jnp.where(ended, options.damping, damping).astype(e.dtype),
            step=jnp.where(ended, 0, s.step + 1),
            seed=seed,
            steps=s.steps + 1,
            minima=s.minima + minimum.astype(jnp.int32),
            best={name: jnp.where(better, value, s.best[name]) for name, value in trial.items()},
            least=jnp.where(better, after, s.least),
        )

    def _stepped(self, s: SearchState, free: jax.Array) -> Arrays:
        open_J = jnp.where(free[None], s.J, 0.0)
        mu = s.damping * jnp.sum(s.e * s.e) + np.finfo(s.e.dtype).eps * jnp.sum(s.J * s.J)
        G = open_J @ open_J.T + mu * np.eye(len(s.e), dtype=s.e.dtype)
        return self._tasks.moved(s.x, open_J.T @ self.solve(G, s.e))

    def _reached(self, e: jax.Array) -> jax.Array:
        """Whether every position and every turn is within its tolerance."""
        turn = self._options.angle_tolerance * self._tasks.length
        within = [
            jnp.sum(e[i : i + 3] ** 2) <= (self._options.position_tolerance if self._tasks.ends[i] else turn) ** 2
            for i in range(0, len(self._tasks.ends), 3)
        ]
        return jnp.all(jnp.stack(within))

    def _steepness(self, x: Arrays, e: jax.Array, J: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The freedoms that may follow the slope of |e|^2, and its length as a share of |J| |e|."""
        slope = J.T @ e
        free = self._tasks.free(x, slope)
        size = jnp.maximum(jnp.sum(J * J) * jnp.sum(e * e), np.finfo(e.dtype).tiny)
        return free, jnp.sqrt(jnp.sum(jnp.where(free, slope, 0.0) ** 2) / size)
