"""An integration that an event ends within a step: the state at the event, saved times before it, and derivatives."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ..charts.coordinates import Blocks
from ..loop.loop import put
from ..loop.outcome import Result, Run, Saved, StepPart, Trail
from ..method import Stepper
from .conditions import EventConditions
from .crossings import Crossed


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Meeting:
    """The location at which an event ends an integration."""

    met: Any  # whether it does, or a crossing for which there is no room
    which: Any  # the number of the event; -1 for none
    s: Any  # how far into the step from where the loop halted; zero for none
    t: Any  # the start of that step
    ends: Any  # whether it is an event that ends it

    @classmethod
    def of(cls, run: Run) -> Meeting:
        """The meeting of a loop that halted before its step."""
        assert run.event_state is not None
        code, which, s = run.event_state.halt
        met = (run.outcome.code == code) & (code != Result.SUCCESS.value)
        ends = met & (code == Result.EVENT.value)
        return cls(met, jnp.where(met, which, -1), jnp.where(met, s, 0.0), run.outcome.t, ends)

    @property
    def event(self) -> jax.Array:
        """The number of the event that ends it; -1 for none."""
        return jnp.where(self.ends, self.which, -1)


def refined(stepper: Stepper, events: EventConditions, y: Blocks, h: jax.Array, meeting: Meeting) -> Meeting:
    """The location with a root that is differentiable with respect to all inputs, by the implicit function theorem."""
    which = jnp.maximum(meeting.which, 0)

    # At the start of the integration it stays.
    differentiable = meeting.met & (jax.lax.stop_gradient(meeting.s) > 0.0)

    def value(s: jax.Array) -> jax.Array:
        values = events.values(stepper, meeting.t, h, meeting.t + s, stepper.advance(meeting.t, y, s))
        return jnp.where(differentiable, values[which], s)

    root = jax.lax.custom_root(
        value,
        jax.lax.stop_gradient(meeting.s),
        lambda function, known: known,
        lambda slope, change: change / slope(jnp.ones_like(change)),
    )
    return dataclasses.replace(meeting, s=root)


def to_event(advance: Callable[[jax.Array, Blocks, jax.Array], Blocks], end: Blocks, meeting: Meeting) -> Blocks:
    """The state at the event, or where the loop came to its end, by one more step from there."""
    on = meeting.met & (jax.lax.stop_gradient(meeting.s) > 0.0)
    state: Blocks = jax.lax.cond(on, lambda y: advance(meeting.t, y, meeting.s), lambda y: y, end)
    return state


def cut_at(moved: Blocks, run: Run, meeting: Meeting) -> Run:
    """A run that halted before a step, continued to the event within it, where the state is `moved`."""
    met, s, outcome = meeting.met, meeting.s, run.outcome
    one = (met & (jax.lax.stop_gradient(s) > 0.0)).astype(outcome.accepted.dtype)
    t = jnp.where(met, meeting.t + s, outcome.t)
    trail = run.trail
    if trail is not None:
        last = trail.steps + one
        trail = Trail(trail.t.at[last].set(jnp.where(met, t, trail.t[last])), put(trail.y, last, moved), last)
    outcome = dataclasses.replace(outcome, t=t, tried=outcome.tried + one, accepted=outcome.accepted + one)
    return dataclasses.replace(run, end=moved, outcome=outcome, trail=trail)


def saved_before(saved: Saved, parts: StepPart, ts: jax.Array, run: Run, meeting: Meeting) -> tuple[Saved, StepPart]:
    """Saved times in the last step, by shorter steps from its start; times after the event are not reached."""
    within = meeting.met & (ts > meeting.t) & (ts <= meeting.t + meeting.s)
    reached = jnp.where(meeting.met, saved.requested & (ts <= meeting.t + meeting.s), saved.reached)

    def pick(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(within.reshape(within.shape + (1,) * new.ndim), new[None], old)

    ys = jax.tree.map(pick, run.end, saved.y)
    steps = pick(run.outcome.accepted, saved.steps)
    h = jnp.where(within, ts - meeting.t, jnp.where(reached, parts.h, 0.0))
    saved = Saved(steps, pick(meeting.t, saved.t), ys, reached, saved.requested)
    return saved, StepPart(pick(meeting.t, parts.t), h)


def refined_rows(stepper: Stepper, events: EventConditions, crossed: Crossed) -> Crossed:
    """Crossings whose times are differentiable in all inputs; y is the state at the starts of their steps."""

    def one(row: Crossed) -> jax.Array:
        meeting = Meeting(row.which >= 0, row.which, row.s, row.t, row.which >= 0)
        return refined(stepper, events, row.y, row.h, meeting).s

    return dataclasses.replace(crossed, s=jax.lax.map(one, crossed))
