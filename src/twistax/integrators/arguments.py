"""What diffrax calls args, read as `integrate` reads u and params."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax

from ..errors import InputError
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .controls import OfTime, Signals, controls_of

__all__ = ["Arguments", "read_arguments"]


class Arguments(NamedTuple):
    """A pytree of what a step needs besides its length.

    Attributes:
        t: the time.
        x: the state.
        signals: the prepared controls.
        params: the prepared parameters.
    """

    t: jax.Array
    x: Arrays
    signals: Signals
    params: Arrays


def read_arguments(dynamics: Dynamics, t: Any, x: Mapping[str, Any], args: Any) -> Arguments:
    """Time, state and args = (u, params), or None, checked and in one precision. Traceable.

    Raises:
        InputError: args of another form; the rest as a call of the dynamics does.
    """
    if args is not None and not (isinstance(args, (tuple, list)) and len(args) == 2):
        raise InputError(f"args must be (u, params), both as tx.integrate takes them, or None; got {args!r}")
    u, params = (None, None) if args is None else args
    controls = controls_of(u)
    inputs = dynamics._functions.prepare(t, x, controls.sample(t), params)
    if isinstance(controls, OfTime):
        controls = controls.opened(inputs.t)
    return Arguments(inputs.t, dict(inputs.x), controls.prepared(inputs.u, inputs.dtype), dict(inputs.params))
