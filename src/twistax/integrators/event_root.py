"""Where in its last step an integration meets an event, by a bracketed root, and what becomes of it then."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from .charts.coordinates import Blocks
from .events import Watch
from .method import Stepper
from .solution import Result
from .steps import Part, Run, Saved, Trail, put

__all__ = ["Meeting", "bracketed_root", "cut_at", "locate", "refined", "saved_before"]


class Meeting(NamedTuple):
    """Where an integration meets an event.

    Attributes:
        met: whether it does.
        which: the number of the event; -1 for none.
        s: how far into the step from where the loop halted; zero for none.
        t: the start of that step.
        evaluations: of the right-hand side, to find it.
    """

    met: jax.Array
    which: jax.Array
    s: jax.Array
    t: jax.Array
    evaluations: jax.Array


def locate(stepper: Stepper, watch: Watch, run: Run) -> Meeting:
    """The first root in the step that a loop halted before. Traceable, not differentiable."""
    assert run.watched is not None  # a loop with conditions says what it saw
    (values, hits), outcome = run.watched, run.outcome
    t, h = outcome.t, outcome.h
    met = outcome.code == Result.EVENT.value
    finest = float(jnp.finfo(t.dtype).eps) * jnp.maximum(jnp.abs(t), jnp.abs(t + h))

    def root(_: None, entry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[None, tuple[jax.Array, jax.Array]]:
        number, before, hit = entry

        def value(s: jax.Array) -> jax.Array:
            return watch.values(stepper, t, h, t + s, stepper.advance(t, run.end, s))[number]

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


def cut_at(stepper: Stepper, run: Run, meeting: Meeting) -> Run:
    """A run that halted before a step, taken on to the event within it."""
    met, s, outcome = meeting.met, meeting.s, run.outcome
    moved = jax.lax.cond(met, lambda y: stepper.advance(meeting.t, y, s), lambda y: y, run.end)
    one = met.astype(outcome.accepted.dtype)
    t = jnp.where(met, meeting.t + s, outcome.t)
    trail = run.trail
    if trail is not None:
        last = trail.steps + one
        trail = Trail(trail.t.at[last].set(jnp.where(met, t, trail.t[last])), put(trail.y, last, moved), last)
    outcome = outcome._replace(
        t=t,
        tried=outcome.tried + one,
        accepted=outcome.accepted + one,
        evaluations=outcome.evaluations + meeting.evaluations,
    )
    return run._replace(end=moved, outcome=outcome, trail=trail)


def saved_before(saved: Saved, parts: Part, ts: jax.Array, run: Run, meeting: Meeting) -> tuple[Saved, Part]:
    """Saved times, those within the last step taken from its start, those after the event not reached.

    Args:
        ts: (n,) the saved times.
        run: as the loop left it, before the step with the event.
    """
    within = meeting.met & (ts > meeting.t) & (ts <= meeting.t + meeting.s)
    reached = jnp.where(meeting.met, ts <= meeting.t + meeting.s, saved.reached)

    def pick(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(within.reshape(within.shape + (1,) * new.ndim), new[None], old)

    ys = jax.tree.map(pick, run.end, saved.y)
    steps = pick(run.outcome.accepted, saved.steps)
    h = jnp.where(within, ts - meeting.t, jnp.where(reached, parts.h, 0.0))
    return Saved(steps, pick(meeting.t, saved.t), ys, reached), Part(pick(meeting.t, parts.t), h)


# ---- the root -----------------------------------------------------------------------------------------------------

#: More evaluations than halving a bracket down to the smallest number that matters would take.
_MOST = 120


class _Bracket(NamedTuple):
    """The last place tried, the other end of the bracket, the place before, with their values, and the next share."""

    a: tuple[jax.Array, jax.Array]
    b: tuple[jax.Array, jax.Array]
    c: tuple[jax.Array, jax.Array]
    share: jax.Array
    tries: jax.Array


def bracketed_root(
    function: Callable[[jax.Array], jax.Array], low: jax.Array, high: jax.Array, at_low: jax.Array, finest: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The root between low and high, to `finest`, and the number of evaluations. Traceable.

    Halves the bracket, or interpolates where that is known to be safe. A zero counts as past the root, NaN
    as before it, so of many zeros in a row the first is found. Where the signs at the two ends are the same,
    because of round-off, the root is at the end with the smaller value; where at_low is zero it is low.

    Source: Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function
    without using derivatives (1997).
    """
    past = -jnp.sign(at_low) * float(jnp.finfo(at_low.dtype).tiny)

    def signed(x: jax.Array) -> jax.Array:
        value = function(x)
        return jnp.where(jnp.isnan(value), at_low, jnp.where(value == 0.0, past, value))

    at_high = signed(high)

    def best(now: _Bracket) -> tuple[jax.Array, jax.Array]:
        first = jnp.abs(now.a[1]) < jnp.abs(now.b[1])
        return jnp.where(first, now.a[0], now.b[0]), jnp.where(first, now.a[1], now.b[1])

    def unsolved(now: _Bracket) -> jax.Array:
        apart = jnp.sign(now.a[1]) * jnp.sign(now.b[1]) < 0.0
        return apart & (jnp.abs(now.b[0] - now.a[0]) > 2.0 * finest) & (now.tries < _MOST)

    def narrow(now: _Bracket) -> _Bracket:
        (a, fa), (b, fb) = now.a, now.b
        x = a + now.share * (b - a)
        fx = signed(x)
        same = jnp.sign(fx) == jnp.sign(fa)
        # What the new place replaces becomes the third one.
        c, fc = jnp.where(same, a, b), jnp.where(same, fa, fb)
        b, fb = jnp.where(same, b, a), jnp.where(same, fb, fa)
        a, fa = x, fx
        width = jnp.where(b == a, 1.0, jnp.abs(b - a))
        xi, phi = (a - b) / _nonzero(c - b), (fa - fb) / _nonzero(fc - fb)
        safe = (phi * phi < xi) & ((1.0 - phi) * (1.0 - phi) < 1.0 - xi)
        quadratic = fa / _nonzero(fb - fa) * (fc / _nonzero(fb - fc)) + (c - a) / _nonzero(b - a) * (
            fa / _nonzero(fc - fa)
        ) * (fb / _nonzero(fc - fb))
        edge = jnp.minimum(finest / width, 0.5)
        share = jnp.clip(jnp.where(safe, quadratic, 0.5), edge, 1.0 - edge)
        return _Bracket((a, fa), (b, fb), (c, fc), share, now.tries + 1)

    half, none = jnp.full_like(low, 0.5), jnp.zeros((), int)
    start = _Bracket((high, at_high), (low, at_low), (low, at_low), half, none)
    end = jax.lax.while_loop(unsolved, narrow, start)
    return best(end)[0], end.tries + 1


def _nonzero(a: jax.Array) -> jax.Array:
    return jnp.where(a == 0.0, 1.0, a)
