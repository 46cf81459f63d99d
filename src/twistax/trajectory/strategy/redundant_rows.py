"""Redundant inequalities at a node: the equalities there determine them, so they have no interior."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..transcription.evaluation import Evaluated, moved
from ..transcription.iterate import Instance, Iterate
from ..transcription.staged import Staged
from ..transcription.staged_phase import StagedPhase

#: The number of random points, and the distance of their tangents from the start.
_SAMPLES, _MOVE = 2, 0.3


def redundant_rows(staged: Staged, start: Iterate, instance: Instance) -> list[Array]:
    """For each phase, the inequalities at nodes whose gradients are linear combinations of those of the equalities
    there.

    They are redundant if this holds at all samples, with these parameters and with perturbed ones, because the next
    solve may use others.
    """
    samples = list(_samples(staged, start, instance))
    return [_of_part(staged, number, samples) for number in range(len(staged.parts))]


def _samples(staged: Staged, start: Iterate, instance: Instance) -> Iterator[Evaluated]:
    """Derivatives at random points, with these parameters and with perturbed ones."""
    rng, free, z = np.random.default_rng(0), staged.transcribed.free, staged.flat(start)
    points = list[Array]()
    for _ in range(_SAMPLES):
        d = np.where(free.d, _MOVE * rng.normal(size=free.d.shape), 0.0)
        u, b = (_stirred(rng, np.asarray(a)) - a for a in (start.us, start.border))
        step = staged.step(d, np.where(free.u, u, 0.0), np.where(free.border, b, 0.0))
        points.append(moved(staged.transcription, z, step))
    changed = [jax.tree.map(lambda a, i=i: _stirred(np.random.default_rng(i), a), instance.params) for i in range(2)]
    for params in (instance.params, *changed):
        staged.set_instance(instance.with_params(params))
        for point in points:
            at = Evaluated(staged.transcription, point)
            if at.differentiate():
                yield at
    staged.set_instance(instance)


def _stirred(rng: np.random.Generator, values: Any) -> Array:
    """Numbers after random perturbations by at most a third of their size; zeros become nonzero."""
    here = np.asarray(values, float)
    return np.asarray(here + rng.uniform(0.1, 0.3, here.shape) * np.where(here == 0.0, 1.0, here))


def _of_part(staged: Staged, number: int, samples: Sequence[Evaluated]) -> Array:
    part = staged.parts[number]
    phase, layout, K = part.shooting, part.shooting.layout, part.shooting.intervals
    redundant = np.zeros(len(phase.exists), bool)
    first = np.array([place for place, _ in phase.start_rows()], int)
    places = _places(staged, number)
    for k in sorted({0, *layout.counts, K}):
        if k == K:
            rows = np.arange(K * layout.per_interval, len(phase.exists))
        else:
            at_node = len(layout.path_indices) + np.arange(layout.counts.get(k, 0))
            rows = k * layout.per_interval + np.concatenate([first, at_node])
        fixed = np.eye(phase.n)[~phase.free.d[0]] if k == 0 and number == 0 else np.zeros((0, phase.n))
        exists, equality = phase.exists[rows], phase.equality[rows]
        slopes = [_slopes(part, k, rows, places, at) for at in samples]
        redundant[rows] = _spanned(exists & equality, exists & ~equality, fixed, slopes)
    return redundant


def _places(staged: Staged, number: int) -> list[Array]:
    """For all rows of a phase, the index among the problem's inequalities and among its equalities; -1 for none."""
    stages, segment = staged.transcription.stages, staged.transcribed.segments[number]
    h, e, none = np.arange(sum(stages.inequalities)), np.arange(sum(stages.equalities)), np.zeros(stages.variables)
    both = (staged.all_rows(h + 1, 0 * e, none, none), staged.all_rows(0 * h, e + 1, none, none))
    return [staged.transcribed.rows_of(segment, rows).astype(int) - 1 for rows in both]


def _slopes(part: StagedPhase, k: int, rows: Array, places: Sequence[Array], at: Evaluated) -> Array:
    """Derivatives of the rows at a node with respect to the unknowns of its stage; zero for rows that do not exist."""
    stages, stage = at.stages, part.stages.start + k
    slopes = np.zeros((len(rows), stages.columns[stage]))
    for flat, counts, place in zip((at.Jh, at.Je), (stages.inequalities, stages.equalities), places):
        there = place[rows] >= 0
        slopes[there] = at.blocks(flat, counts)[stage][place[rows][there] - sum(counts[:stage])]
    n, inner, here = part.shooting.n, part.shooting.n + stages.controls[stage], np.isin(part.bounds.rows, rows)
    for row, column in zip(part.bounds.rows[here], part.bounds.columns[here]):
        # The columns of shared unknowns follow those of the controls, which the last node does not have.
        shared = column - n - part.shooting.m
        slopes[rows == row, column if shared < 0 else inner + shared] = 1.0
    return slopes


def _spanned(equality: Array, inequality: Array, fixed: Array, samples: Sequence[Array]) -> Array:
    """(rows,) the inequalities whose gradients lie in the span of those of the equalities and of the fixed unknowns.

    Args:
        equality, inequality: (rows,) the kind of each row that exists.
        fixed: (k, n) the tangents that do not move.
        samples: gradients of the rows, (rows, unknowns).
    """
    redundant = inequality.copy()
    if not (equality.any() or len(fixed)) or not redundant.any() or not samples:
        return np.zeros_like(redundant)
    seen = np.zeros_like(redundant)
    fixed = np.pad(fixed, ((0, 0), (0, samples[0].shape[1] - fixed.shape[1])))
    for slopes in samples:
        # At a random sample the gradient of a row may vanish; another sample decides.
        there = np.isfinite(slopes).all(axis=1)
        rows = np.where(there[:, None], slopes, 0.0)
        base, columns = np.concatenate([fixed, rows[equality]]).T, rows.T
        left = columns - base @ np.linalg.lstsq(base, columns, rcond=None)[0]
        size = np.linalg.norm(columns, axis=0)
        redundant &= ~there | ((size > 0.0) & (np.linalg.norm(left, axis=0) <= 1e-9 * size))
        seen |= there
    return redundant & seen
