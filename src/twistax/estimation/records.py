"""Records of measurements with separate times, merged into one timeline."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed, real_array, reals, short
from ..errors import InputError, ShapeError
from ..groups import Group
from ..integrators.controls import ControlTable
from ..jax_inside import is_traced
from .measurement import Measurement

#: By the name of a measurement: its times (k,) and its values (k, *shape).
Records = Mapping[str, tuple[Any, Any]]
#: The largest defect of a measured rotation or pose, as of the arguments of the maps of these groups.
_DRIFT = 0.1


class Timeline(NamedTuple):
    """The times of a run, in order, and the measurements at these times.

    Attributes:
        ts: (k,) times in s, concrete numbers.
        values: by measurement (k, *shape), the identity if there is none.
        present: by measurement (k,), whether there is a value.
        rows: by measurement the indices of its values in the timeline, in the order of their times.
    """

    ts: np.ndarray
    values: dict[str, jax.Array]
    present: dict[str, jax.Array]
    rows: dict[str, np.ndarray]


def timeline_of(
    records: Records,
    measurements: Mapping[str, Measurement],
    t0: float | None,
    save_at: np.ndarray,
    jumps: list[np.ndarray],
    max_step: float | None,
    dtype: Any,
) -> Timeline:
    """The timeline of all records, of `save_at` and of jumps, with steps of at most `max_step`.

    Rows with a NaN are missing measurements. Records need not be sorted by time.

    Raises: InputError, ShapeError for invalid records.
    """
    if not isinstance(records, Mapping):
        raise InputError(f"records must be a dict from measurements to (times, values), got {short(records)}")
    times = {name: _times(name, pair, measurements) for name, pair in records.items()}
    if not np.isfinite(save_at).all():
        raise InputError(f"save_at expects finite times, got {short(save_at)}")
    knots = np.concatenate([np.zeros(0), *times.values(), save_at])
    if t0 is None and not knots.size:
        raise InputError("records are empty, so t0 is not known.\n  fix: pass t0=..., in s")
    start = float(knots.min()) if t0 is None else t0
    for place, ts in (*((f"records[{name!r}]", ts) for name, ts in times.items()), ("save_at", save_at)):
        if ts.size and ts.min() < start:
            raise InputError(f"{place} has the time {ts.min():g}, before the start t0 = {start:g}")
    # A jump outside of the run is none: the run begins with its records and ends with them.
    knots = np.unique(np.concatenate([[start], knots]))
    jumps = [at[(at > start) & (at < knots[-1])] for at in jumps]
    ts = np.unique(np.concatenate([knots, *jumps]))
    ts = ts if max_step is None else _refined(ts, max_step)
    values, present, rows = {}, {}, {}
    for name, (_, rows_of_values) in records.items():
        group = measurements[name].group
        array = real_array(f"records[{name!r}]: values", rows_of_values)
        if array.shape != (times[name].size, *group.shape):
            raise ShapeError(
                f"records[{name!r}] expects values of shape {(times[name].size, *group.shape)}, got {array.shape}"
            )
        if not is_traced(array) and np.isinf(np.asarray(array)).any():
            raise InputError(f"records[{name!r}] expects finite values, or NaN where one is missing, got infinite ones")
        check_elements(f"records[{name!r}]", group, array)
        order = np.argsort(times[name])
        rows[name] = np.searchsorted(ts, times[name][order])
        sorted_values = jnp.asarray(array[order], dtype)
        known = jnp.isfinite(sorted_values).all(axis=tuple(range(1, sorted_values.ndim)))
        one = jnp.asarray(group.identity(dtype), dtype)
        safe = jnp.where(known.reshape(-1, *(1,) * one.ndim), sorted_values, one)
        values[name] = jnp.broadcast_to(one, (ts.size, *group.shape)).at[rows[name]].set(safe)
        present[name] = jnp.zeros(ts.size, bool).at[rows[name]].set(known)
    return Timeline(ts, values, present, rows)


def check_elements(place: str, group: Group, values: Any) -> None:
    """Raise InputError for known values (..., *shape) that are no rotations or poses; those with NaN are missing."""
    if not group.rigid or is_traced(values):
        return
    for value in np.asarray(values, float).reshape(-1, *group.shape):
        if np.isfinite(value).all() and not group.known_defect(value) <= _DRIFT:
            raise InputError(
                f"{place} expects elements of {group.name}, got {short(value)}.\n"
                f"  fix: tx.{group.name}.normalize(z) takes the nearest element"
            )


def _times(name: str, pair: Any, measurements: Mapping[str, Measurement]) -> np.ndarray:
    if name not in measurements:
        raise InputError(f"records names {name!r}, but the filter has the measurements {listed(measurements, name)}")
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        raise InputError(f"records[{name!r}] expects a pair (times, values), got {short(pair)}")
    ts = reals(f"records[{name!r}]: times", pair[0], InputError).astype(float)
    if ts.ndim != 1 or not np.isfinite(ts).all():
        raise InputError(f"records[{name!r}] expects finite times of shape (k,), got {short(pair[0])}")
    if np.unique(ts).size < ts.size:
        raise InputError(
            f"records[{name!r}] has two values at one time.\n"
            "  fix: use a Measurement with another name for the second sensor"
        )
    return ts


def _refined(ts: np.ndarray, max_step: float) -> np.ndarray:
    """The times with equal steps between them, none longer than `max_step`."""
    counts = np.maximum(1, np.ceil(np.diff(ts) / max_step * (1.0 - 1e-9))).astype(int)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(ts[:-1], ts[1:], counts)]
    return np.concatenate([*pieces, ts[-1:]])


def controls_on(
    u: Mapping[str, Any] | Callable[[Any], Mapping[str, Any]] | None, ts: np.ndarray, dtype: Any
) -> dict[str, jax.Array]:
    """The controls of each interval that ends at a time of the timeline, (k, *shape): their values at its midpoint."""
    starts = jnp.asarray(np.concatenate([ts[:1], ts[:-1]]), dtype)
    lengths = jnp.asarray(np.diff(ts, prepend=ts[0]), dtype)
    if callable(u):
        return dict(jax.vmap(u)(starts + 0.5 * lengths))

    def on_timeline(name: str, value: Any) -> jax.Array:
        if isinstance(value, ControlTable):
            value.check_span(f"u[{name!r}]", float(ts[0]), float(ts[-1]))
            table = value.astype(dtype)
            return jax.vmap(lambda t, h: table.during(t, h)(t + 0.5 * h))(starts, lengths)
        array = real_array(f"u[{name!r}]", value)
        return jnp.broadcast_to(jnp.asarray(array, dtype), (len(ts), *array.shape))

    return {name: on_timeline(name, value) for name, value in (u or {}).items()}


def jumps_of(u: Any) -> list[np.ndarray]:
    """The times at which tables of controls jump."""
    tables = [value for value in u.values() if isinstance(value, ControlTable)] if isinstance(u, Mapping) else []
    for table in tables:
        if is_traced(table.ts):
            raise InputError("the times of a table of controls must be concrete numbers, got traced ones")
    return [np.asarray(table.jumps, float) for table in tables]
