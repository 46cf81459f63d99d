"""Checks of a result after a search: the mesh error, violations between nodes, and rows whose gradient vanishes.

Every interval is integrated again accurately from its planned start, with the planned controls. Its end differs from
the planned end by a tangent g_k. With the multipliers y_k of the dynamics, the objective of a trajectory that satisfies
the differential equations is, to first order,

    J + sum_k y_k . g_k + (cost along the accurate integration - planned cost).

Source: Becker and Rannacher, Acta Numerica 10 (2001), pp. 1-102 (dual-weighted error estimates).

A row has a nonvanishing gradient if a move of all unknowns by their sizes changes it noticeably: the product of its
multiplier and that change is then of the order of the change of the objective.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ..transcription.iterate import Instance
from ..transcription.staged import Staged
from .accuracy import Accuracy, Exceeded, FlatRow
from .integration import CloseIntegration, Closely
from .outcome import Outcome
from .status import AT_OPTIMUM, Status
from .stiffness import amplification

#: Rows with a larger multiplier, in scales of moves, count as rows whose gradient vanishes.
_RUN_AWAY = 1e8
#: The length of a small move, in sizes of the unknowns.
_SMALL = 1e-3


class Judge:
    """Checks the end of a search, and sets the status accordingly.

    Args:
        close: the accurate integration.
    """

    def __init__(self, close: CloseIntegration, staged: Staged) -> None:
        self._close, self._staged, self._shooting = close, staged, staged.transcribed
        #: Rows |a|^2 <= b^2 in place of |a| <= b, whose multipliers grow like 1 / b as b goes to zero.
        self._cones = self._named(lambda path: path.cones)
        #: Rows |a|^2 / s <= s, whose derivative with respect to s is at least one, however a changes.
        self._norm_bounds = self._named(lambda path: itertools.compress(path.names, path.norm_bounds))

    def _named(self, names_of: Callable[[Any], Iterable[str]]) -> Array:
        """Which rows have one of these names."""
        named, segments = self._shooting.named, self._shooting.segments
        names = [named(part, name) for part in segments for name in names_of(part.shooting.path)]
        return np.isin(np.asarray(self._shooting.names, str), names)

    def judged(self, outcome: Outcome, instance: Instance, mesh_tolerance: float, tolerance: float) -> Outcome:
        """The outcome with its accuracy, and with the status that follows from it.

        Args:
            mesh_tolerance: the largest mesh error for status SOLVED.
            tolerance: larger violations of limits, in their scales, are reported.
        """
        ended_well = outcome.status in AT_OPTIMUM
        if outcome.status is Status.NON_FINITE or not (ended_well or _is_finite((outcome.point, outcome.values))):
            return outcome
        z = self._staged.flat(outcome.point)
        amplified = amplification(self._staged, outcome.point, instance)
        accuracy = self._accuracy(self._close.at(z, instance), outcome, mesh_tolerance, tolerance, amplified)
        outcome = dataclasses.replace(outcome, accuracy=accuracy, flat=self._flat(z, outcome))
        if not ended_well:
            return outcome
        if outcome.flat is not None:
            return dataclasses.replace(outcome, status=Status.DEGENERATE)
        return dataclasses.replace(outcome, status=Status.COARSE) if accuracy.coarse else outcome

    def _flat(self, z: Array, outcome: Outcome) -> FlatRow | None:
        """The active row with the largest multiplier, if that multiplier has diverged."""
        weights, scales = np.abs(outcome.rows), outcome.scales
        if not weights.any():
            return None
        # Other rows receive a multiplier from the barrier, and a whole move may change them arbitrarily.
        binds = self._shooting.equality | (np.abs(outcome.scaled_rows) * scales.rows >= outcome.slack)
        weights = np.where(binds & ~self._norm_bounds, weights, 0.0)
        step, sizes = self._staged.step(scales.d, scales.u, scales.border), np.zeros_like(weights)
        for length, seen in (
            (_SMALL, 1.0),
            (1.0, ~self._cones),
        ):  # a whole move detects gradients that vanish to several orders
            look = self._close.changes(z, step, length)
            sizes = np.maximum(sizes, seen * weights * look.rows / look.cost if look.cost > 0.0 else 0.0)
        row = int(sizes.argmax())
        if not sizes[row] > _RUN_AWAY:
            return None
        return FlatRow(str(self._shooting.names[row]), self._shooting.places[row], float(sizes[row]))

    def _accuracy(
        self,
        phases: Sequence[Closely],
        outcome: Outcome,
        mesh_tolerance: float,
        tolerance: float,
        amplified: Sequence[Array],
    ) -> Accuracy:
        shooting, scales = self._shooting, outcome.scales
        places = shooting.phase_places
        intervals, change, exceeded, largest = [], -outcome.cost, dict[str, Exceeded](), 0.0
        for closely, segment, place, part in zip(phases, shooting.segments, places, self._staged.parts):
            phase = segment.shooting
            sizes = np.asarray(scales.d)[segment.nodes, : phase.n][1:]
            intervals.append(np.abs(closely.gaps / sizes).max(axis=1, initial=0.0))
            change += float(closely.cost + (outcome.dynamics[segment.stages, : phase.n] * closely.gaps).sum())
            known = part.meter.largest(segment.of(outcome.point))
            spread = np.where(known > 0.0, np.minimum(known, sizes.max(axis=0)), sizes.max(axis=0))
            costates = outcome.dynamics[segment.stages, : phase.n]
            largest = max(largest, float(np.abs(costates * spread).max(initial=0.0)))
            rows = phase.row_scales(shooting.rows_of(segment, np.asarray(scales.rows)))
            shares = closely.rows / np.where(np.isinf(rows), rows.min(axis=0), rows)
            for name, limit in _exceeded(phase, closely, shares, tolerance, place).items():
                exceeded[shooting.named(segment, name)] = limit
        order = sorted(exceeded, key=lambda name: -exceeded[name].share)
        size = max(abs(outcome.cost), min(float(scales.cost), largest)) or 1.0
        return Accuracy(
            intervals=tuple(intervals),
            change=change,
            share=abs(change) / size,
            size=size,
            amplified=tuple(amplified),
            exceeded={name: exceeded[name] for name in order},
            tolerance=mesh_tolerance,
            middles=tuple(closely.middles for closely in phases),
            places=tuple(places),
        )


def _exceeded(phase: Any, closely: Closely, shares: Array, tolerance: float, place: str) -> dict[str, Exceeded]:
    """The limits of a phase that are violated between nodes, each at its largest violation."""
    exceeded = dict[str, Exceeded]()
    for row in np.flatnonzero(shares.max(axis=0, initial=0.0) > tolerance):
        name, stage = phase.path.names[row], int(shares[:, row].argmax())
        if name in phase.path.of_steps:
            continue
        share = float(shares[stage, row])
        if name not in exceeded or share > exceeded[name].share:
            by = float(closely.rows[stage, row])
            exceeded[name] = Exceeded(by, share, f"between nodes {stage} and {stage + 1}{place}")
    return exceeded


def _is_finite(tree: Any) -> bool:
    return all(np.isfinite(np.asarray(a)).all() for a in jax.tree.leaves(tree))
