"""Integration of a compiled system over time."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..errors import InputError
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from ..lowering.inputs import precision
from .charts.whole import Blocks
from .checks import check_start, failure
from .concrete import is_traced
from .controls import controls_of
from .grid import Grid, Saves, make_grid, place_saves
from .method import Method
from .rkmk import RKMK
from .small_call import small_call
from .solution import Result, Solution, Stats
from .stepper import Stepper
from .tableaus import RK4

__all__ = ["integrate"]


def integrate(
    dynamics: Dynamics,
    x0: Mapping[str, Any],
    *,
    t0: Any = 0.0,
    t1: Any,
    dt: Any = None,
    steps: int | None = None,
    method: Method | None = None,
    u: Any = None,
    params: Mapping[str, Any] | None = None,
    save_at: Any = None,
    throw: bool = True,
) -> Solution:
    """Fly a system from x0 at t0 to t1 with fixed steps. Every state stays in its group.

    Called with plain numbers, the loop is compiled once for the dynamics, the method and the number of saved times:
    another dt, t1, start, u or params does not compile again. Where something is traced (inside jit, grad, jacfwd or
    vmap) the loop is a scan with a fixed number of steps, so that forward and reverse derivatives with respect to
    x0, u, params, t0, t1 and save_at all work; there a traced t0 or t1 needs `steps` in place of `dt`, and checks that
    need numbers are left out: look at `Solution.result`.

    Args:
        x0: the start, a dict by state name. Its precision is that of the whole flight.
        t0, t1: start and end in s, t1 >= t0.
        dt: the length of a step in s; (t1 - t0) / dt is rounded to whole steps and dt adjusted.
        steps: the number of steps, instead of dt.
        method: `RKMK(tableau)`; RKMK(RK4) if left out.
        u: the controls: a dict of arrays, which are held, or of tables (`Held`, `Linear`); or a traceable function of
            t that returns the dict and is called at stage times. A function is part of the compiled program: another
            one compiles again, and what it closes over is read when it is compiled.
        params: parameter values; missing ones take the Parameter's own.
        save_at: sorted times inside [t0, t1]. Off the grid the state is one shorter step of the same method from the
            grid point before, as accurate as the method. Left out: the end alone.
        throw: raise when the flight ends early. Otherwise the part before the failure is returned, with `result`.

    Returns:
        `Solution(ts, xs, stats, result)`, saved times on the leading axis.

    Raises:
        InputError: what `Dynamics.prepare` raises; values that are not finite; a rotation that is none; times or
            steps that make no sense.
        IntegrationError: a state became infinite or not a number. Names the time, the state and the likely cause.
    """
    method = RKMK(RK4) if method is None else method
    if not isinstance(method, Method):
        raise InputError(f"method must be an object like tx.RKMK(tx.tableaus.RK4), got {method!r}")
    method.check(dynamics)
    controls = controls_of(u)
    inputs = dynamics.prepare(t0, x0, controls.sample(jnp.asarray(t0, precision(x0, params))), params)
    check_start(dynamics, inputs)
    grid = make_grid(t0, t1, dt, steps, inputs.dtype)
    saves = place_saves(save_at, grid, inputs.dtype)
    signals = controls.prepared(inputs.u, inputs.dtype)
    stepper = Stepper(dynamics, method, signals, dict(inputs.params), grid.t0, grid.h)
    x = dict(inputs.x)
    if is_traced((stepper, x, inputs.u, saves)):
        return _traced_flight(stepper, x, grid, saves)
    return _known_flight(stepper, x, grid, saves, throw)


class _Recorded(NamedTuple):
    """At the stops of the loop: steps taken, states, and whether all went well."""

    steps: jax.Array
    xs: Any  # stored inside of the loop, states outside
    good: jax.Array


def _known_flight(stepper: Stepper, x: Arrays, grid: Grid, saves: Saves | None, throw: bool) -> Solution:
    """The flight with known numbers: a loop whose length is data, checked at every step."""
    end = jnp.asarray([grid.steps])
    recorded = _loop(stepper, x, end if saves is None else jnp.concatenate([saves.index, end]))
    done = int(recorded.steps[-1])
    stats = _stats(stepper.method, done, saves)
    if saves is None:
        ts, xs, good = grid.t1[None], recorded.xs, recorded.good
    else:
        ts, (xs, good) = saves.ts, jax.tree.map(lambda a: a[:-1], (recorded.xs, recorded.good))
        if saves.off_grid:
            xs, fine = _off_grid(stepper, xs, saves)
            good = good & fine
    if bool(recorded.good[-1]) and bool(good.all()):
        return Solution(ts, xs, stats, Result.DONE)
    last = {name: value[-1] for name, value in recorded.xs.items()}
    t = stepper.time(recorded.steps[-1])
    if throw:
        raise failure(stepper, t, last)
    if saves is None:
        return Solution(t[None], xs, stats, Result.NON_FINITE)
    kept = int(good.sum())
    return Solution(ts[:kept], {name: value[:kept] for name, value in xs.items()}, stats, Result.NON_FINITE)


@jax.jit
def _loop(stepper: Stepper, x: Arrays, stops: jax.Array) -> _Recorded:
    """Step on to each stop in turn and record the state there; after a step that fails stay where it started.

    Before the first step it is the start as given, to the last bit.
    """
    return small_call(_stepped, stepper, x, stops)


def _stepped(stepper: Stepper, x: Arrays, stops: jax.Array) -> _Recorded:
    local = stepper.coordinates

    def advance(now: _Recorded) -> _Recorded:
        moved = stepper.step(now.steps, now.xs)
        good = _finite(moved)
        kept = jax.tree.map(lambda new, old: jnp.where(good, new, old), moved, now.xs)
        return _Recorded(now.steps + good.astype(now.steps.dtype), kept, good)

    def to_stop(now: _Recorded, stop: jax.Array) -> tuple[_Recorded, _Recorded]:
        now = jax.lax.while_loop(lambda n: (n.steps < stop) & n.good, advance, now)
        found = jax.tree.map(lambda at_start, later: jnp.where(now.steps == 0, at_start, later), x, local.value(now.xs))
        return now, now._replace(xs=found)

    start = _Recorded(jnp.zeros((), stops.dtype), local.enter(x), jnp.asarray(True))
    return jax.lax.scan(to_stop, start, stops)[1]


def _traced_flight(stepper: Stepper, x: Arrays, grid: Grid, saves: Saves | None) -> Solution:
    """The flight where something is traced: a scan of fixed length, which can be differentiated both ways."""
    xs = _scan(stepper, x, grid.steps, saves is not None)
    ts, finite = grid.t1[None], _finite(xs)
    if saves is not None:
        ts, xs = saves.ts, {name: value[saves.index] for name, value in xs.items()}
        if saves.off_grid:
            xs, fine = _off_grid(stepper, xs, saves)
            finite = finite & fine.all()
    code = jnp.where(finite, Result.DONE.value, Result.NON_FINITE.value)
    return Solution(ts, xs, _stats(stepper.method, grid.steps, saves), code)


@functools.partial(jax.jit, static_argnums=(2, 3))
def _scan(stepper: Stepper, x: Arrays, steps: int, record: bool) -> Arrays:
    """The states at all grid points, or with `record` false at the end alone, on a leading axis."""
    local = stepper.coordinates

    def advance(y: Blocks, i: jax.Array) -> tuple[Blocks, Blocks | None]:
        return stepper.step(i, y), y if record else None

    end, before = jax.lax.scan(advance, local.enter(x), jnp.arange(steps))
    ys = jax.tree.map(lambda a: a[None], end)
    if record:
        ys = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), before, ys)
    xs = jax.vmap(local.value)(ys)
    return {name: value.at[0].set(x[name]) for name, value in xs.items()} if record or not steps else xs


@jax.jit
def _off_grid(stepper: Stepper, xs: Arrays, saves: Saves) -> tuple[Arrays, jax.Array]:
    """The states at the saved times from those at the grid points before, and which of them are finite."""
    local = stepper.coordinates

    def part(x: Arrays, index: jax.Array, share: jax.Array) -> tuple[Arrays, jax.Array]:
        moved = stepper.step(index, local.enter(x), share)
        found = jax.tree.map(lambda on_grid, beyond: jnp.where(share == 0, on_grid, beyond), x, local.value(moved))
        return found, _finite(moved)

    return jax.vmap(part)(xs, saves.index, saves.share)


def _stats(method: Method, steps: int, saves: Saves | None) -> Stats:
    parts = saves.index.shape[0] if saves is not None and saves.off_grid else 0
    return Stats(steps, steps, 0, method.evaluations * (steps + parts))


def _finite(x: Any) -> jax.Array:
    """Whether every entry of a pytree is finite."""
    return functools.reduce(jnp.logical_and, [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(x)])
