"""Where in its last step a flight meets an event, and what becomes of it then."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from .charts.whole import Blocks
from .course import Flown, Part, Saved, Trail
from .events import Watch
from .result import Result
from .root import bracketed_root
from .rows import put
from .stepper import Stepper

__all__ = ["Meeting", "cut_at", "locate", "refined", "saved_before"]


class Meeting(NamedTuple):
    """Where a flight meets an event.

    Attributes:
        met: whether it does.
        which: the number of the event; -1 for none.
        s: how far into the step from where the flight halted; zero for none.
        t: the start of that step.
        evaluations: of the right-hand side, to find it.
    """

    met: jax.Array
    which: jax.Array
    s: jax.Array
    t: jax.Array
    evaluations: jax.Array


def locate(stepper: Stepper, watch: Watch, flown: Flown) -> Meeting:
    """The first root in the step that a course halted before. Traceable, not differentiable."""
    (values, hits), outcome = _watched(flown), flown.outcome
    t, h = outcome.t, outcome.h
    met = outcome.code == Result.EVENT.value
    finest = float(jnp.finfo(t.dtype).eps) * jnp.maximum(jnp.abs(t), jnp.abs(t + h))

    def root(_: None, entry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[None, tuple[jax.Array, jax.Array]]:
        number, before, hit = entry

        def value(s: jax.Array) -> jax.Array:
            return watch.values(stepper, t, h, t + s, stepper.advance(t, flown.end, s))[number]

        def search() -> tuple[jax.Array, jax.Array]:
            return bracketed_root(value, jnp.zeros_like(h), h, before, finest)

        return None, jax.lax.cond(met & hit, search, lambda: (jnp.full_like(h, jnp.inf), jnp.zeros((), int)))

    _, (roots, tries) = jax.lax.scan(root, None, (jnp.arange(values.size), values, hits))
    which = jnp.argmin(roots)
    cost = (tries.sum() + met.astype(int)) * stepper.method.evaluations_of(stepper.dynamics)
    return Meeting(met, jnp.where(met, which, -1), jnp.where(met, roots[which], 0.0), t, cost)


def refined(stepper: Stepper, watch: Watch, y: Blocks, h: jax.Array, meeting: Meeting) -> Meeting:
    """The same meeting as a function of all inputs: its root moves as the condition does.

    By the implicit function theorem, ds = -(d condition) / (d condition / ds), to any order.
    """
    which = jnp.maximum(meeting.which, 0)

    def value(s: jax.Array) -> jax.Array:
        values = watch.values(stepper, meeting.t, h, meeting.t + s, stepper.advance(meeting.t, y, s))
        return jnp.where(meeting.met, values[which], s)

    def known(function: Callable[[jax.Array], jax.Array], s: jax.Array) -> jax.Array:
        return s

    def solved(slope: Callable[[jax.Array], jax.Array], change: jax.Array) -> jax.Array:
        return change / slope(jnp.ones_like(change))

    return meeting._replace(s=jax.lax.custom_root(value, jax.lax.stop_gradient(meeting.s), known, solved))


def cut_at(stepper: Stepper, flown: Flown, meeting: Meeting) -> Flown:
    """A flight that halted before a step, flown on to the event within it."""
    met, s, outcome = meeting.met, meeting.s, flown.outcome
    moved = jax.lax.cond(met, lambda y: stepper.advance(meeting.t, y, s), lambda y: y, flown.end)
    one = met.astype(outcome.accepted.dtype)
    t = jnp.where(met, meeting.t + s, outcome.t)
    trail = flown.trail
    if trail is not None:
        last = trail.steps + one
        trail = Trail(trail.t.at[last].set(jnp.where(met, t, trail.t[last])), put(trail.y, last, moved), last)
    outcome = outcome._replace(
        t=t,
        tried=outcome.tried + one,
        accepted=outcome.accepted + one,
        evaluations=outcome.evaluations + meeting.evaluations,
    )
    return flown._replace(end=moved, outcome=outcome, trail=trail)


def saved_before(saved: Saved, parts: Part, ts: jax.Array, flown: Flown, meeting: Meeting) -> tuple[Saved, Part]:
    """Saved times, those within the last step taken from its start, those after the event not reached.

    Args:
        ts: (n,) the saved times.
        flown: the flight as the course left it, before the step with the event.
    """
    within = meeting.met & (ts > meeting.t) & (ts <= meeting.t + meeting.s)
    reached = jnp.where(meeting.met, ts <= meeting.t + meeting.s, saved.reached)

    def pick(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(within.reshape(within.shape + (1,) * new.ndim), new[None], old)

    ys = jax.tree.map(pick, flown.end, saved.y)
    steps = pick(flown.outcome.accepted, saved.steps)
    h = jnp.where(within, ts - meeting.t, jnp.where(reached, parts.h, 0.0))
    return Saved(steps, pick(meeting.t, saved.t), ys, reached), Part(pick(meeting.t, parts.t), h)


def _watched(flown: Flown) -> tuple[jax.Array, jax.Array]:
    assert flown.watched is not None  # a course with a watch says what it saw
    return flown.watched.values, flown.watched.hits
