"""A system in a chart for diffrax: rates, coordinates and errors as it wants them, and one explicit step."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...groups import Euclidean, SpecialEuclidean, so3
from ...groups.arrays import unpack, vector
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays
from ...lowering.small_call import small_call
from ..ambient import Ambient, Arguments
from ..charts import Chart
from ..charts.coordinates import Blocks, StateCoordinates, coordinates_of
from ..rkmk import stage_slopes
from ..steps import all_finite
from ..tableau import Rows

__all__ = ["ChartStep", "Frame", "Stepped"]


@dataclasses.dataclass(frozen=True)
class Frame:
    """A system in a chart. A value; coordinates and rates travel as one flat vector each.

    Attributes:
        dynamics: gives states their meaning.
        chart: the coordinates around the start of a step.
    """

    dynamics: Dynamics
    chart: Chart

    @property
    def local(self) -> StateCoordinates:
        """The coordinates of all states."""
        return coordinates_of(self.chart, self.dynamics.group)

    @property
    def ambient(self) -> Ambient:
        """The state in its matrices, for errors and plain rates."""
        return Ambient(self.dynamics, quaternion=False)

    def rate(self, dynamics: Dynamics, given: Arguments, t: jax.Array, h: jax.Array) -> Blocks:
        """The rate at given.t and given.x for controls within the step from t to t + h."""
        now = given.signals.during(dynamics, t, h)(given.t)
        return self.local.rate(_flat(dynamics._functions.vector_field(given.t, given.x, now, given.params)))

    def still(self, x: Arrays) -> Blocks:
        """Rates of zero."""
        groups = self.dynamics.group.factors
        return self.local.rate({name: jnp.zeros(group.dimension, x[name].dtype) for name, group in groups.items()})

    def read_rate(self, x: Arrays, flat: jax.Array) -> Blocks:
        """Rates from one flat vector."""
        return ravel_pytree(self.still(x))[1](flat)

    def read_coordinates(self, x: Arrays, flat: jax.Array) -> Blocks:
        """Coordinates around x from one flat vector."""
        local = self.local
        return ravel_pytree(local.first_slope(local.enter(x), self.still(x)))[1](flat)

    def errors(self, x: Arrays, end: Blocks, e: Blocks) -> Arrays:
        """An error e of the coordinates of `end`, as the change of the entries of its value x: [R W, R v; 0 0] for a
        pose and a deviation [v; w]. Infinite where x is not finite.
        """
        deviations, good = self.local.deviation(e, end), all_finite(x)
        velocities: dict[str, Any] = {}
        for name, group in self.dynamics.group.factors.items():
            if isinstance(group, Euclidean):
                velocities[name] = self.local.parts[name].value(deviations[name])
            else:
                tangent = vector(deviations[name])
                if isinstance(group, SpecialEuclidean):
                    tangent = group.order.from_linear_first(tangent)
                velocities[name] = tangent
        return {name: jnp.where(good, a, jnp.inf) for name, a in self.ambient.rates(x, velocities).items()}

    def deviations(self, x: Mapping[str, Any], errors: Mapping[str, Any]) -> Blocks:
        """The deviations again, from what `errors` made of them."""
        found: Blocks = {}
        for name, group in self.dynamics.group.factors.items():
            if isinstance(group, Euclidean):
                found[name] = self.local.parts[name].enter(errors[name])
            elif isinstance(group, SpecialEuclidean):
                back = x[name][:3, :3].T
                found[name] = (*unpack(so3.act(back, errors[name][:3, 3])), *_rotation(back, errors[name][:3, :3]))
            else:
                found[name] = _rotation(x[name].T, errors[name])
        return found


def _rotation(back: jax.Array, error: jax.Array) -> tuple[jax.Array, ...]:
    return unpack(so3.vee(so3.compose(back, error)))


class Stepped(NamedTuple):
    """A step.

    Attributes:
        x: the state at its end.
        error: its estimated error, in the form of the state.
        z: the coordinates of the end, flat.
        k: (stages, n) the increments of all stages.
        rate: the rate of the last stage, flat.
    """

    x: Arrays
    error: Arrays
    z: jax.Array
    k: jax.Array
    rate: jax.Array


class ChartStep:
    """The step of an explicit Runge-Kutta solver of diffrax, as one small function where that is known to work.

    The tableau is diffrax's, the loop over stages that of `RKMK`: slopes are pulled back in the chart, and the rate of
    the last stage is handed on as a body velocity, which needs no change of chart.
    """

    def __init__(self, frame: Frame, tableau: diffrax.ButcherTableau) -> None:
        count = tableau.num_stages
        a = np.zeros((count, count))
        for i, row in enumerate(tableau.a_lower):
            a[i + 1, : i + 1] = row
        self.frame = frame
        self.rows = Rows(a, np.concatenate([[0.0], tableau.c]))
        self.b, self.b_error = tableau.b_sol, tableau.b_error

    def __call__(self, given: Arguments, h: jax.Array, rate: jax.Array | None) -> Stepped:
        """The step of length h from given.t and given.x; `rate` there, flat, where it is known. Traceable."""

        @jax.custom_jvp
        def step(*operands: Any) -> Stepped:
            return small_call(self._step, *operands)

        step.defjvp(lambda primals, tangents: jax.jvp(self._step, primals, tangents))
        return step(given, h, rate)

    def _step(self, given: Arguments, h: jax.Array, known: jax.Array | None) -> Stepped:
        frame, local, t = self.frame, self.frame.local, given.t
        start = local.enter(given.x)

        def rate_of(time: jax.Array, y: Blocks) -> Blocks:
            return frame.rate(frame.dynamics, given._replace(t=time, x=local.value(y)), t, h)

        first = rate_of(t, start) if known is None else frame.read_rate(given.x, known)
        packed, _ = ravel_pytree(first)

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, jax.Array]:
            moved = local.move(start, z)
            rate = rate_of(time, moved)
            return local.slope(z, moved, rate), ravel_pytree(rate)[0]

        slopes, last = stage_slopes(self.rows, slope, local.first_slope(start, first), packed, t, h)
        z = slopes.combine(self.b, h)
        end = local.settle(local.move(start, z))
        x = local.value(end)
        error = frame.errors(x, end, slopes.combine(self.b_error, h))
        return Stepped(x, error, ravel_pytree(z)[0], h * slopes.rows, last)


def _flat(rates: Arrays) -> Arrays:
    return {name: rate.reshape(-1) for name, rate in rates.items()}
