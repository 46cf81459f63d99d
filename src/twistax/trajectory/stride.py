"""Steps in a row, with new scales where they are due, until something else is to be decided.

A loop of Python costs as much as a small step, and threads wait for each other there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .decisions import EARLY, RENEW, WORTHLESS, Decisions, Memory, Signs, error
from .interior_point import InteriorPoint
from .iterate import Scales, State
from .transcribed import Derivatives, Given, Transcribed

#: Steps before those of a run that never creeps.
_NEVER = -(2**62)
#: New scales in a row, without a step, of a state that is solved in each of them.
_IN_A_ROW = 3
#: What comes next.
_END, _STEP, _LOOK, _RESCALE = range(4)


class Orders(NamedTuple):
    """How far to go."""

    look: Any  # whether the state is yet to be measured
    decide: Any  # whether scales are renewed
    anew: Any  # whether a run whose scales were worth nothing is to begin anew
    most: Any  # how many steps
    count: Any  # of iterations so far
    before: Any  # the barrier parameter before the state that is yet to be measured; infinite: look at scales


def ordered(
    look: bool = False, decide: bool = False, anew: bool = False, most: int = 0, count: int = 0, before: float = 0.0
) -> Orders:
    """Orders as numbers of NumPy, all of one type in every call."""
    flags = np.bool_(look), np.bool_(decide), np.bool_(anew)
    return Orders(*flags, np.int64(most), np.int64(count), np.float64(before))


class Stride(NamedTuple):
    """Where steps in a row have led."""

    slopes: Derivatives
    state: State  # measured
    memory: Memory
    count: Any  # of the steps
    worthless: Any  # whether the run should begin anew, in the scales that are due
    goes: Any  # whether nothing but their number ended them
    signs: Signs


class Reached(NamedTuple):
    """How far a run has come."""

    last: Stride
    iterations: int
    restarts: tuple[int, int] = (0, 0)  # as a watch counts them

    def patient(self) -> Reached:
        """The same, of a run that may creep from here on."""
        signs = self.last.signs._replace(creeps=np.zeros((), bool))
        return self._replace(last=self.last._replace(memory=patient(self.last.memory), signs=signs))


def patient(memory: Memory) -> Memory:
    """The same, of a run that may creep."""
    return memory._replace(creeping=np.int64(_NEVER))


class _Course(NamedTuple):
    slopes: Derivatives
    state: State
    memory: Memory
    count: Any
    worthless: Any
    goes: Any
    fresh: Scales  # those that were due last
    row: Any  # new scales since the last step
    following: Any


def no_slopes(shooting: Transcribed) -> Derivatives:
    """In place of derivatives, where none are known."""
    count, n, g = shooting.intervals, shooting.n, shooting.border.size
    size, rows = n + shooting.m + g, shooting.rows_per_interval
    at_end = len(shooting.exists) - count * rows
    shapes = (
        *((count, n, size), (count, rows, size), (at_end, n + g)),
        *((count, size), (n + g,), (count, size, size), (n + g, n + g)),
    )
    return jax.device_put(Derivatives(*map(np.zeros, shapes)))  # nothing to compile


def stride(
    method: InteriorPoint,
    decisions: Decisions,
    tolerance: float,
    state: State,
    slopes: Derivatives,
    memory: Memory,
    given: Given,
    orders: Orders,
) -> Stride:
    """Steps until one asks for a decision that is not made here: it may be the end, or something is wrong.

    Args:
        state: measured, with its derivatives; or yet to be measured, with none.
    """

    def ahead(own: _Course) -> _Course:
        steps, looks, rescales = (own.following == k for k in (_STEP, _LOOK, _RESCALE))
        state = jax.lax.cond(steps, lambda: method.step(own.state, own.slopes, given), lambda: own.state)
        state = jax.lax.cond(rescales, lambda: method.rescaled(state, own.fresh), lambda: state)
        slopes, measured = method.looked_at(state, given)
        before, count = jnp.where(looks, orders.before, state.barrier), own.count + jnp.where(steps, 1, 0)
        total = orders.count + count
        # One set of new scales is enough, but where a state is solved in them: they may be too large.
        row, solved = jnp.where(rescales, own.row + 1, 0), error(measured) <= tolerance
        due = orders.decide & ~measured.stuck & decisions.due(measured, own.memory, total, before)
        due = due & (~rescales | (solved & (row < _IN_A_ROW)))
        fresh, change, memory = jax.lax.cond(
            due,
            lambda: decisions.renewed(measured, slopes, own.memory),
            lambda: (measured.scales, jnp.ones(()), own.memory),
        )
        memory = decisions.went(measured, memory, steps)
        worthless = orders.anew & (total > 0) & (total <= max(EARLY)) & (change > WORTHLESS)
        worthless = worthless & ~solved
        e = measured.errors
        finite = jnp.isfinite(jnp.stack([e.stationarity, e.feasibility, e.gap])).all()
        calm = ~solved & finite & ~measured.stuck & ~decisions.away(measured)
        calm = calm & ~decisions.creeps(memory) & ~decisions.jams(memory)
        goes = calm & ~decisions.far(measured, memory) & ~worthless
        following = jnp.where(goes & (count < orders.most), _STEP, _END)
        following = jnp.where(change > RENEW, jnp.where(worthless, _END, _RESCALE), following)
        return _Course(slopes, measured, memory, count, worthless, goes, fresh, row, following)

    first = jnp.where(orders.look, _LOOK, jnp.where(orders.most > 0, _STEP, _END))
    no = jnp.zeros((), bool)
    none = jnp.zeros((), int)
    begin = _Course(slopes, state, memory, none, no, no, state.scales, none, first)
    found = jax.lax.while_loop(lambda own: own.following != _END, ahead, begin)
    return Stride(*found[:-3], decisions.signs(found.state, found.memory))
