"""Conditions that end an integration where they become zero."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..errors import InputError, ModelError
from ..expr import Constant, Expr, Inputs, Leaf, Parameter, Time, canonicalize_all, evaluate_all, leaves_of
from ..jax_inside import is_traced
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .charts.coordinates import Blocks
from .controls import Signals
from .method import Stepper

__all__ = ["Event", "Watch", "Watched", "watch_of"]

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
        condition: an expression of shape (), or a traceable function f(t, x, u, params) -> (). A function is part of
            the compiled program: another one compiles again.
        direction: None: any root; True or 1: only where the condition rises; False or -1: only where it falls. The
            number 0, which other programs read as any root, is refused.

    Raises:
        ModelError: a condition that is neither, or of another shape; another direction.
    """

    condition: Any
    direction: Any = None

    def __post_init__(self) -> None:
        if isinstance(self.condition, Expr):
            shape = self.condition.check_shape()
            if shape != ():
                raise ModelError(f"Event expects a condition of shape (), got {shape}: {self.condition!r}")
        elif not callable(self.condition):
            raise ModelError(
                f"Event expects an expression or a function f(t, x, u, params), got {type(self.condition).__name__}"
            )
        known = self.direction is None or isinstance(self.direction, bool) or self.direction in (1, -1)
        if not known:
            raise ModelError(
                f"Event: direction must be None (any), True (rising) or False (falling), got {self.direction!r}"
            )

    @property
    def sense(self) -> int:
        """1, -1, or 0 for both."""
        if self.direction is None:
            return 0
        return 1 if self.direction == 1 else -1


class _OfExpression:
    """An expression as a condition. A value: equal where the expressions are."""

    def __init__(self, expr: Expr) -> None:
        (self._expr,) = canonicalize_all([expr])
        self._key = self._expr.key()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _OfExpression) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __call__(self, t: jax.Array, x: Arrays, u: Arrays, params: Arrays) -> jax.Array:
        inputs = Inputs(t, x, u, params, t.dtype)
        (value,) = evaluate_all([self._expr], lambda leaf: leaf.read(inputs))
        return value


class Watched(NamedTuple):
    """What a loop over steps knows of the conditions.

    Attributes:
        values: (m,) where the step begins; the last ones that were not NaN.
        hits: (m,) whether each became zero in the last step tried.
    """

    values: jax.Array
    hits: jax.Array


@dataclasses.dataclass(frozen=True)
class Watch:
    """The conditions of an integration. A pytree: functions and directions are structure.

    Attributes:
        functions: f(t, x, u, params, *inputs) each.
        senses: 1, -1, or 0 for both, each.
        inputs: traced values the functions used to close over, so that derivatives find them.
    """

    functions: tuple[Callable[..., Any], ...]
    senses: tuple[int, ...]
    inputs: Any

    def values(self, stepper: Stepper, start: jax.Array, h: jax.Array, t: jax.Array, y: Blocks) -> jax.Array:
        """(m,) the conditions at a time and a stored state, within the step of length h from start."""
        x, u = stepper.stored.value(y), stepper.field(start, h).controls(t)
        found = [f(t, x, u, stepper.params, *own) for f, own in zip(self.functions, self.inputs, strict=True)]
        return jnp.stack([jnp.asarray(value, t.dtype) for value in found])

    def begin(self, stepper: Stepper, t: jax.Array, h: jax.Array, y: Blocks) -> Watched:
        """At the start of an integration whose first step is about h.

        The sign that counts is the one just after: where it goes on from an event, that at the start is noise.
        """
        eps = float(jnp.finfo(t.dtype).eps)
        s = jnp.maximum(eps**0.5 * h, 64.0 * eps * jnp.abs(t))
        now, soon = self.values(stepper, t, h, t, y), self.values(stepper, t, h, t + s, stepper.advance(t, y, s))
        values = jnp.where(jnp.sign(now) * jnp.sign(soon) < 0.0, soon, now)
        return Watched(values, jnp.zeros(values.shape, bool))

    def after(
        self, stepper: Stepper, t: jax.Array, h: jax.Array, y: Blocks, before: Watched, first: Any, last: Any
    ) -> Watched:
        """At the end y of a step from t: values there, and which became zero on the way. Zero at the end counts.

        Args:
            first, last: whether this is the first or the last step.
        """
        now = self.values(stepper, t, h, t + h, y)
        hair = _HAIR * float(jnp.finfo(now.dtype).eps)
        sizes = jnp.abs(before.values), jnp.abs(now)
        old = jnp.where(first & (sizes[0] <= hair * sizes[1]), 0.0, before.values)
        now = jnp.where(last & (sizes[1] <= hair * sizes[0]), 0.0, now)
        wanted = jnp.asarray(self.senses)
        falls, rises = (old > 0.0) & (now <= 0.0), (old < 0.0) & (now >= 0.0)
        hits = (falls & (wanted <= 0)) | (rises & (wanted >= 0))
        return Watched(jnp.where(jnp.isnan(now), before.values, now), hits)


jax.tree_util.register_pytree_node(
    Watch, lambda w: ((w.inputs,), (w.functions, w.senses)), lambda structure, inputs: Watch(*structure, *inputs)
)


def watch_of(dynamics: Dynamics, event: Any, start: Inputs, signals: Signals) -> tuple[Watch, list[jax.Array]]:
    """The conditions that `integrate` was given, and their values at the start.

    Raises:
        InputError: neither an event nor a sequence of events; a condition that does not return one number.
        ModelError: an expression that reads what the system does not have.
    """
    events: Sequence[Any] = [event] if isinstance(event, Event) else event
    if not isinstance(events, (list, tuple)) or not events or not all(isinstance(e, Event) for e in events):
        raise InputError(f"event expects tx.Event(condition), or a list of them, got {event!r}")
    now = signals.during(dynamics, start.t, jnp.zeros_like(start.t))(start.t)
    arguments = (start.t, dict(start.x), now, dict(start.params))
    functions, inputs, values = [], [], []
    for number, own in enumerate(events):
        condition = own.condition
        if isinstance(condition, Expr):
            _check_leaves(dynamics, condition)
            condition = _OfExpression(condition)
        value = condition(*arguments)
        if jnp.shape(value) != () or not jnp.issubdtype(jnp.result_type(value), jnp.floating):
            raise InputError(
                f"the condition of event {number} must return one real number, got shape {jnp.shape(value)} of "
                f"{jnp.result_type(value)}"
            )
        closed: tuple[Any, ...] = ()
        if not isinstance(condition, _OfExpression) and is_traced(value):
            # Of the function itself only where it closes over traced values; else it would compile again.
            converted, held = jax.closure_convert(condition, *arguments)
            if held:
                condition, closed = converted, tuple(held)
        functions.append(condition)
        inputs.append(closed)
        values.append(value)
    return Watch(tuple(functions), tuple(e.sense for e in events), tuple(inputs)), values


def _check_leaves(dynamics: Dynamics, expr: Expr) -> None:
    """Everything that an expression reads must be there. Raises ModelError."""
    known = {leaf.key() for leaf in (*dynamics.states, *dynamics.controls, *dynamics.parameters)}
    for leaf in leaves_of(expr):
        if isinstance(leaf, (Constant, Time)) or not isinstance(leaf, Leaf) or leaf.key() in known:
            continue
        baked = " (a baked parameter is no input any more)" if isinstance(leaf, Parameter) else ""
        raise ModelError(
            f"the event {expr!r} reads {type(leaf).__name__} {leaf.name!r}, which the compiled system does not "
            f"have{baked}"
        )
