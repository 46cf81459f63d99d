"""The embedded optimiser: an augmented Lagrangian, minimised by Levenberg-Marquardt steps on the tangent space.

The merit is

    w J / |J'| + s |steps of the controls|^2 / 2 + mu/2 sum (c + l/mu)^2 + mu/2 sum max(g + l/mu, 0)^2

over equalities c and inequalities g, all scaled. Inner iterations reduce it with the Gauss-Newton matrix of the
residuals plus the curvature of the objective; outer ones update the multipliers l and the weight mu.
Source: Nocedal and Wright, Numerical Optimization (2006), chapters 10.3 (Levenberg-Marquardt) and 17.3, 17.4
(augmented Lagrangian).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .arrays import Array
from .banded import Chain, NotPositiveDefinite
from .scaling import Scales
from .transcription import Evaluation, Iterate

__all__ = ["Ending", "Optimizer", "Outcome", "Settings"]

Callback = Callable[[int, float, float], None]


@dataclasses.dataclass(frozen=True)
class Settings:
    """Constants of the optimiser; the defaults serve the cases in the tests and the landing."""

    objective_weight: float = 1.0
    first_penalty: float = 1e3
    largest_penalty: float = 1e9
    penalty_growth: float = 5.0
    first_violation: float = 1e-1
    shrink: float = 0.3
    inner_iterations: int = 40
    first_damping: float = 1e-1
    largest_damping: float = 1e12
    largest_step: float = 1.5
    trials: int = 16
    model_iterations: int = 20
    relax: float = 0.2
    tighten: float = 4.0
    flat: float = 1e-5
    settled: float = 1e-4


class Ending(NamedTuple):
    """How a run of the optimiser ended."""

    feasible: bool
    settled: bool
    finite: bool
    stalled: bool


class Outcome(NamedTuple):
    """Where a run of the optimiser ended.

    Attributes:
        evaluation: the last iterate with its residuals.
        violations: (intervals, rows) scaled violations, zero where a row holds.
        ending: why it stopped.
        iterations: evaluations of the problem.
    """

    evaluation: Evaluation
    violations: Array
    ending: Ending
    iterations: int


class _Scaled(NamedTuple):
    """An evaluation with everything divided by its scale."""

    raw: Evaluation
    rows: Array
    slopes: Array
    cost: float
    gradient: Array
    curvature: Array


class Optimizer:
    """Minimises a transcribed problem.

    Args:
        evaluate: (iterate, step) -> the evaluation after the step, as NumPy arrays.
        chain: where the unknowns sit and which are free.
        equality, exists: kinds of rows, see `Transcription`.
        scales: sizes of unknowns, rows and objective.
        smoothing: weight of the steps of the controls; `controls` says where they are in a block.
        clip_time: the final time never leaves [clip, inf) during the search.
    """

    trace = False

    def __init__(
        self,
        evaluate: Callable[[Iterate, Array], Evaluation],
        chain: Chain,
        equality: Array,
        exists: Array,
        scales: Scales,
        smoothing: float,
        controls: slice,
        shortest_time: float,
        settings: Settings | None = None,
    ) -> None:
        self._evaluate, self._chain, self._equality, self._exists = evaluate, chain, equality, exists
        self._scales, self._controls, self._shortest_time = scales, controls, shortest_time
        self.settings = settings or Settings()
        self._smoothing = smoothing * self.settings.objective_weight
        block = chain.block
        self._lengths = np.concatenate([np.tile(scales.columns[:block], chain.nodes), scales.columns[2 * block :]])

    def run(self, iterate: Iterate, max_iterations: int, tolerance: float, callback: Callback | None = None) -> Outcome:
        """Optimise from an iterate until the violation is below the tolerance and the objective has settled."""
        s = self.settings
        point = self._scaled(self._evaluate(iterate, np.zeros(self._chain.length + 1)))
        if not self._finite(point):
            return self._outcome(point, Ending(False, False, False, False), 1)
        multipliers = np.zeros_like(point.rows)
        penalty, damping, count = s.first_penalty, s.first_damping, 1
        allowed, last_cost, stalls = s.first_violation, np.inf, 0
        while True:
            flat = 0
            for _ in range(s.inner_iterations):
                found = self._step(point, multipliers, penalty, damping, max_iterations - count)
                count += found.evaluations
                damping = found.damping
                if found.point is None:
                    break
                point = found.point
                if callback is not None:
                    callback(count, self.cost_of(point), float(self.violations(point).max(initial=0.0)))
                flat = flat + 1 if found.gain < s.flat else 0
                if flat >= 2 or count >= max_iterations:
                    break
            violation = float(self.violations(point).max(initial=0.0))
            feasible = violation <= tolerance
            settled = abs(point.cost - last_cost) <= s.settled
            if self.trace:
                print(
                    f"outer mu {penalty:.1e} allowed {allowed:.1e} viol {violation:.2e} cost {point.raw.cost:.3f} count {count} damp {damping:.1e} tf {float(point.raw.iterate.final_time):.3f}"
                )
            if (feasible and settled) or count >= max_iterations or stalls >= 3:
                return self._outcome(point, Ending(feasible, settled, True, stalls >= 3), count)
            last_cost = point.cost
            if violation <= allowed:
                multipliers = penalty * self._shifted(point, multipliers, penalty)[0]
                allowed = max(s.shrink * violation, 0.1 * tolerance)
            elif penalty < s.largest_penalty:
                penalty = min(penalty * s.penalty_growth, s.largest_penalty)
            else:
                stalls += 1
                multipliers = penalty * self._shifted(point, multipliers, penalty)[0]

    # ---- one step ---------------------------------------------------------------------------------------------

    def _step(self, point: _Scaled, multipliers: Array, penalty: float, damping: float, budget: int) -> _Step:
        s = self.settings
        shift = multipliers / penalty
        merit = self._merit(point, self._shifted(point, multipliers, penalty)[0], penalty)
        tried = 0
        while tried < min(budget, s.trials) and damping <= s.largest_damping:
            try:
                step, expected = self._minimize_model(point, shift, penalty, damping)
            except NotPositiveDefinite:
                damping = max(10.0 * damping, 1e-9)
                continue
            trial, gain = self._try(point, step, multipliers, penalty, merit)
            tried += 1
            if trial is not None and gain > 0.0:
                ratio = gain / expected
                change = s.relax if ratio > 0.75 else 1.0 if ratio > 0.25 else 3.0
                return _Step(trial, max(change * damping, 1e-9), gain / max(1.0, abs(merit)), tried)
            damping = s.tighten * damping
        return _Step(None, damping, 0.0, tried)

    def _minimize_model(self, point: _Scaled, shift: Array, penalty: float, damping: float) -> tuple[Array, float]:
        """The step that minimises the damped model of the merit, and how much the model without damping falls.

        The model has linear residuals, so it is convex and piecewise quadratic: a kink where an inequality becomes
        active. Newton's method with an exact search along the line ends once the active rows stay the same.
        """
        chain, s = self._chain, self.settings
        start = np.where(self._exists, point.rows + shift, 0.0)
        bends = point.curvature + self._smoothing * self._smoother
        pull = chain.scatter(point.gradient + self._smoothing * self._smooth_pull(point)) * chain.free
        step = np.zeros(len(pull))
        values = start
        bent = np.zeros_like(step)
        active = self._equality | (values > 0.0)
        for _ in range(s.model_iterations):
            seen = np.where(active, values, 0.0)
            slope = pull + bent + penalty * chain.scatter(np.einsum("kr,krl->kl", seen, point.slopes)) * chain.free
            weighted = point.slopes * active[:, :, None]
            matrices = bends + penalty * np.matmul(weighted.transpose(0, 2, 1), point.slopes)
            self.solves = getattr(self, "solves", 0) + 1
            move = chain.factor(matrices, damping).solve(-(slope + damping * step))
            moves = np.einsum("krl,kl->kr", point.slopes, chain.gather(move))
            bent_move = chain.scatter(np.einsum("kab,kb->ka", bends, chain.gather(move))) * chain.free
            share = self._search(
                values, moves, penalty, float((pull + bent + damping * step) @ move), float(bent_move @ move + damping * move @ move)
            )
            step, values, bent = step + share * move, values + share * moves, bent + share * bent_move
            before, active = active, self._equality | (values > 0.0)
            if share > 0.999 and (before == active).all():
                break
        long = float(np.abs(step).max())
        if long > s.largest_step:
            shrink = s.largest_step / long
            step, bent, values = shrink * step, shrink * bent, start + shrink * (values - start)
        return step, self._half(start, penalty) - self._half(values, penalty) - float(pull @ step + 0.5 * bent @ step)

    def _half(self, values: Array, penalty: float) -> float:
        return 0.5 * penalty * float((np.where(self._equality | (values > 0.0), values, 0.0) ** 2).sum())

    def _search(self, values: Array, moves: Array, penalty: float, slope: float, bend: float) -> float:
        """The share in (0, 1] of a move at which the model is least."""

        def derivative(share: float) -> float:
            now = values + share * moves
            seen = np.where(self._equality | (now > 0.0), now, 0.0)
            return slope + share * bend + penalty * float((seen * moves).sum())

        if derivative(1.0) <= 0.0:
            return 1.0
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if derivative(middle) < 0.0 else (low, middle)
            if high - low < 1e-3 * high: break
        return high

    def _try(
        self, point: _Scaled, step: Array, multipliers: Array, penalty: float, merit: float
    ) -> tuple[_Scaled | None, float]:
        move = step * self._lengths
        move[-1] = max(move[-1], self._shortest_time - float(point.raw.iterate.final_time))
        trial = self._scaled(self._evaluate(point.raw.iterate, move))
        if not self._finite(trial):
            return None, -np.inf
        return trial, merit - self._merit(trial, self._shifted(trial, multipliers, penalty)[0], penalty)

    def _shifted(self, point: _Scaled, multipliers: Array, penalty: float) -> tuple[Array, Array]:
        """The residuals the merit sees, and which rows are active."""
        shifted = point.rows + multipliers / penalty
        active = self._exists & (self._equality | (shifted > 0.0))
        return np.where(active, shifted, 0.0), active

    def _merit(self, point: _Scaled, shifted: Array, penalty: float) -> float:
        steps = np.diff(self._scaled_controls(point), axis=0)
        return point.cost + 0.5 * penalty * float((shifted**2).sum()) + 0.5 * self._smoothing * float((steps**2).sum())

    # ---- smoothing of the controls ------------------------------------------------------------------------------

    def _scaled_controls(self, point: _Scaled) -> Array:
        return point.raw.iterate.us / self._scales.columns[self._controls]

    @property
    def _smoother(self) -> Array:
        """(intervals, local, local): second derivative of sum |u_(k+1) - u_k|^2 / 2."""
        chain = self._chain
        difference = np.zeros((self._controls.stop - self._controls.start, chain.local))
        for i, j in enumerate(range(self._controls.start, self._controls.stop)):
            difference[i, j], difference[i, chain.block + j] = -1.0, 1.0
        # The last interval has no control after it.
        neighbours = np.arange(chain.nodes - 1) < chain.nodes - 2
        return neighbours[:, None, None] * (difference.T @ difference)

    def _smooth_pull(self, point: _Scaled) -> Array:
        """(intervals, local): first derivative of sum |u_(k+1) - u_k|^2 / 2."""
        chain = self._chain
        pull = np.zeros((chain.nodes - 1, chain.local))
        steps = np.diff(self._scaled_controls(point), axis=0)
        pull[:-1, self._controls] = -steps
        pull[:-1, chain.block + self._controls.start : chain.block + self._controls.stop] = steps
        return pull

    # ---- scales and judgement -------------------------------------------------------------------------------------

    def _scaled(self, raw: Evaluation) -> _Scaled:
        columns, rows = self._scales.columns, self._scales.rows
        weight = self.settings.objective_weight / self._scales.cost
        return _Scaled(
            raw,
            np.where(self._exists, raw.rows / rows, 0.0),
            raw.slopes * (columns / rows[:, None]) * self._exists[:, :, None],
            weight * float(raw.cost),
            weight * raw.gradient * columns,
            weight * raw.curvature * (columns[:, None] * columns),
        )

    def violations(self, point: _Scaled) -> Array:
        """(intervals, rows) scaled violations; zero where a row holds or is not asked."""
        return np.where(self._equality, np.abs(point.rows), np.maximum(point.rows, 0.0))

    def cost_of(self, point: _Scaled) -> float:
        return float(point.raw.cost)

    def _finite(self, point: _Scaled) -> bool:
        values = (point.rows, point.slopes, point.gradient, point.curvature)
        return bool(np.isfinite(point.cost)) and all(bool(np.isfinite(v).all()) for v in values)

    def _outcome(self, point: _Scaled, ending: Ending, count: int) -> Outcome:
        return Outcome(point.raw, self.violations(point), ending, count)


class _Step(NamedTuple):
    """An accepted step (None if every damping failed), the damping to go on with, the merit's gain, and its price."""

    point: _Scaled | None
    damping: float
    gain: float
    evaluations: int
