"""How long steps are: the next one from the errors of the last ones, and the first one to try."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import number
from ..errors import ModelError
from ..scalar.small_call import held
from ..units import same_unit, seconds
from .charts import Blocks
from .method import Stepper
from .tolerances import Tolerances

#: Errors below this many tolerances count as this: the next step grows by the most anyway.
_LEAST = 1e-12


class Errors(NamedTuple):
    """Logarithms of the errors of the last accepted steps, in units of what is allowed; zeros before the first step."""

    last: jax.Array
    before: jax.Array


@dataclasses.dataclass(frozen=True)
class StepControl:
    """A PID controller of the length of the steps. A value; the names are those of diffrax's PIDController.

    With e_n the error of step n in units of what is allowed and k the power of h with which it falls,

        $h_(n+1) = h_n safety e_n^(-(p + i + d)/k) e_(n-1)^((p + 2 d)/k) e_(n-2)^(-d/k)$

    for a step that is taken, within the factors allowed; a step that is taken back is repeated with
    $h safety e_n^(-1/k)$.

    Attributes:
        pcoeff, icoeff, dcoeff: p, i and d. Zero, one and zero is the plain controller.
        safety: below 1: how far below the allowed error steps aim.
        factormin, factormax: bounds of h_(n+1) / h_n; no growth right after a step that was taken back.
        dtmin: an integration whose steps would have to be shorter ends; in s.
        dtmax: no step is longer; in s.
        max_steps: steps tried before the integration ends.

    Raises:
        ModelError: a number that makes no sense.
        InputError: a length of time in another unit.

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

    def grown(self, square: jax.Array, past: Errors, rejected: jax.Array, order: int) -> tuple[jax.Array, Errors]:
        """The factor on h after a step that is taken, and the errors to remember. `square` is e_n squared."""
        now = _log(square)
        p, i, d = self.pcoeff, self.icoeff, self.dcoeff
        exponent = -(p + i + d) * now + (p + 2.0 * d) * past.last - d * past.before
        factor = self.safety * jnp.exp(exponent / order)
        most = jnp.where(rejected, jnp.ones_like(square), self.factormax)
        return jnp.clip(factor, self.factormin, most), Errors(now, past.last)

    def shrunk(self, square: jax.Array, order: int) -> jax.Array:
        """The factor on h after a step that is taken back."""
        return jnp.clip(self.safety * jnp.exp(-_log(square) / order), self.factormin, self.safety)


def _log(square: jax.Array) -> jax.Array:
    """The logarithm of the root; of an infinite error that of the largest number."""
    largest = jnp.finfo(square.dtype).max
    return 0.5 * jnp.log(jnp.clip(square, _LEAST**2, largest))


def first_step(
    stepper: Stepper, tolerances: Tolerances, t: jax.Array, y: Blocks, rate: Blocks, fallback: Any, room: Any
) -> jax.Array:
    """A step whose error should be near the tolerance, judged by the rate and how it changes over a short Euler step.

    Pure and traceable; `fallback` where the rates say nothing.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.4, starting step size.
    """
    local, order = stepper.coordinates, stepper.method.error_order

    def size(e: Blocks) -> jax.Array:
        return jnp.sqrt(tolerances.mean_square(local, e, y, y))

    slope = held(local.first_slope(y, rate))
    reach, speed = tolerances.reach(local, y), size(slope)
    short = jnp.where((reach > 1e-5) & (speed > 1e-5), 0.01 * reach / speed, fallback)
    # Controls beyond the end may not be defined.
    short = jnp.minimum(jnp.where(jnp.isfinite(short), short, fallback), room)
    z = jax.tree.map(lambda k: stepper.clock(short) * k, slope)
    moved = held(local.move(y, z))
    later = local.slope(z, moved, held(stepper.rate(t + short, moved, 1e-3 * short)))
    bend = size(jax.tree.map(jnp.subtract, later, slope)) / short
    largest = jnp.maximum(speed, bend)
    h = jnp.where(largest > 1e-15, (0.01 / largest) ** (1.0 / order), jnp.maximum(fallback, 1e-3 * short))
    h = jnp.minimum(100.0 * short, h)
    return jnp.where(jnp.isfinite(h) & (h > 0.0), h, fallback)
