"""The maximum-likelihood search: one loop that linearises all segments once in each pass."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ...system.dynamics import Arrays
from ..smoothers.levenberg_marquardt import MOST_DAMPING, next_damping
from .experiment import SegmentedData
from .multiple_shooting import Prior, SegmentUnknowns, ShootingSteps
from .segments import LinearizedSegment

#: Steps of the start of a segment to its measurements, before parameters move.
_STATE_STEPS = 20


class FitState(NamedTuple):
    """The state of the search between two passes.

    Attributes:
        stage, passes: the stage of the search, and the number of passes in this stage.
        unknowns, segments: the best unknowns, and all segments linearised about them.
        damping, settled: damping of the steps of each segment (experiments, segments), and whether it is converged.
        iterations: the number of passes in which parameters changed.
    """

    stage: jax.Array
    passes: jax.Array
    unknowns: SegmentUnknowns
    segments: LinearizedSegment
    damping: jax.Array
    settled: jax.Array
    iterations: jax.Array


#: New unknowns, the sizes of the steps (experiments, segments), and costs that they must not exceed.
Candidate = tuple[SegmentUnknowns, jax.Array, jax.Array]


class SearchStage(NamedTuple):
    """A stage of the search.

    Attributes:
        propose: the unknowns that a pass tries.
        moving: the segments that take part.
        most: the largest number of passes.
        is_tried: whether a pass is accepted only if it lowers the cost.
    """

    propose: Callable[[FitState], Candidate]
    moving: jax.Array
    most: int
    is_tried: bool = True


class ShootingSearch:
    """The search for parameters and initial states, in stages.

    First, all segments are simulated successively. Second, the initial state of each segment is fitted to its
    measurements. Third, Gauss-Newton and Levenberg-Marquardt steps change parameters and initial states. Finally, each
    experiment is simulated as a whole. With a single segment, it is simulated, and its parameters are fitted.

    The unknowns that a pass tries are linearised once, for their cost and for the next pass. All stages share that
    program, which takes nearly all of the compile time.

    Args:
        data, prior: arrays, which may be traced.
        tolerance: a stage ends when steps are smaller than this, in standard deviations.
        max_iterations: the largest number of steps of the parameters.
    """

    def __init__(
        self, shooting: ShootingSteps, data: SegmentedData, prior: Prior, tolerance: jax.Array, max_iterations: int
    ) -> None:
        self.shooting, self.data, self.prior, self.tolerance = shooting, data, prior, tolerance
        shape = data.rows.ts.shape[:2]
        segments, every = shape[1], jnp.ones(shape, bool)
        known = (~data.starts.unknown.all(axis=1)) | (data.starts.information != 0.0).any(axis=(1, 2))
        unknown = ~known[:, None] | (jnp.arange(segments) > 0)[None, :]
        move = SearchStage(self._moved, every, max_iterations)
        stages = [SearchStage(self._simulated, every, segments, is_tried=False), move]
        if segments > 1:
            stages.insert(1, SearchStage(self._fitted, unknown, _STATE_STEPS))
            stages.append(SearchStage(self._joined, every, segments - 1, is_tried=False))
        self.stages, self.place = stages, stages.index(move)

    def run(self, theta: jax.Array) -> FitState:
        """The final state of the search, from these parameters."""
        going = lambda state: state.stage < len(self.stages)  # noqa: E731
        state: FitState = jax.lax.while_loop(going, self._advanced, self._first(theta))
        return state

    def _first(self, theta: jax.Array) -> FitState:
        data, shape = self.data, self.data.rows.ts.shape[:2]
        x0 = {name: jnp.broadcast_to(x[:, None], data.guess[name].shape) for name, x in data.starts.x.items()}
        weights = jnp.zeros((*shape, self.shooting.group.dimension), theta.dtype)
        unknowns = SegmentUnknowns(self._guessed(x0), theta, weights)
        shapes = jax.eval_shape(self.shooting.linearized, unknowns, data)
        nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)
        zero = jnp.zeros((), jnp.int32)
        return FitState(zero, zero, unknowns, nothing, jnp.zeros(shape, theta.dtype), jnp.zeros(shape, bool), zero)

    def _advanced(self, state: FitState) -> FitState:
        shape, eps = state.settled.shape, float(jnp.finfo(state.damping.dtype).eps)
        new, size, before = jax.lax.switch(state.stage, [stage.propose for stage in self.stages], state)
        segments = self.shooting.linearized(new, self.data)
        total = jnp.broadcast_to(self.shooting.cost(new, segments, self.data, self.prior), shape)
        is_moved = state.stage == self.place
        after = jnp.where(is_moved, total, segments.likelihood.cost)
        is_tried = jnp.asarray([stage.is_tried for stage in self.stages])[state.stage]
        better = ~state.settled & (~is_tried | (after <= before + 16.0 * eps * jnp.abs(before)))
        chosen = functools.partial(jax.tree.map, lambda a, b: _where(better, a, b))
        old = state.unknowns
        theta = jnp.where(better.all(), new.theta, old.theta)
        unknowns = SegmentUnknowns(chosen(new.starts, old.starts), theta, chosen(new.weights, old.weights))

        # ---- what is settled, and the next stage ----
        damping, passes = next_damping(state.damping, better), state.passes + 1
        most = jnp.asarray([stage.most for stage in self.stages], jnp.int32)[state.stage]
        ended = ((size < self.tolerance) & (state.damping == 0.0)) | (damping >= MOST_DAMPING) | (passes >= most)
        settled = state.settled | ended
        done = settled.all()
        moving = jnp.stack([*(stage.moving for stage in self.stages[1:]), jnp.ones(shape, bool)])[state.stage]
        return FitState(
            jnp.where(done, state.stage + 1, state.stage),
            jnp.where(done, 0, passes),
            unknowns,
            chosen(segments, state.segments),
            jnp.where(done | state.settled, 0.0, damping),
            jnp.where(done, ~moving, settled),
            jnp.where(is_moved, passes, state.iterations),
        )

    # ---- what a pass tries -------------------------------------------------------------------------------------------

    def _simulated(self, state: FitState) -> Candidate:
        """Starts where the segments before end, or those of the guess. A pass of n simulates one segment further."""
        x0 = {name: x[:, None] for name, x in self.data.starts.x.items()}
        ends = _joined(state)
        finite = jnp.stack([jnp.isfinite(a).all(axis=tuple(range(2, a.ndim))) for a in ends.values()]).all(axis=0)
        simulated = self._guessed({name: _where(finite, x, x0[name]) for name, x in ends.items()})
        first = state.passes == 0
        return self._always(
            state, {name: jnp.where(first, x, simulated[name]) for name, x in state.unknowns.starts.items()}
        )

    def _joined(self, state: FitState) -> Candidate:
        """Starts where the segments before end: the experiment as one simulation, after a pass for each segment."""
        return self._always(state, _joined(state))

    def _fitted(self, state: FitState) -> Candidate:
        """The start of each segment by a step to its measurements."""
        steps = jax.vmap(jax.vmap(self.shooting.start_step))
        starts, sizes = steps(state.unknowns.starts, state.segments, state.damping)
        return state.unknowns.started(starts), sizes, state.segments.likelihood.cost

    def _moved(self, state: FitState) -> Candidate:
        """Parameters and starts by a step."""
        new, size, before = self.shooting.step(
            state.unknowns, state.segments, state.damping[0, 0], self.data, self.prior
        )
        shape = state.damping.shape
        return new, jnp.broadcast_to(size, shape), jnp.broadcast_to(before, shape)

    def _always(self, state: FitState, starts: Arrays) -> Candidate:
        unlimited = jnp.full_like(state.damping, jnp.inf)
        return state.unknowns.started(starts), unlimited, unlimited

    def _guessed(self, starts: Arrays) -> Arrays:
        """The starts; those of the guess where there is one."""

        def one(guess: jax.Array, x: jax.Array) -> jax.Array:
            return _where(jnp.isfinite(guess).all(axis=tuple(range(2, guess.ndim))), guess, x)

        return {name: one(self.data.guess[name], x) for name, x in starts.items()}


def _joined(state: FitState) -> Arrays:
    """The starts of experiments, and the ends of all segments but the last."""
    starts, ends = state.unknowns.starts, state.segments.end
    return {name: jnp.concatenate([x[:, :1], ends[name][:, :-1]], axis=1) for name, x in starts.items()}


def _where(condition: jax.Array, a: Any, b: Any) -> jax.Array:
    """Choose by the leading axes of arrays."""
    return jnp.where(condition.reshape(*condition.shape, *(1,) * (a.ndim - condition.ndim)), a, b)
