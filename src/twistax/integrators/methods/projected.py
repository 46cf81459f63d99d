"""Steps that end on the manifold of a system: any method, followed by the system's corrections after every step."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ...errors import InputError, ModelError
from ...expr import Inputs
from ...jax_inside import is_traced
from ...system.dynamics import Dynamics
from ...system.projection import increments
from ..charts.coordinates import Blocks
from ..method import Carry, Method, StepAttempt, VectorField
from ..step_control import Tolerances

#: Newton iterations. The distance from the manifold at the end of a step, d, its error, becomes about d^2, then d^4.
_CORRECTIONS = 2
#: The largest distance of a start from the manifold, in m and rad.
_FAR = 1e-6


def _of_inner(method: str) -> Callable[..., Any]:
    return lambda self, *arguments: getattr(self.inner, method)(*arguments)


@dataclasses.dataclass(frozen=True)
class Projected(Method):
    """A method with a projection onto the manifold of the system after every step. `tx.integrate` makes it for systems
    with corrections.

    Attributes:
        inner: the method that takes the steps.

    Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), section IV.4.
    """

    inner: Method

    # Properties and methods of the inner method that do not change.
    name = property(lambda self: f"{self.inner.name}, projected")
    order = property(lambda self: self.inner.order)
    error_order = property(lambda self: self.inner.error_order)
    evaluations = property(lambda self: self.inner.evaluations)
    resume_evaluations = property(lambda self: self.inner.resume_evaluations)
    solves = property(lambda self: self.inner.solves)
    evaluations_of, coordinates, stored = map(_of_inner, ("evaluations_of", "coordinates", "stored"))
    rate, before, begin, resume, between = map(_of_inner, ("rate", "before", "begin", "resume", "between"))

    def check(self, dynamics: Dynamics) -> None:
        self.inner.check(dynamics)
        self.inner.coordinates(dynamics)  # raises for a method without them

    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        return self.part(field, t, y, h, None)

    def part(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array, tolerances: Tolerances | None) -> Blocks:
        return self._brought_back(field, t + h, self.inner.part(field, t, y, h, tolerances))

    def follow(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> StepAttempt:
        attempt = self.inner.follow(field, t, y, carry, h)
        return dataclasses.replace(attempt, y=self._brought_back(field, t + h, attempt.y))

    def sampled(self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array) -> StepAttempt:
        attempt = self.inner.sampled(field, t, y, carry, h)
        return dataclasses.replace(attempt, y=self._brought_back(field, t + h, attempt.y))

    def attempt(
        self, field: VectorField, t: jax.Array, y: Blocks, carry: Carry, h: jax.Array, tolerances: Tolerances
    ) -> StepAttempt:
        attempt = self.inner.attempt(field, t, y, carry, h, tolerances)
        end = self._brought_back(field, t + h, attempt.y)
        # The carry belongs to the projected state.
        carry = self.inner.resume(field, t + h, end, attempt.carry)
        evaluations = attempt.evaluations + self.inner.resume_evaluations
        return dataclasses.replace(attempt, y=end, carry=carry, evaluations=evaluations)

    def need_polynomial(self) -> None:
        raise ModelError(
            "polynomials between steps leave the manifold of the system's corrections.\n  fix: leave between out"
        )

    def _brought_back(self, field: VectorField, t: jax.Array, y: Blocks) -> Blocks:
        local, functions = self.coordinates(field.dynamics), field.dynamics.functions
        u = field.controls(t)
        still = {name: jnp.zeros(group.tangent_shape, t.dtype) for name, group in functions.group.factors.items()}
        for _ in range(_CORRECTIONS):
            corrections = functions.evaluate("corrections", field.clock(t), local.value(y), u, field.params)
            y = local.settle(local.move(y, local.first_slope(y, local.rate(still | corrections))))
        return y


def projected(method: Method) -> Projected:
    """The method with corrections."""
    return method if isinstance(method, Projected) else Projected(method)


def need_start_on_manifold(dynamics: Dynamics, inputs: Inputs) -> None:
    """Raise InputError for a known start that is not on the system's manifold."""
    functions = dynamics.functions
    if is_traced((inputs.t, inputs.x, inputs.u, inputs.params)):
        return
    corrections = functions.jitted("corrections", inputs.t, inputs.x, inputs.u, inputs.params)
    off = float(jnp.abs(increments(functions, corrections)).max())
    far = max(_FAR, 1e3 * float(jnp.finfo(inputs.dtype).eps))
    if not off <= far:
        raise InputError(
            f"the distance of x0 from the manifold of the system is {off:.3g}, but at most {far:.0e} is "
            "allowed: loops are open, or the velocities open them.\n  fix: use x0 = dynamics.project(0.0, x0)"
        )
