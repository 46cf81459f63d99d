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
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...expr import Solve, State
from ...system.lower import lower
from .tasks import Arrays, Tasks


@dataclasses.dataclass(frozen=True)
class Options:
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


class Solution(NamedTuple):
    """The best positions of all seeds for one target."""

    x: Arrays
    error: jax.Array  # (m,)
    free: jax.Array  # (n,)
    slope: jax.Array  # () share of |J|_F |e|
    minima: jax.Array  # () seeds that ended at a minimum
    seeds: jax.Array  # () seeds that were tried
    steps: jax.Array  # ()


class _Search(NamedTuple):
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


def solver(tasks: Tasks, options: Options) -> Any:
    """The function (targets, seeds) -> Solution, of arrays of one target."""
    rows = len(tasks.ends)
    solve = lower(Solve(State("G", (rows, rows)), State("e", (rows,))))
    ends = tasks.ends

    def reached(e: jax.Array) -> jax.Array:
        groups = [slice(i, i + 3) for i in range(0, rows, 3)]
        within = [
            jnp.sum(e[at] ** 2)
            <= (options.position_tolerance if ends[at.start] else options.angle_tolerance * tasks.length) ** 2
            for at in groups
        ]
        return jnp.all(jnp.stack(within))

    def steepness(x: Arrays, e: jax.Array, J: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The freedoms that may follow the slope, and its length as a share of |J| |e|."""
        slope = J.T @ e
        free = tasks.free(x, slope)
        size = jnp.sum(J * J) * jnp.sum(e * e)
        return free, jnp.sqrt(jnp.sum(jnp.where(free, slope, 0.0) ** 2) / jnp.maximum(size, np.finfo(e.dtype).tiny))

    def stepped(s: _Search, free: jax.Array) -> Arrays:
        open_J = jnp.where(free[None], s.J, 0.0)
        mu = s.damping * jnp.sum(s.e * s.e) + np.finfo(s.e.dtype).eps * jnp.sum(s.J * s.J)
        G = open_J @ open_J.T + mu * np.eye(rows, dtype=s.e.dtype)
        return tasks.moved(s.x, open_J.T @ solve(0.0, {"G": G, "e": s.e}))

    def one(targets: Arrays, seeds: Arrays) -> Solution:
        count = next(iter(seeds.values())).shape[0]
        start = {name: value[0] for name, value in seeds.items()}
        e, J = tasks.errors(start, targets)
        zero = jnp.zeros((), dtype=jnp.int32)

        def going(s: _Search) -> jax.Array:
            return (s.seed < count) & ~reached(s.e)

        def body(s: _Search) -> _Search:
            free, share = steepness(s.x, s.e, s.J)
            minimum = (share <= options.flat) | (s.damping > options.most)
            ended = minimum | (s.step >= options.iterations)
            seed = s.seed + ended.astype(jnp.int32)
            fresh = {name: value[jnp.minimum(seed, count - 1)] for name, value in seeds.items()}
            trial = {name: jnp.where(ended, fresh[name], value) for name, value in stepped(s, free).items()}
            e, J = tasks.errors(trial, targets)
            before, after = jnp.sum(s.e * s.e), jnp.sum(e * e)
            kept = ended | (after < before)
            damping = jnp.where(kept, jnp.maximum(s.damping * options.shrink, options.least), s.damping * options.grow)
            better = after < s.least
            return _Search(
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

        first = _Search(
            start, e, J, jnp.asarray(options.damping, e.dtype), zero, zero, zero, zero, start, jnp.sum(e * e)
        )
        last = jax.lax.while_loop(going, body, first)
        e, J = tasks.errors(last.best, targets)
        free, share = steepness(last.best, e, J)
        return Solution(last.best, e, free, share, last.minima, jnp.minimum(last.seed + 1, count), last.steps)

    return one
