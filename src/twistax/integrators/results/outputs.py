"""Controls and outputs of a system along a solution, for all saved times in one call."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...checks import listed
from ...errors import InputError
from ...expr import Inputs
from ...jax_inside import is_traced
from ...progress import watching
from ...system.dynamics import Arrays
from ..loop.unreached import nan_unless
from ..method import Stepper, jitted
from ..times import room_for


def controls_along(stepper: Stepper, ts: jax.Array) -> Arrays:
    """The controls at times (n,), or (..., n) for a batch: the right-hand limit at each time; at the end of a table the
    left-hand limit.

    They are differentiable with respect to the rows of tables.
    """
    return _in_rows(_controls, stepper, ts, {})


def outputs_along(stepper: Stepper, ts: jax.Array, xs: Arrays) -> Arrays:
    """The outputs at the states of a solution. Raises InputError if an output reads a control or parameter that was not
    passed.
    """
    functions = stepper.dynamics.functions
    read = functions.reads["outputs"]
    controls, params = getattr(stepper.signals, "values", None), dict(stepper.params)
    missing = [c.name for c in functions.controls if controls is not None and c.name in read and c.name not in controls]
    if missing:
        raise InputError(
            f"an output reads the control {missing[0]!r}, which was not passed to the integration; it had: "
            f"{listed(controls or ())}.\n  fix: tx.integrate(..., u={{{missing[0]!r}: ...}})"
        )
    dtype = next(iter(xs.values())).dtype
    for leaf in functions.parameters:
        if leaf.name in read and leaf.name not in params:
            value = leaf.read(Inputs(None, {}, {}, {}, dtype))
            params[leaf.name] = jnp.broadcast_to(value, (*ts.shape[:-1], *value.shape))
    return _in_rows(_outputs, dataclasses.replace(stepper, params=params), ts, xs)


def _controls() -> Callable[[Stepper, jax.Array, Arrays], Arrays]:
    return lambda stepper, ts, xs: _each(_controls_at, stepper, ts)


def _outputs() -> Callable[[Stepper, jax.Array, Arrays], Arrays]:
    def at(stepper: Stepper, t: jax.Array, x: Arrays) -> Arrays:
        functions = stepper.dynamics.functions
        outputs = functions.evaluate("outputs", t, x, _controls_at(stepper, t), stepper.params, in_loop=False)
        missed = jnp.isnan(ravel_pytree(x)[0]).any()  # outputs that read no state would go on
        return outputs | nan_unless(~missed, {name: value for name, value in outputs.items() if value.dtype != bool})

    return lambda stepper, ts, xs: _each(at, stepper, ts, xs)


def _controls_at(stepper: Stepper, t: jax.Array) -> Arrays:
    small = 64.0 * float(jnp.finfo(t.dtype).eps) * jnp.maximum(jnp.abs(t), 1e-3)
    after, before = (stepper.signals.during(stepper.dynamics, t, h)(t) for h in (small, -small))
    return {name: jnp.where(jnp.isnan(value), before[name], value) for name, value in after.items()}


def _each(function: Callable[..., Arrays], stepper: Stepper, ts: jax.Array, *rest: Any) -> Arrays:
    """The function mapped over all times, and over the axes of a batch."""
    mapped = jax.vmap(function, in_axes=(None, 0, *(0 for _ in rest)))
    for _ in range(ts.ndim - 1):
        mapped = jax.vmap(mapped)
    return mapped(stepper, ts, *rest)


def _in_rows(make: Callable[[], Callable[..., Arrays]], stepper: Stepper, ts: jax.Array, xs: Arrays) -> Arrays:
    """The function at all times; known times are padded, so that another number of them does not compile again."""
    count = ts.shape[-1]
    if is_traced((stepper, ts, xs)) or ts.ndim > 1 or not count:
        return _called(make, stepper, ts, xs)
    last = np.minimum(np.arange(room_for(count, sum(x.size for x in xs.values()) // count)), count - 1)
    ts, xs = jax.tree.map(lambda a: np.asarray(a)[last], (ts, xs))
    values = _called(make, stepper, ts, xs)
    return {name: jax.device_put(np.asarray(value)[:count]) for name, value in values.items()}


@watching("outputs")
def _called(make: Callable[[], Callable[..., Arrays]], stepper: Stepper, *rest: Any) -> Arrays:
    try:
        result: Arrays = jitted(make, stepper, *rest)
    except jax.errors.UnexpectedTracerError:
        raise InputError(
            "the function u reads values that existed only within jax.vmap or jax.jit.\n"
            "  fix: return solution.us or solution.outputs from within it, or pass those values to u through params"
        ) from None
    return result
