"""What is decided between the steps of a run: whether scales are renewed, and what says that it is led astray.

All of it is traceable.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray as Array

from . import scaling
from .descent import Begun, Descent
from .interior_point import largest
from .iterate import Scales, State
from .transcribed import Derivatives, Step, Transcribed

#: Scales are renewed once they are off by this factor. A result stands in scales that are not.
RENEW = 3.0
#: What was begun in scales that are off by this factor is worth nothing.
WORTHLESS = 1e3
#: Iterations after which scales are looked at, beside those at which the barrier parameter falls.
EARLY = (1, 3, 6)
#: Scaled multipliers beyond this have run away.
AWAY = 1e6
#: An unknown that is so many times as large as at the start has lost all digits of it, and has run off; where it is so
#: many times as large, scales are looked at again and again.
FAR, NEAR = 1e16, 1e5
#: A run creeps along what seems to be a saddle: so many steps in a row need more than CURVED on the diagonal, scaled,
#: leave residuals below NEARLY, and change the objective by less than that share of its scale.
LONG, CURVED, NEARLY = 30, 1e-6, 1e-3
#: A run is jammed after so many steps in a row of less than this share, with residuals above NEARLY: limits are near,
#: or the filter takes no longer ones.
JAMMED, SHORT = 10, 1e-2
#: Where a solution stands in scales that are so many times too large, for they were once, these are forgotten.
INFLATED = 10.0


class Memory(NamedTuple):
    """What a run knows of the way it went."""

    least: Any  # of the objective's scale: a small share of what it was at the start
    seen: Scales  # the largest since then
    begun: Begun
    creeping: Any  # for how many steps in a row; below zero it does not count
    level: Any  # the objective where they began
    jammed: Any  # for how many steps in a row


class Signs(NamedTuple):
    """What says that a run is at its end, or that something is wrong."""

    error: Any  # the largest of what SOLVED asks for
    pinned: Any  # the largest violation of rows that others decide, scaled
    away: Any  # multipliers have run away
    near: Any  # an unknown runs off, maybe
    far: Any  # it has run off
    holds: Any  # every constraint does, in scales without memory
    creeps: Any  # the run does
    jams: Any  # it hardly moves, and does not hold what it should


class Opening(NamedTuple):
    """The first state of a run, and what it says."""

    state: State
    memory: Memory
    finite: Any  # whether its values and scales are
    decided: Any  # the largest violation, scaled, of rows that the ends decide
    bound: Any  # whether limits and costs say how far every control may go


class Decisions:
    """Decides for runs of a problem."""

    def __init__(self, shooting: Transcribed, tolerance: float) -> None:
        self._shooting, self._tolerance, self._descent = shooting, tolerance, Descent(shooting)

    def no_memory(self) -> Memory:
        """In place of one, where none is needed."""
        unit = scaling.unit_scales(self._shooting)
        none = np.zeros((), int)
        return Memory(np.ones(()), unit, self._descent.nothing(), none, np.zeros(()), none)

    def opening(self, state: State, seen: Scales, bound: Any = True) -> Opening:
        """Of a first state, where these are the largest scales seen."""
        level = jnp.asarray(state.values.cost)
        none = jnp.zeros((), int)
        memory = Memory(scaling.SMALL * seen.cost, seen, self._descent.begun(state), none, level, none)
        finite = jnp.stack([jnp.isfinite(a).all() for a in (*state.scales, *state.values)]).all()
        decided = self._largest_of(self._shooting.decided & ~self._shooting.pinned, state)
        return Opening(state, memory, finite, decided, jnp.asarray(bound))

    def _largest_of(self, rows: Array, state: State) -> jax.Array:
        """The largest violation of some rows, scaled."""
        return jnp.where(rows, row_violations(self._shooting, state), 0.0).max(initial=0.0)

    def due(self, state: State, memory: Memory, count: Any, before: Any) -> jax.Array:
        """Whether scales of a measured state are to be looked at, after so many iterations.

        Args:
            before: the barrier parameter before the state was measured; infinite after a search for feasible points.
        """
        early = jnp.stack([count == k for k in EARLY]).any()
        plain = (error(state) <= self._tolerance) | early | (state.barrier < before)
        return plain | self._descent.beyond(memory.begun, state, NEAR)

    def renewed(self, state: State, slopes: Derivatives, memory: Memory) -> tuple[Scales, jax.Array, Memory]:
        """New scales for a measured state, by how much its own are off, and what is known then."""
        measured, sloped = scaling.measured(self._shooting, state.point, slopes, state.scales)
        fresh, seen = scaling.not_below(measured, memory.seen, sloped)
        # Those of an excursion, or of a start far off, may be more than anything is worth now. An objective without
        # slope, as it may be at its optimum, counts as it bends.
        sizes, own = Step(measured.d, measured.u, measured.border), jnp.where(sloped, measured.cost, 0.0)
        least = jnp.minimum(memory.least, scaling.bent(self._shooting, slopes, state.scales, sizes, sizes))
        best = jnp.maximum(own, least)
        own = jnp.where(best > 0.0, best, jnp.where(memory.least > 0.0, memory.least, state.scales.cost))
        sizes_alone = measured._replace(rows=fresh.rows, cost=fresh.cost)
        inflated = (scaling.change(fresh, sizes_alone) > INFLATED) | (fresh.cost > INFLATED * own)
        forget, kept = (error(state) <= self._tolerance) & inflated, measured._replace(cost=own)
        fresh, seen = jax.tree.map(lambda a, b: jnp.where(forget, a, b), (kept, kept), (fresh, seen))
        memory = memory._replace(seen=seen)
        return fresh, scaling.change(fresh, state.scales), memory

    def signs(self, state: State, memory: Memory) -> Signs:
        lost = self._largest_of(self._shooting.exists, state)
        return Signs(
            error(state),
            self._largest_of(self._shooting.pinned, state),
            self.away(state),
            self._descent.beyond(memory.begun, state, NEAR),
            self.far(state, memory),
            jnp.maximum(lost, self._descent.gaps(memory.begun, state)) <= self._tolerance,
            self.creeps(memory),
            self.jams(memory),
        )

    def went(self, state: State, memory: Memory, steps: Any) -> Memory:
        """The memory after a step to a measured state, or none.

        What keeps the equations from a saddle slows all else down, and by symmetry the way aside may have no slope.
        Where many limits are met, steps may be too short to bring constraints closer.
        """
        cost = state.values.cost
        rests = jnp.abs(cost - memory.level) <= NEARLY * state.scales.cost
        slow = (state.raised > CURVED) & (state.errors.feasibility <= NEARLY) & rests
        count = memory.creeping + jnp.where(steps, 1, 0)
        short = (state.share < SHORT) & (state.errors.feasibility > NEARLY)
        return memory._replace(
            creeping=jnp.where(slow, count, jnp.minimum(memory.creeping, 0)),
            level=jnp.where(slow, memory.level, cost),
            jammed=jnp.where(short, memory.jammed + jnp.where(steps, 1, 0), 0),
        )

    def creeps(self, memory: Memory) -> jax.Array:
        """Whether a run has crept for long."""
        return memory.creeping >= LONG

    def jams(self, memory: Memory) -> jax.Array:
        """Whether a run is jammed."""
        return memory.jammed >= JAMMED

    def away(self, state: State) -> jax.Array:
        """Whether multipliers have run away.

        They do where many steps in a row need a large diagonal: it adds to them, they add to the second derivatives,
        and these ask for a larger one.
        """
        return largest((state.dynamics, state.rows)) > AWAY

    def far(self, state: State, memory: Memory) -> jax.Array:
        """Whether a run seems to have no end; a feasible point from there tells."""
        return self._descent.beyond(memory.begun, state, FAR)


def error(state: Any) -> jax.Array:
    """The largest of what SOLVED asks for."""
    return jnp.stack([state.errors.stationarity, state.errors.feasibility, state.errors.gap]).max()


def row_violations(shooting: Transcribed, state: Any) -> Any:
    """Scaled, of all rows; of NumPy's arrays by NumPy."""
    rows = state.values.rows / state.scales.rows
    own: Any = np if isinstance(rows, np.ndarray) else jnp
    return own.where(shooting.equality, own.abs(rows), own.maximum(rows, 0.0))
