"""What is checked before a flight, and what is said after one that failed."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError, IntegrationError
from ..expr import Inputs
from ..groups import Euclidean, Group, SpecialEuclidean, SpecialOrthogonal
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .concrete import is_finite, is_traced
from .stepper import Stepper

__all__ = ["check_start", "failure"]

#: From this turn in a step on, in rad, it is the likely cause of a failure: stages may turn further than the start.
_FAR = 2.0


def check_start(dynamics: Dynamics, inputs: Inputs) -> None:
    """Check what is known of the prepared start: everything finite, rotations and poses in their groups.

    Raises:
        InputError: names the value, and for a rotation how far off it is.
    """
    for kind, values in (("x0", inputs.x), ("u", inputs.u), ("params", inputs.params), ("t0", {"t0": inputs.t})):
        for name, value in values.items():
            if not is_finite(value):
                where = "t0" if kind == "t0" else f"{kind}[{name!r}]"
                raise InputError(f"{where} is not finite: {value}")
    tolerance = max(1e-6, 1e3 * float(jnp.finfo(inputs.dtype).eps))
    for name, group in dynamics.group.factors.items():
        value = inputs.x[name]
        if isinstance(group, Euclidean) or is_traced(value):
            continue
        defect = float(_defect(group, value))
        if defect > tolerance:
            raise InputError(
                f"x0[{name!r}] is no element of {group.name}: off by {defect:.3g}, where {tolerance:.0e} is allowed "
                "(the rotation's R'R - I, and the last row of a pose).\n"
                "  fix: build poses with tx.pose(...), or take the nearest element with "
                f"tx.{group.name}.normalize(g)"
            )


@functools.partial(jax.jit, static_argnums=0)
def _defect(group: Group, value: jax.Array) -> jax.Array:
    return group.defect(value)


def failure(stepper: Stepper, t: jax.Array, x: Arrays) -> IntegrationError:
    """The error for the step from (t, x) whose end is not finite."""
    h = stepper.h
    controls_at = stepper.controls(t, h)
    rates = stepper.dynamics.vector_field(t, x, controls_at(t), stepper.params)
    moved = stepper.method.step(stepper.dynamics, t, x, controls_at, stepper.params, h)
    bad = _not_finite(moved)
    turns = {name: angle for name, angle in _turns(stepper.dynamics, rates, h).items() if name in bad}
    far = max(turns, key=turns.__getitem__, default=None)
    bad_controls = _not_finite(controls_at(t)) or _not_finite(controls_at(t + h))
    if bad_controls:
        cause = f"control {bad_controls[0]!r} is not finite there"
        fix = "look at u between the start and the end of this step"
    elif _not_finite(rates) and not _is_huge(x):
        cause = f"the rate of {_not_finite(rates)[0]!r} is not finite there, e.g. a division by zero"
        fix = "guard the expression, or stop before that state"
    elif far is not None and turns[far] > _FAR:
        cause = (
            f"{far!r} turns by some {turns[far]:.3g} rad in this step of {float(h):.6g} s, too far for one step: "
            "exponential coordinates hold half a turn as polynomials, a full one in closed form"
        )
        fix = "try a smaller dt, or tx.charts.Exponential() for up to a full turn"
    else:
        cause = f"the step {float(h):.6g} s is too long for rates this fast, or the solution itself grows without bound"
        fix = "try a smaller dt"
    names = ", ".join(map(repr, bad))
    sizes = ", ".join(f"|{name}| = {_largest(value):.3g}" for name, value in x.items())
    return IntegrationError(
        f"state {names} became infinite or not a number in the step from t = {float(t):.6g} s.\n"
        f"  likely cause: {cause}\n  last finite state: {sizes} (largest entries)\n"
        f"  fix: {fix}; throw=False keeps the flight up to here"
    )


def _not_finite(values: Mapping[str, Any]) -> list[str]:
    return [name for name, value in values.items() if not is_finite(value)]


def _is_huge(x: Mapping[str, Any]) -> bool:
    """Whether a state is so large that squares and cubes of it overflow."""
    return any(_largest(v) > float(jnp.finfo(v.dtype).max) ** 0.25 for v in x.values())


def _largest(value: Any) -> float:
    return float(np.abs(np.asarray(value)).max())


def _turns(dynamics: Dynamics, rates: Arrays, h: jax.Array) -> dict[str, float]:
    """By how many rad each rotation and pose turns in a step, if its rate stays as it is."""
    angular = {}
    for name, group in dynamics.group.factors.items():
        if isinstance(group, SpecialOrthogonal):
            angular[name] = rates[name]
        elif isinstance(group, SpecialEuclidean):
            angular[name] = group.order.split(rates[name])[1]
    return {name: float(h) * float(np.linalg.norm(np.asarray(w))) for name, w in angular.items()}
