"""The record of an experiment for a fit, and the records of all experiments as arrays in segments."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import short
from ...errors import InputError
from ...system.dynamics import Arrays
from ...system.inputs import Values
from ..error_state_kalman import ErrorStateKalman
from ..filter import RunStages
from ..records import Records


@dataclasses.dataclass(frozen=True)
class Experiment:
    """The records of one experiment with a system.

    Attributes:
        records: by measurement (times (k,), values (k, *shape)), as for a filter's run; a row with a NaN is missing.
        x0: the state at t0, or a guess of it, by name.
        P0: the covariance of that guess in the tangent space: a number, (n,) or (n, n); 0 for a known initial state.
            Without it the initial state is unknown, and x0 is its initial guess. With noise in the rates, P0 is the
            initial covariance of the filter; pass it if a covariance of a measurement is free, because an initial state
            that fits the first measurement exactly would make a covariance of zero most likely.
        t0: s; by default the first time of the records.
        u: controls, as for a filter's run.
        guess: initial guess of the states in a search with several segments, by name, at arbitrary times: (times (k,),
            {name: (k, *shape)}). By default the states are simulated.
    Raises: nothing; a fit checks the values.

    Example: `tx.estimation.Experiment({"angle": (times, angles)}, x0={"q": 1.0, "w": 0.0})`.
    """

    records: Records
    x0: Values
    P0: Any = None
    t0: float | None = None
    u: Mapping[str, Any] | Callable[[Any], Mapping[str, Any]] | None = None
    guess: tuple[Any, Mapping[str, Any]] | None = None


class RecordRows(NamedTuple):
    """The rows of a timeline: intervals of lengths `hs` that end at the times `ts`, with constant controls, and the
    measurements at these times.
    """

    ts: jax.Array
    hs: jax.Array
    controls: Arrays
    values: dict[str, jax.Array]
    present: dict[str, jax.Array]


class StartEstimate(NamedTuple):
    """The initial state, its covariance in the filter (n, n), the information (n, n) about it as an unknown, and which
    entries of its tangent (n,) are unknown."""

    x: Arrays
    P0: jax.Array
    information: jax.Array
    unknown: jax.Array


class SegmentedData(NamedTuple):
    """All experiments in segments: rows (experiments, segments, length, ...), and initial states and guesses.

    Attributes:
        rows: the `RecordRows`; the last segments are padded by steps of zero length without measurements.
        starts: initial states (experiments, ...).
        guess: states at the starts of segments (experiments, segments, *shape), NaN where they are simulated.
        params: the values of all parameters that are not free.
    """

    rows: RecordRows
    starts: StartEstimate
    guess: Arrays
    params: Arrays


def experiments_of(data: Any) -> tuple[Experiment, ...]:
    """The list of experiments in the argument `data`. Raises InputError for other objects."""
    experiments = (data,) if isinstance(data, Experiment) else tuple(data) if isinstance(data, Sequence) else ()
    if not experiments or not all(isinstance(one, Experiment) for one in experiments):
        raise InputError(f"data expects an Experiment or a list of Experiments, got {short(data)}")
    return experiments


class StagedData(NamedTuple):
    """Checked experiments before the division into segments: the arguments of runs, and guesses of initial states of
    segments.
    """

    stages: tuple[RunStages, ...]
    guesses: tuple[dict[str, np.ndarray], ...]


def staged(
    kalman: ErrorStateKalman, experiments: Sequence[Experiment], params: Values, segments: int | None
) -> tuple[StagedData, tuple[bool, ...], int]:
    """The experiments, which of their initial states are unknown, and the number of segments of each.

    Raises InputError, ShapeError: the errors of a filter's run.
    """
    stages = tuple(
        kalman.staged(one.records, one.x0, 0.0 if one.P0 is None else one.P0, one.t0, one.u, params, ())
        for one in experiments
    )
    count, n = max(len(one.ts) for one in stages), kalman.model.dimension
    if segments is None:
        # A segment must tell its start: some rows for each entry of the state. Noise ties rows together, see _sensed.
        segments = 1 if kalman.model.process else max(1, min(_SEGMENTS, count // max(8, 2 * n)))
    length = -(-count // segments)
    guesses = tuple(_guess(one, by_time, segments, length) for one, by_time in zip(experiments, stages))
    return StagedData(stages, guesses), tuple(one.P0 is None for one in experiments), segments


def segmented(kalman: ErrorStateKalman, data: StagedData, free: tuple[bool, ...], segments: int) -> SegmentedData:
    """The arrays of experiments in segments; traceable."""
    starts = [_start(one, is_free, bool(kalman.model.process)) for one, is_free in zip(data.stages, free)]
    length = -(-max(len(one.ts) for one in data.stages) // segments)
    rows = [_rows(kalman, one, segments, length) for one in data.stages]
    stack = lambda trees: jax.tree.map(lambda *a: jnp.stack(a), *trees)  # noqa: E731
    dtype = data.stages[0].ts.dtype
    guess = jax.tree.map(lambda a: a.astype(dtype), stack(data.guesses))
    return SegmentedData(stack(rows), stack(starts), guess, data.stages[0].params)


#: Segments of a record at most, where their number is left out.
_SEGMENTS = 12


def _start(stages: RunStages, is_free: bool, with_filter: bool) -> StartEstimate:
    n, nothing = len(stages.P0), jnp.zeros_like(stages.P0)
    if is_free:
        return StartEstimate(stages.x0, nothing, nothing, jnp.ones(n, bool))
    if with_filter:
        return StartEstimate(stages.x0, stages.P0, nothing, jnp.zeros(n, bool))
    unknown = jnp.diag(stages.P0) > 0.0
    both = unknown[:, None] & unknown[None, :]
    inverse = jnp.linalg.inv(jnp.where(both, stages.P0, jnp.eye(n, dtype=stages.P0.dtype)))
    return StartEstimate(stages.x0, nothing, jnp.where(both, inverse, 0.0), unknown)


def _rows(kalman: ErrorStateKalman, stages: RunStages, segments: int, length: int) -> RecordRows:
    """The rows of one experiment, (segments, length, ...)."""
    timeline, dtype = stages.timeline, stages.ts.dtype
    values, present = dict(timeline.values), dict(timeline.present)
    for name, measurement in kalman.model.measurements.items():
        if name not in values:
            one = jnp.asarray(measurement.group.identity(dtype), dtype)
            values[name] = jnp.broadcast_to(one, (len(stages.ts), *one.shape))
            present[name] = jnp.zeros(len(stages.ts), bool)
    more = segments * length - len(stages.ts)

    def cut(a: jax.Array, rest: jax.Array) -> jax.Array:
        padded = jnp.concatenate([a, jnp.broadcast_to(rest, (more, *a.shape[1:]))])
        return padded.reshape(segments, length, *a.shape[1:])

    repeated = lambda tree: jax.tree.map(lambda a: cut(a, a[-1:]), tree)  # noqa: E731
    none = lambda tree: jax.tree.map(lambda a: cut(a, jnp.zeros_like(a[-1:])), tree)  # noqa: E731
    return RecordRows(repeated(stages.ts), none(stages.hs), repeated(stages.controls), repeated(values), none(present))


def _guess(experiment: Experiment, stages: RunStages, segments: int, length: int) -> dict[str, np.ndarray]:
    """States at the starts of segments (segments, *shape) that are nearest in time; NaN where there is no guess."""
    shapes = {name: (segments, *x.shape) for name, x in stages.x0.items()}
    if experiment.guess is None:
        return {name: np.full(shape, np.nan) for name, shape in shapes.items()}
    times, states = experiment.guess
    times = np.asarray(times, float)
    starts = stages.timeline.ts[np.clip(np.arange(segments) * length - 1, 0, len(stages.ts) - 1)]
    nearest = np.abs(times[None, :] - starts[:, None]).argmin(axis=1)
    guess = {}
    for name, shape in shapes.items():
        value = np.asarray(states.get(name, np.nan), float)
        if value.ndim and value.shape != (len(times), *shape[1:]):
            raise InputError(f"guess[{name!r}] expects shape {(len(times), *shape[1:])}, got {value.shape}")
        guess[name] = value[nearest] if value.ndim else np.full(shape, np.nan)
    return guess
