"""Step-size control: times at which steps must end, the allowed error of a step, and the length of the next step."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import number, real_array
from ..errors import InputError, ModelError
from ..jax_inside import is_traced
from ..system.inputs import is_finite, need_representable
from ..units import Quantity, same_unit, seconds
from .charts.coordinates import Blocks, StateCoordinates
from .controls import Signals

#: A step that would leave less than this share of its length to the next limit is extended to the limit.
_STRETCH = 0.01
#: Errors below this many tolerances count as this: the next step grows by the most anyway.
_LEAST = 1e-12


class ErrorHistory(NamedTuple):
    """Logarithms of the errors of the last accepted steps, in units of the allowed error; zeros
    before the first step.
    """

    last: jax.Array
    before: jax.Array


class Length(NamedTuple):
    """The length of a step to try."""

    end: jax.Array  # the time of its end
    h: jax.Array  # its length
    planned: jax.Array  # the length it would have without the next limit
    least: jax.Array  # the shortest length


@dataclasses.dataclass(frozen=True)
class StepControl:
    """A PID controller of the step size. Its fields have the names of diffrax's PIDController.

    With e_n the error of step n relative to the tolerance, and k the power of h with which the error decreases,

        $h_(n+1) = h_n safety e_n^(-(p + i + d)/k) e_(n-1)^((p + 2 d)/k) e_(n-2)^(-d/k)$

    for an accepted step, within the bounds of the factor; a rejected step is repeated with
    $h safety e_n^(-1/k)$.

    Attributes:
        pcoeff, icoeff, dcoeff: p, i and d. The default (0, 1, 0) is the standard I controller.
        safety: factor below 1, for a margin between the target error and the tolerance.
        factormin, factormax: bounds of h_(n+1) / h_n; there is no growth after a rejected step.
        dtmin: the shortest step, s; an integration that needs shorter steps fails.
        dtmax: the longest step, s.
        max_steps: the maximal number of attempted steps.

    Raises:
        ModelError: an invalid number.
        InputError: a length of time with another unit.

    Source: Soderlind, Digital filters in adaptive time-stepping (2003); Hairer, Norsett, Wanner, Solving Ordinary
    Differential Equations I (1993), section II.4.
    """

    pcoeff: float = 0.2
    icoeff: float = 0.6
    dcoeff: float = 0.0
    safety: float = 0.9
    factormin: float = 0.2
    factormax: float = 10.0
    dtmin: float | None = None
    dtmax: float | None = None
    max_steps: int = 16384

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None:
                number(f"StepControl: {field.name}", value, error=ModelError)
            if field.name in ("dtmin", "dtmax"):
                same_unit(f"StepControl: {field.name}", value, seconds)
            if isinstance(value, np.generic):
                # A Python number takes the precision of the state, a NumPy one does not.
                object.__setattr__(self, field.name, value.item())
        self._need(0.0 < self.safety < 1.0, "safety", "between 0 and 1")
        self._need(0.0 < self.factormin < 1.0, "factormin", "between 0 and 1")
        self._need(self.factormax > 1.0, "factormax", "above 1")
        self._need(self.pcoeff + self.icoeff + self.dcoeff > 0.0, "pcoeff + icoeff + dcoeff", "positive")
        self._need(self.dtmin is None or self.dtmin > 0.0, "dtmin", "positive")
        self._need(self.dtmax is None or self.dtmax > (self.dtmin or 0.0), "dtmax", "positive and above dtmin")
        self._need(isinstance(self.max_steps, int) and self.max_steps > 0, "max_steps", "a positive whole number")

    def _need(self, good: bool, field: str, what: str) -> None:
        if not good:
            value = getattr(self, field, None)
            raise ModelError(f"StepControl: {field} must be {what}" + ("" if value is None else f", got {value!r}"))

    def length(self, t: jax.Array, h: jax.Array, limit: jax.Array) -> Length:
        """The next step: the planned h, but not shorter than the resolution of time, and at most up
        to the next limit.
        """
        room = limit - t
        least = jnp.maximum(8.0 * float(jnp.finfo(t.dtype).eps) * jnp.abs(t), self.dtmin or 0.0)
        planned = jnp.maximum(h, least)
        if self.dtmax is not None:
            planned = jnp.minimum(planned, self.dtmax)
        # No tiny step before a limit: the last two steps are equal.
        shared = jnp.where(2.0 * planned > room, 0.5 * room, planned)
        step = jnp.where((1.0 + _STRETCH) * planned >= room, room, shared)
        return Length(jnp.where(step == room, limit, t + step), step, planned, least)

    def grown(
        self, square: jax.Array, past: ErrorHistory, rejected: jax.Array, order: int
    ) -> tuple[jax.Array, ErrorHistory]:
        """The factor on h after an accepted step, and the updated error history. `square` is e_n squared."""
        now = _log(square)
        p, i, d = self.pcoeff, self.icoeff, self.dcoeff
        exponent = -(p + i + d) * now + (p + 2.0 * d) * past.last - d * past.before
        factor = self.safety * jnp.exp(exponent / order)
        most = jnp.where(rejected, jnp.ones_like(square), self.factormax)
        return jnp.clip(factor, self.factormin, most), ErrorHistory(now, past.last)

    def shrunk(self, square: jax.Array, order: int) -> jax.Array:
        """The factor on h after a rejected step."""
        return jnp.clip(self.safety * jnp.exp(-_log(square) / order), self.factormin, self.safety)


def _log(square: jax.Array) -> jax.Array:
    """The logarithm of the root, within the range of the numbers."""
    largest = jnp.finfo(square.dtype).max
    return 0.5 * jnp.log(jnp.clip(square, _LEAST**2, largest))


#: No tolerance is finer than this many times the precision of the numbers.
FINEST = 10.0


class Tolerances(NamedTuple):
    """The allowed error atol + rtol * size, where size is that of the state or its declared scale, but not less than
    round-off.
    """

    rtol: Any  # ()
    atol: Any  # name -> () or (n,), in the order of the state's deviations
    scale: Any  # name -> (n,), the sizes that states declare

    def scaled(self, local: StateCoordinates, e: Blocks, before: Blocks, after: Blocks) -> jax.Array:
        """The entries of a difference of coordinates in units of the allowed error: (dimension,)."""
        return _flat(local.deviation(e, after)) / self._allowed(local.sizes(before, after))

    def mean_square(self, local: StateCoordinates, e: Blocks, before: Blocks, after: Blocks) -> jax.Array:
        """The mean square of `scaled`, at most one for an allowed difference."""
        return jnp.mean(jnp.square(self.scaled(local, e, before, after)))

    def square(self, local: StateCoordinates, errors: Sequence[Blocks], before: Blocks, after: Blocks) -> jax.Array:
        """The square of the error of a step in the same units; two estimates are weighed as in the program DOP853."""
        squares = [self.mean_square(local, e, before, after) for e in errors]
        if len(squares) == 1:
            return squares[0]
        first, second = squares
        weight = first + 0.01 * second
        return jnp.where(weight > 0.0, first * first / jnp.where(weight > 0.0, weight, 1.0), 0.0)

    def by_state(self, local: StateCoordinates, e: Blocks, before: Blocks, after: Blocks) -> dict[str, jax.Array]:
        """The largest entry of each state's difference, in the same units."""
        deviations, sizes = local.deviation(e, after), local.sizes(before, after)
        return {
            name: jnp.max(jnp.abs(_flat(deviations[name]) / self._allowed_part(name, _flat(sizes[name]))))
            for name in deviations
        }

    def mean_square_of_deviations(self, errors: Blocks, deviations: Blocks) -> jax.Array:
        """The mean square of errors of standard deviations by state, with the deviations as sizes."""
        return jnp.mean(jnp.square(_flat(errors) / self._replace(scale={})._allowed(deviations)))

    def reach(self, local: StateCoordinates, y: Blocks) -> jax.Array:
        """The size of a state in the same units."""
        sizes = local.sizes(y, y)
        return jnp.sqrt(jnp.mean(jnp.square(_flat(sizes) / self._allowed(sizes))))

    def _allowed(self, sizes: Blocks) -> jax.Array:
        return _flat({name: self._allowed_part(name, _flat(block)) for name, block in sizes.items()})

    def _allowed_part(self, name: str, size: jax.Array) -> jax.Array:
        info = jnp.finfo(size.dtype)
        typical = self.scale.get(name, size)
        finest = jnp.maximum(info.eps * FINEST * size, info.tiny)
        return jnp.maximum(self.atol[name] + self.rtol * typical, finest)


def _flat(tree: Any) -> jax.Array:
    return ravel_pytree(tree)[0]


# ---- times at which steps must end ----------------------------------------------------------------------------------


def span_of(t0: Any, t1: Any, dt: Any) -> tuple[float, float] | None:
    """(t0, t1) as plain numbers, None for traced ones. Raises InputError for invalid times or an invalid dt."""
    for name, value in (("t0", t0), ("t1", t1), ("dt", dt)):
        if isinstance(value, Quantity):
            same_unit(name, value, seconds)
    for name, value in (("t0", t0), ("t1", t1)):
        number(name, value, "a finite time in s")
    if dt is not None:
        number("dt", dt, "a positive number of s", lambda h: 0.0 < h < np.inf)
    if is_traced((t0, t1)):
        return None
    return float(t0), float(t1)


def direction_of(t0: Any, t1: Any, dtype: Any) -> Any:
    """1.0, or -1.0 if the end lies before the start; times multiplied by it increase along the integration."""
    array: Any = jnp if is_traced((t0, t1)) else np
    return array.where(array.asarray(t1, dtype) < array.asarray(t0, dtype), -1.0, 1.0).astype(dtype)


class Stops(NamedTuple):
    """The saved times, which steps may pass, and the limits, where steps must end."""

    limits: Any  # (m,) times in order, the last one the end; rates may jump there
    ts: Any  # (n,) the saved times in order, with infinity as padding; None if no times are saved
    count: Any  # how many of these are asked for; the padding is at the end

    @classmethod
    def of(cls, limits: Any, t0: Any, save_at: Any, count: Any) -> Stops:
        """The stops of limits, the last one the end, and of saved times."""
        if save_at is None:
            return cls(limits, None, 0)
        array: Any = jnp if is_traced((limits, t0, save_at)) else np
        saves, t1 = array.asarray(save_at, t0.dtype), limits[-1]
        return cls(limits, array.where(saves < t0, t0, array.where((saves > t1) & (saves < np.inf), t1, saves)), count)

    def next_limit(self, t: jax.Array) -> jax.Array:
        """The next limit after a time."""
        return jnp.where(self.limits > t, self.limits, self.limits[-1]).min()

    def leg(self, t0: Any, number: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Start and length of the leg between two limits; the first leg starts at t0."""
        start = jnp.where(number == 0, t0, self.limits[jnp.maximum(number - 1, 0)])
        return start, self.limits[number] - start


def limits_of(t0: Any, t1: Any, jumps: Any, signals: Signals, direction: Any) -> Any:
    """(m,) the sorted times at which a step must end: jumps that the user passed, those of tables, and the end.

    Args:
        t0, t1: start and end, on the clock of the loop over steps: times in s multiplied by the direction.
    Raises:
        InputError: jumps that are not sorted, finite times.
    """
    if jumps is not None:
        same_unit("jumps", jumps, seconds)
        array_of_jumps = real_array("jumps", jumps)
        falls = (
            not is_traced(array_of_jumps)
            and array_of_jumps.ndim == 1
            and bool((np.diff(np.asarray(array_of_jumps)) < 0).any())
        )
        if array_of_jumps.ndim != 1 or not is_finite(array_of_jumps) or falls:
            raise InputError(f"jumps expects finite, sorted times with shape (n,), got {jumps!r}")
        need_representable("jumps", array_of_jumps, t0.dtype)
    known = [*signals.jumps, *([] if jumps is None else [jumps])]
    # NumPy sorts known times: in JAX each of these operations takes tens of microseconds.
    array: Any = jnp if is_traced((t0, t1, known)) else np
    t1 = array.asarray(t1, t0.dtype)

    def inside(ts: Any) -> Any:
        # Not jnp.clip, whose derivative is halved where a time is exactly an end. A jump there moves with the end.
        ts = direction * array.asarray(ts, t0.dtype)
        return array.where(ts <= t0, t0, array.where(ts >= t1, t1, ts))

    if not known:
        return t1[None]
    limits = array.append(array.sort(array.concatenate([inside(ts) for ts in known])), t1)
    # Limits that coincide move together: none of the legs between them has a step, so that the derivatives of
    # the two ends of each must be the same. Half of what both do goes to the first, half to the last.
    first, last = (array.searchsorted(limits, limits, side=side) for side in ("left", "right"))
    return 0.5 * (limits[first] + limits[last - 1])
