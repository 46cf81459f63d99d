"""The embedded optimiser: an augmented Lagrangian, minimised by Levenberg-Marquardt steps on the tangent space.

The merit, all parts scaled, is

    J + s |steps of the controls|^2 / 2 + mu/2 sum (c + l/mu)^2 + mu/2 sum max(g + l/mu, 0)^2

over equalities c and inequalities g. Inner iterations reduce it: a step minimises the merit with linearised residuals
plus the curvature of the objective plus damping, so that it sees inequalities before it runs into them. Outer ones
update the multipliers l, or raise the weight mu where the violation does not fall.
Source: Nocedal and Wright, Numerical Optimization (2006), chapters 10.3 (Levenberg-Marquardt), 17.3 and 17.4
(augmented Lagrangian).
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from .guess import Scales
from .model import BorderedBand, Model, NotPositiveDefinite, Smoothing
from .statement import violations
from .transcription import Evaluation, Iterate, Transcription

#: Called with (evaluations so far, objective, violation) after every accepted step.
Callback = Callable[[int, float, float], None]


# What serves the cases in the tests and the landing.
#: The weight mu of violations, and how it is raised.
_FIRST_PENALTY, _LARGEST_PENALTY, _PENALTY_GROWTH = 3e2, 1e9, 5.0
#: The multipliers are updated once the violation is below the first, then once it is below this share of what it was;
#: otherwise the weight is raised.
_FIRST_VIOLATION, _VIOLATION_SHARE = 1e-1, 0.3
#: Accepted steps between two updates.
_INNER_ITERATIONS = 40
#: Of the steps; beyond the largest the inner iterations end.
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-1, 1e12
#: Factors of the damping after a step that did what the model said, and after one that failed.
_RELAX, _TIGHTEN = 0.2, 4.0
#: Of any unknown in its scale.
_LARGEST_STEP = 1.5
#: Two steps in a row that gain less end the inner iterations.
_FLAT = 1e-4
#: An expected gain below this share of the merit is round-off: no step is tried for it.
_NOISE = 1e-13
#: A change of the scaled objective between two updates that counts as none.
_SETTLED = 1e-4
#: This many updates in a row whose violation stays above that share of the one before mean that no trajectory is found.
_STALLS, _STALLED = 4, 0.97


class Status(enum.Enum):
    """How an optimisation ended, as a sentence."""

    SOLVED = "every constraint holds within the tolerance and the objective has settled"
    MAX_ITERATIONS = "the iterations ran out before every constraint held and the objective settled"
    INFEASIBLE = "no trajectory was found that meets every constraint"
    NON_FINITE = "the problem has values that are not finite at the guess"

    def __str__(self) -> str:
        return f"{self.name}: {self.value}"


class Outcome(NamedTuple):
    """Where a run of the optimiser ended."""

    evaluation: Evaluation  # the last iterate with its residuals
    violations: Array  # (intervals, rows), scaled, zero where a row holds
    status: Status
    iterations: int  # evaluations of the problem

    @property
    def cost(self) -> float:
        return float(self.evaluation.cost)

    @property
    def violation(self) -> float:
        return float(self.violations.max(initial=0.0))


class _Point(NamedTuple):
    """An evaluation with everything divided by its scale."""

    raw: Evaluation
    rows: Array
    slopes: Array
    cost: float
    gradient: Array
    curvature: Array


class _Merit(NamedTuple):
    """The multipliers and the weight of the current merit."""

    multipliers: Array
    penalty: float


class Optimizer:
    """Minimises a transcribed problem; the final time never falls below `shortest_time` during the search."""

    def __init__(
        self,
        evaluate: Callable[[Iterate, Array], Evaluation],
        band: BorderedBand,
        transcription: Transcription,
        scales: Scales,
        shortest_time: float,
    ) -> None:
        t = transcription
        self._evaluate, self._band, self._scales, self._shortest_time = evaluate, band, scales, shortest_time
        self._equality, self._exists, self._decided = t.equality, t.exists, t.decided
        controls = slice(t.n, t.block)
        self._smoothing = Smoothing(band, controls, scales.columns[controls], t.objective.smoothing)
        self._lengths = np.concatenate([np.tile(scales.columns[: band.block], band.nodes), scales.columns[-1:]])

    def run(self, iterate: Iterate, max_iterations: int, tolerance: float, callback: Callback | None = None) -> Outcome:
        """Optimise from an iterate until the violation is below the tolerance and the objective has settled."""
        point = self._point(iterate, np.zeros(len(self._lengths)))
        if point is None:
            raw = self._evaluate(iterate, np.zeros(len(self._lengths)))
            return Outcome(raw, np.zeros(raw.rows.shape), Status.NON_FINITE, 1)
        lost = np.where(self._decided, self._violations(point), 0.0)
        if lost.max(initial=0.0) > tolerance:
            return Outcome(point.raw, lost, Status.INFEASIBLE, 1)
        merit = _Merit(np.zeros_like(point.rows), _FIRST_PENALTY)
        damping, count, allowed, last_cost = _FIRST_DAMPING, 1, _FIRST_VIOLATION, np.inf
        before, stalls = np.inf, 0
        while True:
            point, damping, count = self._reduce(point, merit, damping, count, max_iterations, callback)
            violation = self._violation(point)
            feasible, settled = violation <= tolerance, abs(point.cost - last_cost) <= _SETTLED
            stalls = stalls + 1 if violation > max(allowed, _STALLED * before) else 0
            if (feasible and settled) or count >= max_iterations or stalls >= _STALLS:
                status = Status.INFEASIBLE if stalls >= _STALLS else Status.MAX_ITERATIONS
                status = Status.SOLVED if feasible and settled else status
                return Outcome(point.raw, self._violations(point), status, count)
            last_cost, before = point.cost, violation
            if violation > allowed and merit.penalty < _LARGEST_PENALTY:
                merit = merit._replace(penalty=min(merit.penalty * _PENALTY_GROWTH, _LARGEST_PENALTY))
                continue
            merit = merit._replace(multipliers=merit.penalty * self._counted(point, merit))
            allowed = max(_VIOLATION_SHARE * violation, 0.1 * tolerance)

    def _reduce(
        self, point: _Point, merit: _Merit, damping: float, count: int, limit: int, callback: Callback | None
    ) -> tuple[_Point, float, int]:
        """Inner iterations: steps until the merit no longer falls."""
        flat = 0
        for _ in range(_INNER_ITERATIONS):
            found, gain, damping, evaluations = self._step(point, merit, damping, limit - count)
            count += evaluations
            if found is None:
                # Every damping failed: nothing to gain here. Start the next merit from a moderate one.
                return point, _FIRST_DAMPING, count
            point = found
            if callback is not None:
                callback(count, float(point.raw.cost), self._violation(point))
            flat = flat + 1 if gain < _FLAT else 0
            if flat == 2 or count >= limit:
                break
        return point, damping, count

    def _step(
        self, point: _Point, merit: _Merit, damping: float, budget: int
    ) -> tuple[_Point | None, float, float, int]:
        """The next point (None if every damping failed), the gain, the damping to go on with, evaluations."""
        band = self._band
        before = self._value(point, merit)
        pull = band.scatter(point.gradient + self._smoothing.gradient(point.raw.iterate.us))
        model = Model(
            band,
            np.where(self._exists, point.rows + merit.multipliers / merit.penalty, 0.0),
            point.slopes,
            self._equality,
            np.where(band.free, pull, 0.0),
            point.curvature + self._smoothing.curvature,
            merit.penalty,
        )
        tried = 0
        while tried < budget and damping <= _LARGEST_DAMPING:
            try:
                step, expected = model.minimize(damping, _LARGEST_STEP)
            except NotPositiveDefinite:
                damping = max(10.0 * damping, 1e-9)
                continue
            if expected <= _NOISE * (1.0 + abs(before)):
                break
            move = step * self._lengths
            move[-1] = max(move[-1], self._shortest_time - float(point.raw.iterate.final_time))
            trial = self._point(point.raw.iterate, move)
            tried += 1
            gain = -np.inf if trial is None else before - self._value(trial, merit)
            if gain > 0.0:
                factor = _RELAX if gain > 0.75 * expected else 1.0 if gain > 0.25 * expected else 3.0
                return trial, gain, max(factor * damping, 1e-9), tried
            damping *= _TIGHTEN
        return None, 0.0, damping, tried

    # ---- the merit ----------------------------------------------------------------------------------------------

    def _counted(self, point: _Point, merit: _Merit) -> Array:
        """The shifted residuals that the merit sees; zero where an inequality is inactive."""
        shifted = point.rows + merit.multipliers / merit.penalty
        return np.where(self._exists & (self._equality | (shifted > 0.0)), shifted, 0.0)

    def _value(self, point: _Point, merit: _Merit) -> float:
        squares = float((self._counted(point, merit) ** 2).sum())
        return point.cost + self._smoothing.value(point.raw.iterate.us) + 0.5 * merit.penalty * squares

    def _violations(self, point: _Point) -> Array:
        """(intervals, rows) scaled violations; zero where a row holds or is not asked."""
        return violations(point.rows, self._equality)

    def _violation(self, point: _Point) -> float:
        return float(self._violations(point).max(initial=0.0))

    def _point(self, iterate: Iterate, move: Array) -> _Point | None:
        """The scaled evaluation after a move; None if it is not finite."""
        raw = self._evaluate(iterate, move)
        if not all(np.isfinite(values).all() for values in raw[1:]):
            return None
        columns, rows, cost = self._scales.columns, self._scales.rows, self._scales.cost
        return _Point(
            raw,
            np.where(self._exists, raw.rows / rows, 0.0),
            raw.slopes * (columns / rows[:, None]) * self._exists[:, :, None],
            float(raw.cost) / cost,
            raw.gradient * columns / cost,
            raw.curvature * (columns[:, None] * columns) / cost,
        )
