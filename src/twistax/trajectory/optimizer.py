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

import dataclasses
import enum
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from .banded import Chain, NotPositiveDefinite
from .model import Model, Smoothing
from .scaling import Scales
from .transcription import Evaluation, Iterate, Transcription

__all__ = ["Callback", "Optimizer", "Outcome", "Settings", "Status"]

#: Called with (evaluations so far, objective, violation) after every accepted step.
Callback = Callable[[int, float, float], None]


@dataclasses.dataclass(frozen=True)
class Settings:
    """Constants of the optimiser; the defaults serve the cases in the tests and the landing.

    Attributes:
        first_penalty, largest_penalty, penalty_growth: the weight mu of violations and how it is raised.
        first_violation, violation_share: the multipliers are updated once the violation is below the first, then once
            it is below this share of what it was; otherwise the weight is raised.
        inner_iterations: accepted steps between two updates.
        first_damping, largest_damping: of the steps; beyond the largest the inner iterations end.
        relax, tighten: factors of the damping after a step that did what the model said, and after one that failed.
        largest_step: of any unknown in its scale.
        flat: two steps in a row that gain less end the inner iterations.
        noise: an expected gain below this share of the merit is round-off: no step is tried for it.
        settled: a change of the scaled objective between two updates that counts as none.
        stalled, stalls: this many updates in a row whose violation stays above that share of the one before mean
            that no trajectory is found.
    """

    first_penalty: float = 3e2
    largest_penalty: float = 1e9
    penalty_growth: float = 5.0
    first_violation: float = 1e-1
    violation_share: float = 0.3
    inner_iterations: int = 40
    first_damping: float = 1e-1
    largest_damping: float = 1e12
    relax: float = 0.2
    tighten: float = 4.0
    largest_step: float = 1.5
    flat: float = 1e-4
    noise: float = 1e-13
    settled: float = 1e-4
    stalled: float = 0.97
    stalls: int = 4


class Status(enum.Enum):
    """How an optimisation ended, as a sentence."""

    SOLVED = "every constraint holds within the tolerance and the objective has settled"
    MAX_ITERATIONS = "the iterations ran out before every constraint held and the objective settled"
    INFEASIBLE = "no trajectory was found that meets every constraint"
    NON_FINITE = "the problem has values that are not finite at the guess"

    def __str__(self) -> str:
        return f"{self.name}: {self.value}"


class Outcome(NamedTuple):
    """Where a run of the optimiser ended.

    Attributes:
        evaluation: the last iterate with its residuals.
        violations: (intervals, rows) scaled violations, zero where a row holds.
        status: how it ended.
        iterations: evaluations of the problem.
    """

    evaluation: Evaluation
    violations: Array
    status: Status
    iterations: int


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
    """Minimises a transcribed problem.

    Args:
        evaluate: (iterate, step) -> the evaluation after the step, as NumPy arrays.
        chain: where the unknowns sit and which are free.
        transcription: what kind its rows are.
        scales: sizes of unknowns, rows and objective.
        shortest_time: the final time never falls below it during the search.
    """

    def __init__(
        self,
        evaluate: Callable[[Iterate, Array], Evaluation],
        chain: Chain,
        transcription: Transcription,
        scales: Scales,
        shortest_time: float,
    ) -> None:
        t = transcription
        self._evaluate, self._chain, self._scales, self._shortest_time = evaluate, chain, scales, shortest_time
        self._equality, self._exists, self._decided = t.equality, t.exists, t.decided
        self._settings = Settings()
        controls = slice(t.n, t.block)
        self._smoothing = Smoothing(chain, controls, scales.columns[controls], t.objective.smoothing)
        self._lengths = np.concatenate([np.tile(scales.columns[: chain.block], chain.nodes), scales.columns[-1:]])

    def run(self, iterate: Iterate, max_iterations: int, tolerance: float, callback: Callback | None = None) -> Outcome:
        """Optimise from an iterate until the violation is below the tolerance and the objective has settled."""
        s = self._settings
        point = self._point(iterate, np.zeros(len(self._lengths)))
        if point is None:
            raw = self._evaluate(iterate, np.zeros(len(self._lengths)))
            return Outcome(raw, np.zeros(raw.rows.shape), Status.NON_FINITE, 1)
        lost = np.where(self._decided, self._violations(point), 0.0)
        if lost.max(initial=0.0) > tolerance:
            return Outcome(point.raw, lost, Status.INFEASIBLE, 1)
        merit = _Merit(np.zeros_like(point.rows), s.first_penalty)
        damping, count, allowed, last_cost = s.first_damping, 1, s.first_violation, np.inf
        before, stalls = np.inf, 0
        while True:
            point, damping, count = self._reduce(point, merit, damping, count, max_iterations, callback)
            violation = self._violation(point)
            feasible, settled = violation <= tolerance, abs(point.cost - last_cost) <= s.settled
            stalls = stalls + 1 if violation > max(allowed, s.stalled * before) else 0
            if (feasible and settled) or count >= max_iterations or stalls >= s.stalls:
                status = Status.INFEASIBLE if stalls >= s.stalls else Status.MAX_ITERATIONS
                status = Status.SOLVED if feasible and settled else status
                return Outcome(point.raw, self._violations(point), status, count)
            last_cost, before = point.cost, violation
            if violation > allowed and merit.penalty < s.largest_penalty:
                merit = merit._replace(penalty=min(merit.penalty * s.penalty_growth, s.largest_penalty))
                continue
            merit = merit._replace(multipliers=merit.penalty * self._counted(point, merit))
            allowed = max(s.violation_share * violation, 0.1 * tolerance)

    def _reduce(
        self, point: _Point, merit: _Merit, damping: float, count: int, limit: int, callback: Callback | None
    ) -> tuple[_Point, float, int]:
        """Inner iterations: steps until the merit no longer falls."""
        s = self._settings
        flat = 0
        for _ in range(s.inner_iterations):
            found, gain, damping, evaluations = self._step(point, merit, damping, limit - count)
            count += evaluations
            if found is None:
                # Every damping failed: nothing to gain here. Start the next merit from a moderate one.
                return point, s.first_damping, count
            point = found
            if callback is not None:
                callback(count, float(point.raw.cost), self._violation(point))
            flat = flat + 1 if gain < s.flat else 0
            if flat == 2 or count >= limit:
                break
        return point, damping, count

    def _step(
        self, point: _Point, merit: _Merit, damping: float, budget: int
    ) -> tuple[_Point | None, float, float, int]:
        """The next point (None if every damping failed), the gain, the damping to go on with, evaluations."""
        s, chain = self._settings, self._chain
        before = self._value(point, merit)
        pull = chain.scatter(point.gradient + self._smoothing.gradient(point.raw.iterate.us))
        model = Model(
            chain,
            np.where(self._exists, point.rows + merit.multipliers / merit.penalty, 0.0),
            point.slopes,
            self._equality,
            np.where(chain.free, pull, 0.0),
            point.curvature + self._smoothing.curvature,
            merit.penalty,
        )
        tried = 0
        while tried < budget and damping <= s.largest_damping:
            try:
                step, expected = model.minimize(damping, s.largest_step)
            except NotPositiveDefinite:
                damping = max(10.0 * damping, 1e-9)
                continue
            if expected <= s.noise * (1.0 + abs(before)):
                break
            move = step * self._lengths
            move[-1] = max(move[-1], self._shortest_time - float(point.raw.iterate.final_time))
            trial = self._point(point.raw.iterate, move)
            tried += 1
            gain = -np.inf if trial is None else before - self._value(trial, merit)
            if gain > 0.0:
                factor = s.relax if gain > 0.75 * expected else 1.0 if gain > 0.25 * expected else 3.0
                return trial, gain, max(factor * damping, 1e-9), tried
            damping *= s.tighten
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
        return np.where(self._equality, np.abs(point.rows), np.maximum(point.rows, 0.0))

    def _violation(self, point: _Point) -> float:
        return float(self._violations(point).max(initial=0.0))

    def _point(self, iterate: Iterate, move: Array) -> _Point | None:
        """The scaled evaluation after a move; None if it is not finite."""
        raw = self._evaluate(iterate, move)
        if not all(
            np.isfinite(values).all() for values in (raw.rows, raw.slopes, raw.cost, raw.gradient, raw.curvature)
        ):
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
