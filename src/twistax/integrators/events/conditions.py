"""Events: their conditions, evaluated at the start and along each step."""

from __future__ import annotations

import dataclasses
import enum
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import callable_with, instance, real_array, whole
from ...errors import InputError, ModelError
from ...expr import (
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
from ...expr.operations.margins import margin
from ...jax_inside import is_traced, is_tracing
from ...system.dynamics import Arrays, Dynamics
from ...system.inputs import need_representable
from ..controls import Signals
from ..loop.kernels import Packed, opened, shared_kernel
from ..loop.outcome import EventState, Halt, Result
from ..method import Stepper
from .crossings import CrossingTable

#: A function from a length to the packed state after a step of that length from the start of the current step.
Advance: TypeAlias = Callable[[jax.Array], Packed]

#: A condition at the start counts as zero if it is smaller than its change over a short time, times this power of the
#: machine epsilon,
_HAIR = 0.3
#: or if it becomes zero within this many units of round-off of the time.
_HAIR_OF_TIME = 16.0
#: At the end it counts as zero up to this many units of round-off of its value at the start of the last step.
_HAIR_AT_END = 64.0
#: The number of places within a step at which conditions are evaluated on its polynomial.
_PLACES = 7
#: The default of `max_crossings`.
_ROOM = 128


class AtStart(enum.Enum):
    """The treatment of an event whose condition is zero at the start, or has already crossed zero there.

    "Already crossed" means that the condition is on the side of zero that the event's `direction` leads to. Zero means
    zero up to round-off. For every choice, `Solution.at_start` records for which events this was the case.
    """

    #: The event occurs at the start, and ends the integration immediately. It does not if the condition is zero and
    #: moves to the opposite side immediately afterwards: a body that takes off has not landed.
    STOP = "met at the start"
    #: The event occurs at the start only if the condition is zero there and crosses zero immediately afterwards, in the
    #: direction of the event. An event without direction does not occur.
    CROSSING = "met where it crosses zero there"
    #: The event does not occur until the condition has been on the other side of zero.
    IGNORE = "not met"


@dataclasses.dataclass(frozen=True)
class Event:
    """An event: by default the integration ends where its condition becomes zero,
    `tx.integrate(..., event=tx.Event(condition))`.

    A step during which the sign of the condition changes is repeated up to the root, in its group and to round-off of
    the time. Two roots within a step are detected too: the condition is evaluated at seven points on the interpolating
    polynomial of the step, or for methods without one at three points by shorter steps. If a parabola through three
    values comes near zero, its extremum is located. So two roots within one step are detected unless the condition has
    several extrema within an eighth of the step. A condition that is zero at the end, up to round-off, is an event. A
    condition that is NaN has no sign. In a backward integration, a condition rises if it increases along the
    integration.

    Attributes:
        condition: an expression of shape (), whose zeros are events; or a comparison, whose event is the point where it
            becomes true: where a - b crosses zero from above, for both a < b and a <= b. It may also be a traceable
            function f(t, x, u, params) -> (), which becomes part of the compiled program: another function recompiles.
        direction: None: any root; True or 1: only roots at which the condition rises; False or -1: only roots at which
            it falls. The number 0, which means any root in other programs, raises an error.
        terminal: True: the integration ends there. False: it continues, and `Solution.crossings` has the time, the
            state and the direction of each crossing.
        at_start: an `AtStart`. The default is STOP for comparisons and CROSSING for expressions.
            Use `AtStart.IGNORE` to continue after an event that ended an integration.

    Raises:
        ModelError: a condition of another type or shape; an invalid direction, or a direction for a comparison, which
            determines it; an invalid `terminal` or `at_start`.
    """

    condition: Any
    direction: Any = None
    terminal: bool = True
    at_start: Any = None

    def __post_init__(self) -> None:
        if not isinstance(self.terminal, bool):
            raise ModelError(f"Event: terminal must be True or False, got {self.terminal!r}")
        instance(
            "Event: at_start", self.at_start, AtStart | None, "a tx.AtStart, such as tx.AtStart.IGNORE", ModelError
        )
        begins = AtStart.CROSSING
        if isinstance(self.condition, Expr):
            shape = self.condition.check_shape()
            if self.condition.boolean and shape == ():
                self._take_condition(self.condition)
                begins = AtStart.STOP
            if shape != ():
                raise ModelError(f"Event expects a condition of shape (), got {shape}: {self.condition!r}")
        else:
            callable_with("Event, of no expression,", self.condition, ["t", "x", "u", "params"], ModelError)
        if not (isinstance(self.direction, bool) or self.direction in (None, 1, -1)):
            raise ModelError(
                f"Event: direction must be None (any), True (rising) or False (falling), got {self.direction!r}"
            )
        if self.at_start is None:
            object.__setattr__(self, "at_start", begins)

    def _take_condition(self, condition: Expr) -> None:
        if self.direction is not None:
            raise ModelError(
                f"Event: {condition!r} is a comparison, which has a direction, got direction={self.direction!r} too.\n"
                "  fix: leave the direction out; ~(condition) is the event at which the comparison becomes false"
            )
        object.__setattr__(self, "condition", margin("Event", condition))
        object.__setattr__(self, "direction", False)

    @property
    def sense(self) -> int:
        """The direction of roots: 1 rising, -1 falling, 0 both."""
        return 0 if self.direction is None else 1 if self.direction == 1 else -1


@dataclasses.dataclass(frozen=True)
class _OfExpression:
    """An expression as a condition, with the numbers that it is compared with as inputs. Equal
    for equal expressions.
    """

    key: Any
    expr: Expr = dataclasses.field(compare=False)

    def __call__(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays, *levels: Any) -> jax.Array:
        level_values = {_level(number): jnp.asarray(value) for number, value in enumerate(levels)}
        inputs = Inputs(t, x, u, {**params, **level_values}, t.dtype)
        (value,) = evaluate_all([self.expr], lambda leaf: leaf.read(inputs))
        return value


def _level(number: int) -> str:
    """The name of the input for a number that a condition is compared with."""
    return f"level {number} of an event"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class EventConditions:
    """The conditions of an integration. A pytree: functions and directions are structure."""

    functions: tuple[Any, ...] = dataclasses.field(metadata={"static": True})  # f(t, x, u, params, *inputs) each
    senses: tuple[int, ...] = dataclasses.field(metadata={"static": True})  # 1, -1, or 0 for both, each
    terminal: tuple[bool, ...] = dataclasses.field(metadata={"static": True})  # whether each ends the integration
    at_start: tuple[AtStart, ...] = dataclasses.field(metadata={"static": True})
    room: int = dataclasses.field(metadata={"static": True})  # for so many crossings
    inputs: Any  # traced values the functions used to close over, so that derivatives find them

    def values(self, stepper: Stepper, start: jax.Array, h: jax.Array, t: jax.Array, y: Any) -> jax.Array:
        """(m,) the conditions at a time and a stored state, within the step of length h from start."""
        start, h, t = stepper.clock(start), stepper.clock(h), stepper.clock(t)
        x, u = stepper.stored.value(opened(y)), stepper.field(start, h).controls(t)
        conditions = [
            f(t, x, u, stepper.params, *inputs) for f, inputs in zip(self.functions, self.inputs, strict=True)
        ]
        return jnp.stack([jnp.asarray(value, t.dtype) for value in conditions])

    def begin(self, advance: Advance, stepper: Stepper, t: jax.Array, h: jax.Array, y: Packed) -> EventState:
        """At the start of an integration whose first step is about h.

        The sign immediately after the start is used: if the integration continues from an event, the sign at the start
        is round-off.
        """
        eps = float(jnp.finfo(t.dtype).eps)
        s = jnp.maximum(eps**0.5 * h, 64.0 * eps * jnp.abs(t))
        values, met, code, which, tags, count = shared_kernel(
            EventConditions.before, self, stepper, t, y, s, advance(s)
        )
        none = Halt.none(t)
        halt = Halt(code, which, jnp.where(code != none.code, 0.0, none.s))
        crossed = None
        if not all(self.terminal):
            crossed = CrossingTable.begun(self.room, t, h, y.flat, tags, count)
        return EventState(values, met, halt, y.flat, none.code, crossed)

    def before(self, stepper: Stepper, t: jax.Array, y: Any, s: jax.Array, moved: Any) -> tuple[Any, ...]:
        """The state of the events at the start, from the conditions there and at `moved`, a time s later, which may be
        before h because of a table row.

        Returns:
            (m,) initial values; (m,) whether each condition is zero or past zero; the number of the result, and the
            event that leads to it; (k, 3) tags of crossings, of all k events that do not end the integration, actual
            crossings first; and the number of crossings.
        """
        now, soon = self.values(stepper, t, s, t, y), self.values(stepper, t, s, t + s, moved)
        senses = np.asarray(self.senses, now.dtype)
        # The error of a value by its round-off and that of the time, relative to its change from `now` to `soon`.
        eps = float(jnp.finfo(now.dtype).eps)
        hair = jnp.maximum(eps**_HAIR, _HAIR_OF_TIME * eps * jnp.abs(t) / s)
        zero = (now == 0.0) | (jnp.abs(now) <= hair * jnp.abs(soon - now))
        side = jnp.where(zero, jnp.sign(soon), jnp.sign(now))
        turns = jnp.sign(now) * jnp.sign(soon) < 0.0
        past = (side * senses > 0.0) & ~zero & ~turns
        enters = zero & (side * senses > 0.0)
        leaves = zero & (side * senses < 0.0)
        stops, crosses = (
            np.array([choice is mode for choice in self.at_start]) for mode in (AtStart.STOP, AtStart.CROSSING)
        )
        met = jnp.asarray((stops & (past | zero) & ~leaves) | (crosses & enters))
        # The first step finds a crossing just after the start that counts.
        kept = turns & ~zero & (stops | crosses) & ((senses == 0.0) | (jnp.sign(soon) * senses > 0.0))
        noise = (zero | turns) & ~kept & (soon != 0.0) & ~jnp.isnan(soon)
        rises = jnp.where(side == 0.0, senses, side) > 0.0
        return jnp.where(noise, soon, now), zero | past, *self._begun(met, rises)

    def _begun(self, met: jax.Array, rises: jax.Array) -> tuple[Any, ...]:
        """The result, its event, and crossings, for the events whose condition is zero at the start."""
        none, ends = jnp.zeros((), int), len(self.terminal)
        first = jnp.where(met & np.asarray(self.terminal), np.arange(ends), ends).min()
        code = jnp.where(first < ends, Result.EVENT.value, none)
        passing = [number for number, terminal in enumerate(self.terminal) if not terminal]
        if not passing:
            return code, jnp.where(first < ends, first, -1), None, None
        here, tags = (jnp.stack([a[k] for k in passing]).astype(none.dtype) for a in (met, rises))
        # Row k is the crossing with k others before it.
        before = (here[None] * np.tri(len(passing), k=-1, dtype=int)).sum(1)
        rows = here[None] * (before[None] == np.arange(len(passing))[:, None]).astype(none.dtype)
        which = (rows * np.add(passing, 1)[None]).sum(1) - 1
        overflow = which[self.room] if self.room < len(passing) else none - 1
        code = jnp.where((first == ends) & (overflow >= 0), Result.MAX_CROSSINGS.value, code)
        tags = jnp.stack([0 * which, which, (rows * tags[None]).sum(1)], 1)
        return code, jnp.where(first < ends, first, overflow), tags, here.sum()

    def seen(
        self, stepper: Stepper, t: jax.Array, h: jax.Array, states: tuple[Any, Any, Any], old: jax.Array, ends: Any
    ) -> tuple[jax.Array, jax.Array]:
        """The values of the conditions along a step of length h.

        Args:
            states: the states at both ends of the step, and its slopes; or in their place (k, m) values of the
                conditions at places within it, at equal distances.
            old: (m,) the values where it begins.
            ends: whether it is the first step, and whether it is the last one.
        Returns:
            (k + 2, m) values at places at equal distances, zero at the end where it is zero up to round-off, of NaN the
            value before; the values to go on with.
        """
        y, end, inside = states
        now = self.values(stepper, t, h, t + h, end)
        if not isinstance(inside, jax.Array):
            shares = jnp.asarray(np.arange(1, _PLACES + 1) / (_PLACES + 1), h.dtype)
            start, slopes = opened(y), opened(inside)

            def at(share: jax.Array) -> jax.Array:
                return self.values(stepper, t, h, t + share * h, stepper.between(start, h, slopes, share))

            inside = jax.vmap(at)(shares)
        hair = _HAIR_AT_END * float(jnp.finfo(now.dtype).eps)
        _, last = ends
        high = jnp.where(last & (jnp.abs(now) <= hair * jnp.abs(old)), 0.0, now)
        rows = [old]
        for row in [*inside, high]:
            rows.append(jnp.where(jnp.isnan(row), rows[-1], row))
        return jnp.stack(rows), jnp.where(jnp.isnan(now), old, now)

    def hits(self, values: jax.Array) -> jax.Array:
        """(k + 1, m) whether the condition crosses zero from a place to the next, in its direction. Zero is past it."""
        low, high, wanted = values[:-1], values[1:], np.asarray(self.senses)[None]
        falls, rises = (low > 0.0) & (high <= 0.0), (low < 0.0) & (high >= 0.0)
        return (falls & (wanted <= 0)) | (rises & (wanted >= 0))


def event_conditions(
    dynamics: Dynamics, event: Any, start: Inputs, signals: Signals, max_crossings: Any
) -> tuple[EventConditions, list[Any]]:
    """The conditions in the argument `event` of `integrate`, and traced values of functions at the start.

    Checks are cached. Raises InputError and ModelError for invalid events.
    """
    events: Sequence[Any] = [event] if isinstance(event, Event) else event
    if not isinstance(events, (list, tuple)) or not events or not all(isinstance(e, Event) for e in events):
        raise InputError(f"event expects tx.Event(condition), or a list of them, got {event!r}")
    loops, functions, inputs, values = dynamics.functions.loops, [], [], []

    def value_of(number: int, function: Any) -> tuple[jax.Array, Any]:
        t, x, params = jax.tree.map(jnp.asarray, (start.t, dict(start.x), dict(start.params)))
        arguments = (t, x, signals.during(dynamics, t, jnp.zeros_like(t))(t), params)
        result = function(*arguments)
        value = jnp.asarray(real_array(f"the result of event {number}", result))
        if value.shape != () or not jnp.issubdtype(jnp.result_type(result), jnp.floating):
            raise InputError(
                f"the condition of event {number} must return one real number, got shape {value.shape} of "
                f"{jnp.result_type(result)}"
            )
        return value, arguments

    for number, event_ in enumerate(events):
        condition = event_.condition
        closed: tuple[Any, ...] = ()
        if isinstance(condition, Expr):
            compiled = loops.get(
                (event_conditions, condition.key()), functools.partial(_of_expression, dynamics, condition)
            )
            condition, levels = compiled[0], tuple(map(np.asarray, compiled[1]))
            for level in levels:
                need_representable("what an event compares with", level, start.dtype)
            closed = tuple(level.astype(start.dtype) for level in levels)
        elif is_tracing():
            value, arguments = value_of(number, condition)
            if is_traced(value):
                # Convert only functions that close over traced values: others would compile again.
                converted, closed_over = jax.closure_convert(condition, *arguments)
                if closed_over:
                    condition, closed = converted, tuple(closed_over)
            values.append(value)
        else:
            key = (event_conditions, condition, np.dtype(start.dtype))
            loops.get(key, functools.partial(value_of, number, condition))
        functions.append(condition)
        inputs.append(closed)
    senses, terminal, at_start = zip(*((e.sense, e.terminal, e.at_start) for e in events), strict=True)
    if max_crossings is not None and all(terminal):
        raise InputError(
            "max_crossings applies to events that do not end the integration, but all of these events end it.\n"
            "  fix: leave it out, or tx.Event(condition, terminal=False)"
        )
    room = _ROOM if max_crossings is None else whole("max_crossings", max_crossings)
    return EventConditions(tuple(functions), senses, terminal, at_start, int(room), tuple(inputs)), values


def _of_expression(dynamics: Dynamics, condition: Expr) -> tuple[_OfExpression, list[Any]]:
    """An expression that the system can evaluate, and the numbers that it is compared with, which do not recompile.

    Raises:
        ModelError: it reads a leaf that the system does not have.
    """
    known = {leaf.key() for leaf in (*dynamics.states, *dynamics.controls, *dynamics.parameters)}
    for leaf in leaves_of(condition):
        if isinstance(leaf, Leaf) and not isinstance(leaf, (Constant, Time)) and leaf.key() not in known:
            baked = " (a baked parameter is not an input)" if isinstance(leaf, Parameter) else ""
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

    # First as written: the simplified forms of h - 0 and (h + 5) - 0 have no number to compare with.
    form = opened(condition)
    if not levels:
        form = opened(*canonicalize_all([condition]))
    (expr,) = canonicalize_all([form])
    return _OfExpression(expr.key(), expr), levels
