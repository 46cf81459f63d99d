"""Restart points of a search: perturbed guesses, and random steps from a point at which the search stalled."""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from ..transcription.evaluation import Evaluated, moved
from ..transcription.iterate import Instance, Iterate, Step
from .core_solver import CoreSolver
from .outcome import Scales

#: Sizes of perturbations of states and controls; the largest ratios of defects to their sizes and to those of the
#: guess; and fractions of a perturbation that are tried.
_MOVES, _LARGEST_GAP, _SHARES = (0.4, 0.15), 30.0, tuple(0.5**k for k in range(11))


def perturbed(solver: CoreSolver, point: Iterate, instance: Instance, rng: np.random.Generator) -> Iterate:
    """A point after a random step in every free entry of states, controls and shared unknowns.

    The step is halved until the defects of the dynamics are finite and at most a few times those at the point. Without
    this limit, quantities that are exponential in a state, as air density is in altitude, make the start unusable.
    """
    staged, free, units = solver.staged, solver.transcribed.free, solver.units(point, instance, is_guess=True)
    z, scales = staged.flat(point), solver.measure.scales(units)
    d = np.where(solver.transcribed.perturbable, _MOVES[0] * rng.normal(size=free.d.shape) * scales.d, 0.0)
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
    solver: CoreSolver, point: Iterate, scales: Scales, size: float, seed: int, controls_alone: bool = False
) -> Iterate:
    """The point after a random step; of the controls only if requested and if there are controls."""
    rng, problem = np.random.default_rng(seed), solver.transcribed
    u = np.where(problem.free.u, size * rng.normal(size=problem.free.u.shape) * scales.u, 0.0)
    d = np.where(problem.perturbable, size * rng.normal(size=problem.free.d.shape) * scales.d, 0.0)
    if controls_alone and problem.free.u.any():
        d = np.zeros_like(d)
    return solver.moved(point, Step(d, u, np.zeros(problem.border.size)))
