"""What is said after an integration that ended early."""

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
from .method import Stepper
from .solution import Result
from .steps import Outcome, Steps

__all__ = ["failure"]

#: A rotation by this in a step, in rad, is the likely cause of a failure: stages may rotate further than the start.
_FAR = 2.0


def failure(stepper: Stepper, steps: Steps, outcome: Outcome, x: Arrays) -> IntegrationError:
    """The error for an integration that ended early at the state x."""
    result, t, h = Result(int(outcome.code)), float(outcome.t), float(outcome.h)
    last = "last state"
    if result is Result.NON_FINITE:
        last = "last finite state"
        what, cause, fix = _not_finite_end(stepper, steps, outcome, x)
    elif result is Result.NEWTON_FAILED:
        what = f"the equations of a step of {stepper.method.name} could not be solved at t = {t:.6g} s"
        cause, fix = steps.not_solved(h)
    else:
        state = steps.worst(stepper, outcome, x)
        blame = f" at t = {t:.6g} s" + (f"; state {state!r} has the largest error" if state else "")
        if result is Result.MAX_STEPS:
            what = f"{int(outcome.tried)} steps ran out{blame}"
            cause = f"steps are {h:.3g} s there: tolerances this tight, rates this fast, or a stiff system"
            fix = "try looser tolerances, or more steps: control=tx.StepControl(max_steps=...)"
        else:
            what = f"no step is small enough for the tolerances{blame}"
            cause = "a jump in the rates there, a singularity, or dtmin"
            fix = "name times of jumps with jumps=..., or try looser tolerances"
    return IntegrationError(
        f"{what}.\n  likely cause: {cause}\n  {last}: {_sizes(x)} (largest entries)\n"
        f"  fix: {fix}; throw=False keeps the solution up to here"
    )


def _not_finite_end(stepper: Stepper, steps: Steps, outcome: Outcome, x: Arrays) -> tuple[str, str, str]:
    """What happened in the step from x whose end is not finite, the likely cause and what to do."""
    t, h = outcome.t, outcome.h
    field = stepper.field(t, h)
    rates, moved = field(t, x), stepper.method.step(field, t, x, h)
    # The end may be finite and the rate there not.
    bad = _not_finite(moved) or list(moved)
    names = ", ".join(map(repr, bad))
    what = f"state {names} became infinite or NaN in the step from t = {float(t):.6g} s"
    angles = {name: angle for name, angle in _angles(stepper.dynamics, rates, h).items() if name in bad}
    far = max(angles, key=angles.__getitem__, default=None)
    bad_controls = _not_finite(field.controls(t)) or _not_finite(field.controls(t + h))
    if bad_controls:
        cause = f"control {bad_controls[0]!r} is not finite there"
        return what, cause, "look at u between the start and the end of this step"
    if _not_finite(rates) and not _is_huge(x):
        cause = f"the rate of {_not_finite(rates)[0]!r} is not finite there, e.g. a division by zero"
        return what, cause, "guard the expression, or stop before that state"
    if far is not None and angles[far] > _FAR:
        cause = (
            f"{far!r} turns by some {angles[far]:.3g} rad in this step of {float(h):.6g} s, too far for one step: "
            "exponential coordinates hold half a turn as polynomials, a full one in closed form"
        )
        return what, cause, "try a smaller dt, or tx.charts.Exponential() for up to a full turn"
    return what, *steps.too_long(float(h))


def _sizes(x: Arrays) -> str:
    return ", ".join(f"|{name}| = {_largest(value):.3g}" for name, value in x.items())


def _not_finite(values: Mapping[str, Any]) -> list[str]:
    return [name for name, value in values.items() if not is_finite(value)]


def _is_huge(x: Mapping[str, Any]) -> bool:
    """Whether a state is so large that squares and cubes of it overflow."""
    return any(_largest(v) > float(jnp.finfo(v.dtype).max) ** 0.25 for v in x.values())


def _largest(value: Any) -> float:
    return float(np.abs(np.asarray(value)).max())


def _angles(dynamics: Dynamics, rates: Arrays, h: jax.Array) -> dict[str, float]:
    """By how many rad each rotation and pose turns in a step, if its rate stays as it is."""
    angular = {}
    for name, group in dynamics.group.factors.items():
        if isinstance(group, SpecialOrthogonal):
            angular[name] = rates[name]
        elif isinstance(group, SpecialEuclidean):
            angular[name] = group.order.split(rates[name])[1]
    return {name: float(h) * float(np.linalg.norm(np.asarray(w))) for name, w in angular.items()}
