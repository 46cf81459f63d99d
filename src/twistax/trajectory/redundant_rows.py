"""Inequalities at a node that the equalities there decide: they leave no room for slacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from .evaluated import Evaluated, moved
from .staged import Part, Staged
from .transcribed import Given, Point

#: How many random points are looked at, and how far from the start their tangents are.
_SAMPLES, _MOVE = 2, 0.3


def redundant_rows(staged: Staged, start: Point, given: Given) -> list[Array]:
    """Of each phase which inequalities at nodes have slopes in the span of those of the equalities there.

    They count if it is so at all samples, with these parameters and with others: the next solve may have those.
    """
    samples = list(_samples(staged, start, given))
    return [_of_part(staged, number, samples) for number in range(len(staged.parts))]


def _samples(staged: Staged, start: Point, given: Given) -> Iterator[Evaluated]:
    """Derivatives at random points, with these parameters and with others."""
    rng, free, z = np.random.default_rng(0), staged.transcribed.free, staged.flat(start)
    points = []
    for _ in range(_SAMPLES):
        d = np.where(free.d, _MOVE * rng.normal(size=free.d.shape), 0.0)
        u, b = (_stirred(rng, np.asarray(a)) - a for a in (start.us, start.border))
        step = staged.step(d, np.where(free.u, u, 0.0), np.where(free.border, b, 0.0))
        points.append(moved(staged.transcription, z, step))
    others = [jax.tree.map(lambda a, i=i: _stirred(np.random.default_rng(i), a), given.params) for i in range(2)]
    for params in (given.params, *others):
        staged.set_given(given._replace(params=params))
        for point in points:
            at = Evaluated(staged.transcription, point)
            if at.differentiate():
                yield at
    staged.set_given(given)


def _stirred(rng: np.random.Generator, values: Any) -> Array:
    """Numbers changed at random, by a third of their size at most; zeros no longer are."""
    here = np.asarray(values, float)
    return np.asarray(here + rng.uniform(0.1, 0.3, here.shape) * np.where(here == 0.0, 1.0, here))


def _of_part(staged: Staged, number: int, samples: Sequence[Evaluated]) -> Array:
    part = staged.parts[number]
    own, layout, K = part.shooting, part.shooting.layout, part.shooting.intervals
    found = np.zeros(len(own.exists), bool)
    first = np.flatnonzero(layout.asked < len(own.path.names))
    for k in sorted({0, *layout.counts, K}):
        if k == K:
            rows = np.arange(K * layout.per_interval, len(own.exists))
        else:
            at_node = len(layout.asked) + np.arange(layout.counts.get(k, 0))
            rows = k * layout.per_interval + np.concatenate([first, at_node])
        held = np.eye(own.n)[~own.free.d[0]] if k == 0 and number == 0 else np.zeros((0, own.n))
        exists, equality = own.exists[rows], own.equality[rows]
        slopes = [_slopes(staged, number, k, rows, at) for at in samples]
        found[rows] = _spanned(exists & equality, exists & ~equality, held, slopes)
    return found


def _slopes(staged: Staged, number: int, k: int, rows: Array, at: Evaluated) -> Array:
    """Of rows at a node by the unknowns of its stage; zero for those that do not exist."""
    part, stages = staged.parts[number], at.stages
    stage = part.stages.start + k
    found = np.zeros((len(rows), stages.columns[stage]))
    for blocks, counts, numbers in zip(
        (at.blocks(at.Jh, stages.inequalities), at.blocks(at.Je, stages.equalities)),
        (stages.inequalities, stages.equalities),
        _numbers(staged, number, part),
    ):
        own = numbers[rows] - sum(counts[:stage])
        there = numbers[rows] >= 0
        found[there] = blocks[stage][own[there]]
    inner = part.shooting.n + stages.controls[stage]
    here = np.isin(part.bounds.rows, rows)
    for row, column in zip(part.bounds.rows[here], part.bounds.columns[here]):
        # What stands for the border comes after the controls, of which the last node has none.
        shared = column - part.shooting.n - part.shooting.m
        found[rows == row, column if shared < 0 else inner + shared] = 1.0
    return found


def _numbers(staged: Staged, number: int, part: Part) -> list[Array]:
    """Of all rows of a phase the number among the inequalities, and among the equalities, of the problem; else -1."""
    stages, places = staged.transcription.stages, staged.transcription
    own = (places.path_places[number], places.node_places[number])
    h, e = 1 + np.arange(sum(stages.inequalities)), 1 + np.arange(sum(stages.equalities))
    both = (part.rows(h, 0 * e, *own), part.rows(0 * h, e, *own))
    return [a.astype(int) - 1 for a in both]


def _spanned(equality: Array, inequality: Array, held: Array, samples: Sequence[Array]) -> Array:
    """(rows,) which inequalities have slopes in the span of those of the equalities and of what is held.

    Args:
        equality, inequality: (rows,) which they are, of those that exist.
        held: (k, n) tangents that do not move.
        samples: slopes of the rows, (rows, unknowns).
    """
    pinned = inequality.copy()
    if not (equality.any() or len(held)) or not pinned.any() or not samples:
        return np.zeros_like(pinned)
    seen = np.zeros_like(pinned)
    fixed = np.pad(held, ((0, 0), (0, samples[0].shape[1] - held.shape[1])))
    for slopes in samples:
        # A random sample may lie where a row has no slopes; others tell about it.
        there = np.isfinite(slopes).all(axis=1)
        rows = np.where(there[:, None], slopes, 0.0)
        base, columns = np.concatenate([fixed, rows[equality]]).T, rows.T
        left = columns - base @ np.linalg.lstsq(base, columns, rcond=None)[0]
        size = np.linalg.norm(columns, axis=0)
        pinned &= ~there | ((size > 0.0) & (np.linalg.norm(left, axis=0) <= 1e-9 * size))
        seen |= there
    return pinned & seen
