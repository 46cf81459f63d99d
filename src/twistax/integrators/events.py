"""Conditions that end an integration where they become zero, and the bracketed root where they do."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import callable_with, real_array
from ..errors import InputError, ModelError
from ..expr import (
    Constant,
    Expr,
    Inputs,
    Leaf,
    Max,
    Min,
    Neg,
    Parameter,
    Sub,
    Time,
    canonicalize_all,
    evaluate_all,
    leaves_of,
)
from ..expr.margins import margin
from ..jax_inside import is_traced, is_tracing
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from ..lowering.inputs import need_held
from .bracket import Bracket
from .charts import Blocks
from .controls import Signals
from .kernels import beside, opened
from .method import Stepper
from .rows import put
from .run import Part, Result, Run, Saved, Trail, Watched
from .steps import Steps

#: A step from a stored state: of its time, the state and a length.
Advance: TypeAlias = Callable[[jax.Array, Any, jax.Array], Any]

#: A value at the start or the end of an integration counts as zero where it is this many units of round-off, or less,
#: of the one at the other end of the step.
_HAIR = 1e3


@dataclasses.dataclass(frozen=True)
class Event:
    """An integration ends where the condition becomes zero: `tx.integrate(..., event=tx.Event(condition))`.

    A step during which the sign of the condition changes is taken again up to the root, in its group and to round-off
    of the time. Two roots within one step are not seen: `tx.StepControl(dtmax=...)` or dt must be shorter than the time
    between them. A condition that is zero at the start, up to round-off, is no event until it has been something else;
    one that is zero at the end, up to round-off, is. Where it is NaN it has no sign.

    Attributes:
        condition: an expression of shape (): a number; or a condition, which ends it where it begins to hold: where
            a - b falls through zero, for a < b and a <= b alike. Or a traceable function f(t, x, u, params) -> ();
            a function is part of the compiled program: another one compiles again.
        direction: None: any root; True or 1: only where the condition rises; False or -1: only where it falls. The
            number 0, which other programs read as any root, is refused.

    Raises:
        ModelError: a condition that is neither, or of another shape; another direction, or one for what is true or
            false, which says itself where it holds.
    """

    condition: Any
    direction: Any = None

    def __post_init__(self) -> None:
        if isinstance(self.condition, Expr):
            shape = self.condition.check_shape()
            if self.condition.boolean and shape == ():
                self._take_condition(self.condition)
            if shape != ():
                raise ModelError(f"Event expects a condition of shape (), got {shape}: {self.condition!r}")
        else:
            callable_with("Event, of no expression,", self.condition, ["t", "x", "u", "params"], ModelError)
        if not (isinstance(self.direction, bool) or self.direction in (None, 1, -1)):
            raise ModelError(
                f"Event: direction must be None (any), True (rising) or False (falling), got {self.direction!r}"
            )

    def _take_condition(self, condition: Expr) -> None:
        if self.direction is not None:
            raise ModelError(
                f"Event: {condition!r} says itself on which side it holds, got direction={self.direction!r} too.\n"
                "  fix: leave the direction out; ~(condition) is the event where it ceases to hold"
            )
        object.__setattr__(self, "condition", margin("Event", condition))
        object.__setattr__(self, "direction", False)

    @property
    def sense(self) -> int:
        """1, -1, or 0 for both."""
        return 0 if self.direction is None else 1 if self.direction == 1 else -1


@dataclasses.dataclass(frozen=True)
class _OfExpression:
    """An expression as a condition, whose levels are inputs. A value: equal where the expressions are."""

    key: Any
    expr: Expr = dataclasses.field(compare=False)

    def __call__(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays, *levels: Any) -> jax.Array:
        own = {_level(number): jnp.asarray(value) for number, value in enumerate(levels)}
        inputs = Inputs(t, x, u, {**params, **own}, t.dtype)
        (value,) = evaluate_all([self.expr], lambda leaf: leaf.read(inputs))
        return value


def _level(number: int) -> str:
    """What a number that a condition is compared with is called as an input."""
    return f"level {number} of an event"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Watch:
    """The conditions of an integration. A pytree: functions and directions are structure."""

    functions: tuple[Any, ...] = dataclasses.field(metadata={"static": True})  # f(t, x, u, params, *inputs) each
    senses: tuple[int, ...] = dataclasses.field(metadata={"static": True})  # 1, -1, or 0 for both, each
    inputs: Any  # traced values the functions used to close over, so that derivatives find them

    def values(self, stepper: Stepper, start: jax.Array, h: jax.Array, t: jax.Array, y: Any) -> jax.Array:
        """(m,) the conditions at a time and a stored state, within the step of length h from start."""
        start, h, t = stepper.clock(start), stepper.clock(h), stepper.clock(t)
        x, u = stepper.stored.value(opened(y)), stepper.field(start, h).controls(t)
        found = [f(t, x, u, stepper.params, *own) for f, own in zip(self.functions, self.inputs, strict=True)]
        return jnp.stack([jnp.asarray(value, t.dtype) for value in found])

    def begin(self, advance: Advance, stepper: Stepper, t: jax.Array, h: jax.Array, y: Any) -> Watched:
        """At the start of an integration whose first step is about h.

        The sign that counts is the one just after: where it goes on from an event, that at the start is noise.
        """
        eps = float(jnp.finfo(t.dtype).eps)
        s = jnp.maximum(eps**0.5 * h, 64.0 * eps * jnp.abs(t))
        moved = advance(t, y, s)

        return beside(Watch._before, self, stepper, t, y, s, moved)

    def _before(self, stepper: Stepper, t: jax.Array, y: Any, s: jax.Array, moved: Any) -> Watched:
        """At the start, which is followed by `moved` a moment s later: the first step may end at a row before h."""
        now, soon = self.values(stepper, t, s, t, y), self.values(stepper, t, s, t + s, moved)
        values = jnp.where(jnp.sign(now) * jnp.sign(soon) < 0.0, soon, now)
        return Watched(values, jnp.zeros(values.shape, bool), values)

    def _narrowed(
        self, stepper: Stepper, t: jax.Array, h: jax.Array, moved: Any, number: jax.Array, now: Bracket
    ) -> Bracket:
        """The bracket of the root of one condition, after the step from t to its place was taken."""
        return now.narrowed(self.values(stepper, t, h, t + now.place, moved)[number])

    def after(
        self, stepper: Stepper, t: jax.Array, h: jax.Array, y: Any, before: Watched, first: Any, last: Any
    ) -> Watched:
        """Values at the end y of a step from t, and which became zero on the way. Zero at the end counts."""
        now = self.values(stepper, t, h, t + h, y)
        hair = _HAIR * float(jnp.finfo(now.dtype).eps)
        sizes = jnp.abs(before.values), jnp.abs(now)
        old = jnp.where(first & (sizes[0] <= hair * sizes[1]), 0.0, before.values)
        now = jnp.where(last & (sizes[1] <= hair * sizes[0]), 0.0, now)
        wanted = jnp.asarray(self.senses)
        falls, rises = (old > 0.0) & (now <= 0.0), (old < 0.0) & (now >= 0.0)
        hits = (falls & (wanted <= 0)) | (rises & (wanted >= 0))
        now = jnp.where(jnp.isnan(now), before.values, now)
        return Watched(now, hits, now)


def watch_of(dynamics: Dynamics, event: Any, start: Inputs, signals: Signals) -> tuple[Watch, list[Any]]:
    """The conditions that `integrate` was given, and values of functions at the start that are traced.

    What was checked once is not checked again. Raises InputError and ModelError.
    """
    events: Sequence[Any] = [event] if isinstance(event, Event) else event
    if not isinstance(events, (list, tuple)) or not events or not all(isinstance(e, Event) for e in events):
        raise InputError(f"event expects tx.Event(condition), or a list of them, got {event!r}")
    loops, functions, inputs, values = dynamics._functions.loops, [], [], []

    def value_of(number: int, function: Any) -> tuple[jax.Array, Any]:
        t, x, params = jax.tree.map(jnp.asarray, (start.t, dict(start.x), dict(start.params)))
        arguments = (t, x, signals.during(dynamics, t, jnp.zeros_like(t))(t), params)
        found = function(*arguments)
        value = jnp.asarray(real_array(f"the result of event {number}", found))
        if value.shape != () or not jnp.issubdtype(jnp.result_type(found), jnp.floating):
            raise InputError(
                f"the condition of event {number} must return one real number, got shape {value.shape} of "
                f"{jnp.result_type(found)}"
            )
        return value, arguments

    for number, own in enumerate(events):
        condition = own.condition
        closed: tuple[Any, ...] = ()
        if isinstance(condition, Expr):
            found = loops.get((watch_of, condition.key()), functools.partial(_of_expression, dynamics, condition))
            condition, levels = found[0], tuple(map(np.asarray, found[1]))
            for level in levels:
                need_held("what an event compares with", level, start.dtype)
            closed = tuple(level.astype(start.dtype) for level in levels)
        elif is_tracing():
            value, arguments = value_of(number, condition)
            if is_traced(value):
                # Of the function itself only where it closes over traced values; else it would compile again.
                converted, held = jax.closure_convert(condition, *arguments)
                if held:
                    condition, closed = converted, tuple(held)
            values.append(value)
        else:
            key = (watch_of, condition, np.dtype(start.dtype))
            loops.get(key, functools.partial(value_of, number, condition))
        functions.append(condition)
        inputs.append(closed)
    return Watch(tuple(functions), tuple(e.sense for e in events), tuple(inputs)), values


def _of_expression(dynamics: Dynamics, condition: Expr) -> tuple[_OfExpression, list[Any]]:
    """An expression that the system can evaluate, and the numbers it is compared with: others compile nothing.

    Raises:
        ModelError: it reads what the system does not have.
    """
    known = {leaf.key() for leaf in (*dynamics.states, *dynamics.controls, *dynamics.parameters)}
    for leaf in leaves_of(condition):
        if isinstance(leaf, Leaf) and not isinstance(leaf, (Constant, Time)) and leaf.key() not in known:
            baked = " (a baked parameter is no input any more)" if isinstance(leaf, Parameter) else ""
            raise ModelError(
                f"the event {condition!r} reads {type(leaf).__name__} {leaf.name!r}, which the compiled system "
                f"does not have{baked}"
            )
    levels: list[Any] = []

    def opened(expr: Expr) -> Expr:
        if isinstance(expr, (Max, Min, Neg)):
            return type(expr)(*map(opened, expr.children()))
        if not isinstance(expr, Sub):
            return expr
        return Sub(*map(as_input, expr.children()))

    def as_input(side: Expr) -> Expr:
        if not isinstance(side, Constant) or side.shape != ():
            return side
        levels.append(side.value)
        return Parameter(_level(len(levels) - 1))

    # As it is written first: of h - 0 and of (h + 5) - 0 the simplified forms have no level.
    form = opened(condition)
    if not levels:
        form = opened(*canonicalize_all([condition]))
    (expr,) = canonicalize_all([form])
    return _OfExpression(expr.key(), expr), levels


# ---- where in its last step an integration meets an event, and what becomes of it then -----------------------------


class Meeting(NamedTuple):
    """Where an integration meets an event."""

    met: jax.Array  # whether it does
    which: jax.Array  # the number of the event; -1 for none
    s: jax.Array  # how far into the step from where the loop halted; zero for none
    t: jax.Array  # the start of that step
    evaluations: jax.Array  # of the right-hand side, to find it


def locate(steps: Steps, stepper: Stepper, seen: Watched, run: Run) -> Meeting:
    """The first root in the step that a loop halted before. Traceable, not differentiable."""
    watch: Watch = steps.watch
    outcome = run.outcome
    t, h = outcome.t, outcome.h
    met = outcome.code == Result.EVENT.value
    finest = float(jnp.finfo(t.dtype).eps) * jnp.maximum(jnp.abs(t), jnp.abs(t + h))

    def root(_: None, entry: tuple[jax.Array, Watched]) -> tuple[None, tuple[jax.Array, jax.Array]]:
        number, (before, hit, after) = entry

        def narrowed(now: Bracket) -> Bracket:
            moved = steps.advance(stepper, run.carry, t, run.end, now.place)
            return beside(Watch._narrowed, watch, stepper, t, h, moved, number, now)

        start = Bracket.between(jnp.zeros_like(h), h, before, after, finest)
        start = start._replace(done=start.done | ~(met & hit))
        end = jax.lax.while_loop(lambda now: ~now.done, narrowed, start)
        return None, (jnp.where(met & hit, end.root, jnp.inf), end.tries)

    _, (roots, tries) = jax.lax.scan(root, None, (jnp.arange(seen.values.size), seen))
    which = jnp.argmin(roots)
    cost = (tries.sum() + met.astype(int)) * stepper.method.evaluations_of(stepper.dynamics)
    return Meeting(met, jnp.where(met, which, -1), jnp.where(met, roots[which], 0.0), t, cost)


def refined(stepper: Stepper, watch: Watch, y: Blocks, h: jax.Array, meeting: Meeting) -> Meeting:
    """The same meeting, whose root moves as the condition does with all inputs: by the implicit function theorem."""
    which = jnp.maximum(meeting.which, 0)

    def value(s: jax.Array) -> jax.Array:
        values = watch.values(stepper, meeting.t, h, meeting.t + s, stepper.advance(meeting.t, y, s))
        return jnp.where(meeting.met, values[which], s)

    root = jax.lax.custom_root(
        value,
        jax.lax.stop_gradient(meeting.s),
        lambda function, known: known,
        lambda slope, change: change / slope(jnp.ones_like(change)),
    )
    return meeting._replace(s=root)


def to_event(advance: Advance, run: Run, meeting: Meeting) -> Any:
    """The state at the event, or where the loop came to its end."""
    return jax.lax.cond(meeting.met, lambda y: advance(meeting.t, y, meeting.s), lambda y: y, run.end)


def cut_at(moved: Blocks, run: Run, meeting: Meeting) -> Run:
    """A run that halted before a step, taken on to the event within it, where the state is `moved`."""
    met, s, outcome = meeting.met, meeting.s, run.outcome
    one = met.astype(outcome.accepted.dtype)
    t = jnp.where(met, meeting.t + s, outcome.t)
    trail = run.trail
    if trail is not None:
        last = trail.steps + one
        trail = Trail(trail.t.at[last].set(jnp.where(met, t, trail.t[last])), put(trail.y, last, moved), last)
    evaluations = outcome.evaluations + meeting.evaluations
    outcome = outcome._replace(t=t, tried=outcome.tried + one, accepted=outcome.accepted + one, evaluations=evaluations)
    return run._replace(end=moved, outcome=outcome, trail=trail)


def saved_before(saved: Saved, parts: Part, ts: jax.Array, run: Run, meeting: Meeting) -> tuple[Saved, Part]:
    """Saved times in the last step taken from its start, those after the event not reached; the run is as it halted."""
    within = meeting.met & (ts > meeting.t) & (ts <= meeting.t + meeting.s)
    reached = jnp.where(meeting.met, saved.asked & (ts <= meeting.t + meeting.s), saved.reached)

    def pick(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(within.reshape(within.shape + (1,) * new.ndim), new[None], old)

    ys = jax.tree.map(pick, run.end, saved.y)
    steps = pick(run.outcome.accepted, saved.steps)
    h = jnp.where(within, ts - meeting.t, jnp.where(reached, parts.h, 0.0))
    saved = Saved(steps, pick(meeting.t, saved.t), ys, reached, saved.asked)
    return saved, Part(pick(meeting.t, parts.t), h)
