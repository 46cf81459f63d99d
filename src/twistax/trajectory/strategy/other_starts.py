"""Other starts for a search: perturbed guesses, random steps from a point where it stalled, fixed durations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy import ndarray as Array

from ..transcription.border import Border
from ..transcription.evaluation import Evaluated, moved
from ..transcription.points import Given, Point, Step
from .core_solver import CoreSolver
from .outcome import Scales

#: Moves of states and controls in their sizes; how much larger than sizes, or than those of the guess, gaps may be, and
#: shares of a move to them.
_MOVES, _LARGEST_GAP, _SHARES = (0.4, 0.15), 30.0, tuple(0.5**k for k in range(11))
#: How many times as long as at the start, and how near to these durations a trajectory is to stay.
_FACTORS, _NEAR = (3.0, 9.0, 1.0), 0.01
#: Of the way up to its limit a duration goes no further than this.
_MOST = 0.9


def perturbed(solver: CoreSolver, point: Point, instance: Given, rng: np.random.Generator) -> Point:
    """A point with every free entry of states, controls and border moved by a random step.

    The step is halved until gaps of the dynamics there are finite and no more than a few times those at the point: what
    is exponential in a state, as air is in a height, else makes starts that mean nothing.
    """
    staged, free, units = solver.staged, solver.transcribed.free, solver.units(point, instance)
    z, scales = staged.flat(point), solver.measure.scales(units)
    d = np.where(solver.transcribed.stirred, _MOVES[0] * rng.normal(size=free.d.shape) * scales.d, 0.0)
    u = np.where(free.u, _MOVES[1] * rng.normal(size=free.u.shape) * scales.u, 0.0)
    here, (low, high) = np.asarray(point.border), np.asarray(instance.limits).T
    spread = np.minimum((high - low) / 6.0, _MOVES[0] * units.border)
    border = np.where(free.border, rng.normal(size=here.shape) * spread, 0.0)

    def gap(z: Array) -> float:
        gaps = np.abs(Evaluated(staged.transcription, z).c) / staged.after(units.v)
        return float(gaps.max(initial=0.0)) if np.isfinite(gaps).all() else np.inf

    most, end = _LARGEST_GAP * max(1.0, gap(z)), z
    for share in _SHARES:
        step = staged.step(share * d, share * u, np.clip(here + share * border, low, high) - here)
        end = moved(staged.transcription, z, step)
        if gap(end) <= most:
            break
    return staged.point(end)


def beside(
    solver: CoreSolver, point: Point, scales: Scales, size: float, seed: int, controls_alone: bool = False
) -> Point:
    """The point after a random step, of controls alone if it is to be so and where there are some."""
    rng, problem = np.random.default_rng(seed), solver.transcribed
    u = np.where(problem.free.u, size * rng.normal(size=problem.free.u.shape) * scales.u, 0.0)
    d = np.where(problem.stirred, size * rng.normal(size=problem.free.d.shape) * scales.d, 0.0)
    if controls_alone and problem.free.u.any():
        d = np.zeros_like(d)
    return solver.moved(point, Step(d, u, np.zeros(problem.border.size)))


def with_fixed_durations(border: Border, start: Point, instance: Given) -> Iterator[tuple[Point, Given]]:
    """Starts with other durations, and the problem with these as limits; nothing where no duration is free.

    While durations are free a step may shorten what it should steer: a mass that moves away from where it is to stop
    comes nearest at once. At a fixed duration that is long enough there is no such point of rest.
    """
    limits, begun = np.array(instance.limits), np.asarray(start.border)
    low, high = limits.T
    free = border.free & (np.arange(border.size) < border.phases) & (low < high)
    before = [begun]
    for factor in _FACTORS if free.any() else ():
        with np.errstate(invalid="ignore"):  # parameters may have no limits
            times = np.where(free, np.clip(factor * begun, low, low + _MOST * (high - low)), begun)
        if factor != 1.0 and any(np.allclose(times[free], earlier[free], rtol=0.1, atol=0.0) for earlier in before):
            continue
        before.append(times)
        near = np.stack([np.maximum(low, (1.0 - _NEAR) * times), np.minimum(high, (1.0 + _NEAR) * times)], axis=1)
        yield start._replace(border=times), instance._replace(limits=np.where(free[:, None], near, limits))
