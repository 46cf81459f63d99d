"""What is said after a flight that ended early."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import IntegrationError
from ..groups import SpecialEuclidean, SpecialOrthogonal
from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from ..lowering.inputs import is_finite
from .course import Course, Outcome
from .result import Result
from .stepper import Stepper

__all__ = ["failure"]

#: From this turn in a step on, in rad, it is the likely cause of a failure: stages may turn further than the start.
_FAR = 2.0


def failure(stepper: Stepper, course: Course, outcome: Outcome, x: Arrays) -> IntegrationError:
    """The error for a flight that ended early at the state x."""
    result = Result(int(outcome.code))
    if result is Result.NON_FINITE:
        return _not_a_number(stepper, course, outcome.t, outcome.h, x)
    if result is Result.NEWTON_FAILED:
        return _not_solved(stepper, course, outcome, x)
    state = course.worst(stepper, outcome, x)
    blame = f"; state {state!r} has the largest error" if state else ""
    if result is Result.MAX_STEPS:
        what = f"{int(outcome.tried)} steps ran out at t = {float(outcome.t):.6g} s{blame}"
        cause = f"steps are {float(outcome.h):.3g} s there: tolerances this tight, rates this fast, or a stiff system"
        fix = "try looser tolerances, or more steps: control=tx.StepControl(max_steps=...)"
    else:
        what = f"no step is small enough for the tolerances at t = {float(outcome.t):.6g} s{blame}"
        cause = "a jump in the rates there, a singularity, or dtmin"
        fix = "name times of jumps with jumps=..., or try looser tolerances"
    return IntegrationError(
        f"{what}.\n  likely cause: {cause}\n  last state: {_sizes(x)} (largest entries)\n"
        f"  fix: {fix}; throw=False keeps the flight up to here"
    )


def _not_a_number(stepper: Stepper, course: Course, t: jax.Array, h: jax.Array, x: Arrays) -> IntegrationError:
    """The error for the step of length h from (t, x) whose end is not finite."""
    controls_at = stepper.controls(t, h)
    rates = stepper.dynamics._functions.vector_field(t, x, controls_at(t), stepper.params)
    moved = stepper.method.step(stepper.dynamics, t, x, controls_at, stepper.params, h)
    # The end may be finite and the rate there not.
    bad = _not_finite(moved) or list(moved)
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
        cause, fix = course.too_long(float(h))
    names = ", ".join(map(repr, bad))
    return IntegrationError(
        f"state {names} became infinite or not a number in the step from t = {float(t):.6g} s.\n"
        f"  likely cause: {cause}\n  last finite state: {_sizes(x)} (largest entries)\n"
        f"  fix: {fix}; throw=False keeps the flight up to here"
    )


def _not_solved(stepper: Stepper, course: Course, outcome: Outcome, x: Arrays) -> IntegrationError:
    """The error for a step whose equations could not be solved."""
    cause, fix = course.not_solved(float(outcome.h))
    return IntegrationError(
        f"the equations of a step of {stepper.method.name} could not be solved at t = {float(outcome.t):.6g} s.\n"
        f"  likely cause: {cause}\n  last state: {_sizes(x)} (largest entries)\n"
        f"  fix: {fix}; throw=False keeps the flight up to here"
    )


def _sizes(x: Arrays) -> str:
    return ", ".join(f"|{name}| = {_largest(value):.3g}" for name, value in x.items())


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
